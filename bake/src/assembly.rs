//! From chunks to files: the bundle with its certificate, shards, and shards joined to a bundle.
//!
//! In: all chunks of a bake, or some. Out: the bundle's file ([`finish`]), or a file of some chunks that
//! knows which share it is ([`write_shard`]). All shares of one bake become a bundle, byte for byte the
//! one that an undivided bake makes ([`merge`]): both are finished here.

use crate::{bake::Share, certificate::certify};
use geofan_bundle::{Bundle, Contents, ShardRecord};
use geofan_core::{
    Error, Observer, Progress, Result, files::check_output, geodesic::UnfinishedPaths,
};
use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering::Relaxed},
};

/// Measures the table of `contents` and writes it, certificate included, to `path`; returns the bundle, the
/// size of its file, and how the paths of the certificate's rays end.
///
/// # Errors
/// Interrupted (`resume` says how to go on), or the place cannot be written.
pub fn finish(
    contents: Contents,
    exact_rays: u64,
    path: &Path,
    resume: &str,
    observer: &dyn Observer,
) -> Result<(Bundle, u64, UnfinishedPaths)> {
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
    let (plan, rays) = (&bundle.header.plan, bundle.header.certify_rays);
    let certified = AtomicU64::new(0);
    let tell = |count| {
        observer.progress(Progress {
            work: "certifying",
            done: certified.fetch_add(count, Relaxed) + count,
            total: rays,
            detail: "",
        });
        match observer.cancelled() {
            true => Err(Error::Interrupted {
                resume: resume.into(),
            }),
            false => Ok(()),
        }
    };
    let checked = certify(
        &bundle.table,
        rays as usize,
        plan.seed,
        plan.tolerance,
        plan.max_error,
        tell,
    )?;
    let mut certificate = checked.certificate;
    certificate.exact_rays_baked = exact_rays;
    let bundle = bundle.certified(certificate);
    let bytes = bundle.write(path)?;
    Ok((bundle, bytes, checked.unfinished))
}

/// Writes the chunks of `share`; returns the size of the file.
///
/// # Errors
/// The place cannot be written.
pub fn write_shard(
    mut contents: Contents,
    share: Share,
    exact_rays: u64,
    path: &Path,
) -> Result<u64> {
    let Share { index, of } = share;
    contents.header.shard = Some(ShardRecord {
        index,
        of,
        exact_rays,
    });
    contents.write(path)
}

/// Joins shards into a bundle at `output`, and measures it; returns the outcome of the bake.
///
/// # Errors
/// The shards are not all shards of one bake, or the place cannot be written.
pub fn merge(
    shards: &[PathBuf],
    output: &Path,
    observer: &dyn Observer,
) -> Result<(Bundle, u64, UnfinishedPaths)> {
    check_output(output)?;
    let read = shards.iter().map(|path| Contents::read(path));
    let (contents, exact_rays) = join(shards, read.collect::<Result<Vec<_>>>()?)?;
    let resume = "the shards are untouched; run the same command again";
    finish(contents, exact_rays, output, resume, observer)
}

/// Puts the chunks of all shards in order, and adds up the rays they took.
fn join(paths: &[PathBuf], shards: Vec<Contents>) -> Result<(Contents, u64)> {
    let wrong = |k: usize, message: String| Error::input(paths[k].display().to_string(), message);
    // Each is a shard of the same bake, and none is there twice.
    let mut records = Vec::new();
    for (k, shard) in shards.iter().enumerate() {
        let record = shard.header.shard;
        let record = record.ok_or_else(|| wrong(k, "is a whole bundle, not a shard".into()))?;
        records.push(record);
        if shard.id != shards[0].id || !same_bake(shard, &shards[0]) {
            let first = paths[0].display();
            return Err(wrong(k, format!("is not of the same bake as {first}")));
        }
        let twin = records[..k].iter().position(|r| r.index == record.index);
        if let Some(twin) = twin {
            let twin = paths[twin].display();
            return Err(wrong(k, format!("is the same share as {twin}")));
        }
    }
    // None is missing.
    let of = records[0].of;
    let missing = (1..=of).find(|index| !records.iter().any(|r| r.index == *index));
    if let Some(index) = missing {
        return Err(wrong(0, format!("shard {index} of {of} is missing")));
    }
    // All their chunks, by number.
    let mut shards = shards.into_iter();
    let mut whole = shards.next().ok_or_else(|| wrong(0, "no shard".into()))?;
    whole.chunks.extend(shards.flat_map(|shard| shard.chunks));
    whole.chunks.sort_by_key(|chunk| chunk.0);
    whole.header.shard = None;
    Ok((whole, records.iter().map(|r| r.exact_rays).sum()))
}

/// Tells whether two shards differ in nothing but their share.
fn same_bake(a: &Contents, b: &Contents) -> bool {
    let of = |c: &Contents| c.header.shard.map(|s| s.of);
    let header = |c: &Contents| {
        let mut header = c.header.clone();
        header.shard = None;
        header
    };
    of(a) == of(b) && header(a) == header(b)
}
