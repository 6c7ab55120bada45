//! Shards: a bake divided between machines, and joined again.
//!
//! In: some chunks of a bake. Out: a file of them that knows which share it is
//! ([`write()`]); all shares of one bake → a bundle, byte for byte the one an undivided bake makes
//! ([`merge`]).

use crate::{args::Share, finish::finish};
use geofan::{
    Error, Result,
    bundle::{Contents, ShardRecord},
    terminal::{self, CommonArgs, Interrupt, Outcome},
};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// Options of `geofan-bake merge`.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// The shards, all of one bake, in any order
    #[arg(required = true, value_name = "SHARD")]
    pub shards: Vec<PathBuf>,
    /// The bundle to write
    #[arg(long, short, value_name = "B.fan")]
    pub output: PathBuf,
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
    common: &CommonArgs,
) -> Result<Outcome> {
    let Share { index, of } = share;
    contents.header.shard = Some(ShardRecord {
        index,
        of,
        exact_rays,
    });
    let bytes = contents.write(path)?;
    let (name, chunks) = (path.display().to_string(), contents.chunks.len());
    if common.json {
        terminal::print_json(&json!({
            "path": name, "bytes": bytes, "shard": index, "of": of, "chunks": chunks,
        }))?;
    } else {
        terminal::print(&format!(
            "{name}: {bytes} bytes, shard {index} of {of} with {chunks} chunks\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// Joins shards into a bundle, and measures it.
///
/// # Errors
/// The shards are not all shards of one bake, or the place cannot be written.
pub fn merge(args: &MergeArgs, common: &CommonArgs) -> Result<Outcome> {
    let started = Instant::now();
    let interrupt = Interrupt::install()?;
    let read = args.shards.iter().map(|path| Contents::read(path));
    let shards = read.collect::<Result<Vec<_>>>()?;
    let (contents, exact_rays) = join(&args.shards, shards)?;
    let resume = "the shards are untouched; run the same command again";
    let finished = finish(
        contents,
        exact_rays,
        &args.output,
        resume,
        &interrupt,
        common,
    )?;
    finished.report(&args.output, started, common)
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
