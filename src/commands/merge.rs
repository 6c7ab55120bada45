//! `geofan merge`: joins the shards of one bake.

use super::bake::report;
use crate::terminal::{CommonArgs, Outcome, Watcher};
use geofan_core::Result;
use std::{path::PathBuf, time::Instant};

/// Options of `geofan merge`.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// The shards, all of one bake, in any order
    #[arg(required = true, value_name = "SHARD")]
    shards: Vec<PathBuf>,
    /// The bundle to write
    #[arg(long, short, value_name = "B.fan")]
    output: PathBuf,
}

/// Joins, measures and prints.
pub fn run(args: &MergeArgs, common: &CommonArgs) -> Result<Outcome> {
    let started = Instant::now();
    let watcher = Watcher::new(common)?;
    let finished = geofan_bake::merge(&args.shards, &args.output, &watcher)?;
    report(&finished, &args.output, started, common)
}
