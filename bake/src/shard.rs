//! Shards: a bake divided between machines, and joined again.
//!
//! In: some chunks of a bake. Out: a file of them that knows which share it is ([`write()`]); all
//! shares of one bake → a bundle, byte for byte the one an undivided bake makes ([`merge`]).

use crate::{
    finish::{Finished, finish},
    options::Share,
};
use geofan_bundle::{Contents, ShardRecord};
use geofan_core::{Error, Observer, Result};
use std::path::{Path, PathBuf};

/// Describes a shard that has been written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WrittenShard {
    /// Which share of the chunks it has.
    pub share: Share,
    /// Its size.
    pub bytes: u64,
    /// Its number of chunks.
    pub chunks: usize,
}

/// Writes the chunks of `share`.
///
/// # Errors
/// The place cannot be written.
pub fn write(
    mut contents: Contents,
    share: Share,
    exact_rays: u64,
    path: &Path,
) -> Result<WrittenShard> {
    let Share { index, of } = share;
    contents.header.shard = Some(ShardRecord {
        index,
        of,
        exact_rays,
    });
    Ok(WrittenShard {
        share,
        bytes: contents.write(path)?,
        chunks: contents.chunks.len(),
    })
}

/// Joins shards into a bundle at `output`, and measures it.
///
/// # Errors
/// The shards are not all shards of one bake, or the place cannot be written.
pub fn merge(shards: &[PathBuf], output: &Path, observer: &dyn Observer) -> Result<Finished> {
    let read = shards.iter().map(|path| Contents::read(path));
    let (contents, exact_rays) = join(shards, read.collect::<Result<Vec<_>>>()?)?;
    let resume = "the shards are untouched; run the same command again";
    finish(contents, exact_rays, output, resume, observer)
}

/// The chunks of all shards in order, and the rays they took.
fn join(paths: &[PathBuf], shards: Vec<Contents>) -> Result<(Contents, u64)> {
    let wrong = |k: usize, message: String| Error::input(paths[k].display().to_string(), message);
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
    let of = records[0].of;
    let missing = (1..=of).find(|index| !records.iter().any(|r| r.index == *index));
    if let Some(index) = missing {
        return Err(wrong(0, format!("shard {index} of {of} is missing")));
    }
    let mut shards = shards.into_iter();
    let mut whole = shards.next().ok_or_else(|| wrong(0, "no shard".into()))?;
    whole.chunks.extend(shards.flat_map(|shard| shard.chunks));
    whole.chunks.sort_by_key(|chunk| chunk.0);
    whole.header.shard = None;
    Ok((whole, records.iter().map(|r| r.exact_rays).sum()))
}

/// Whether two shards differ in nothing but their share.
fn same_bake(a: &Contents, b: &Contents) -> bool {
    let of = |c: &Contents| c.header.shard.map(|s| s.of);
    let header = |c: &Contents| {
        let mut header = c.header.clone();
        header.shard = None;
        header
    };
    of(a) == of(b) && header(a) == header(b)
}
