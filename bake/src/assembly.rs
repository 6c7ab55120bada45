//! From chunks to files: the bundle with its certificate, and shards.
//!
//! In: all chunks of a bake, or some. Out: the bundle's file ([`finish`]), or a file of some chunks that
//! knows which share it is ([`write_shard`]). How shards are joined is in `merge`.

use crate::{bake::Share, certificate::certify};
use geofan_bundle::{Bundle, Contents, ShardRecord};
use geofan_core::{Error, Observer, Progress, Result, geodesic::UnfinishedPaths};
use std::{
    path::Path,
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
    let tell = |count| tell_certified(observer, (&certified, count, rays), resume);
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

/// Tells the observer that `count` more of `rays` rays are compared.
///
/// # Errors
/// It ends the work; `resume` says how to go on.
pub(crate) fn tell_certified(
    observer: &dyn Observer,
    (certified, count, rays): (&AtomicU64, u64, u64),
    resume: &str,
) -> Result<()> {
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
}
