//! The options of `geofan-bake`.

use crate::{demo::DemoArgs, shard::MergeArgs, sweep::SweepArgs};
use geofan::terminal::{CommonArgs, values};
use std::path::PathBuf;

/// Bakes geodesic bundles: lookup tables of all light paths in a curved space
#[derive(Debug, clap::Parser)]
#[command(
    name = "geofan-bake",
    version,
    arg_required_else_help = true,
    subcommand_negates_reqs = true
)]
pub struct Cli {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// What to do instead of baking.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// What to bake.
    #[command(flatten)]
    pub bake: Option<BakeArgs>,
}

/// What else there is to do.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Join the shards of one bake into a bundle
    Merge(MergeArgs),
    /// Bake the wormhole, render it and compare
    Demo(DemoArgs),
    /// Measure accuracy against table size
    Sweep(SweepArgs),
}

/// Options of a bake.
#[derive(Debug, Clone, clap::Args)]
pub struct BakeArgs {
    /// The manifold file
    pub manifold: PathBuf,
    /// The bundle to write
    #[arg(long, short, value_name = "B.fan")]
    pub output: PathBuf,
    /// The promise: 99th percentile of the screen error, in mrad [default: 0.5]
    #[arg(long, value_name = "MRAD", value_parser = promise)]
    pub max_error: Option<f64>,
    /// Largest file; the promise is loosened until the table fits, unless --max-error is given too
    #[arg(long, value_name = "SIZE", value_parser = values::bytes, conflicts_with = "shard")]
    pub max_size: Option<u64>,
    /// How far paths go (arc length) [default: the manifold file's]
    #[arg(long, value_name = "L", allow_negative_numbers = true, value_parser = values::positive)]
    pub length: Option<f64>,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    pub set: Vec<(String, f64)>,
    /// Promise points only, not tangents: smaller, but skies are less sharp and frames are not told
    #[arg(long)]
    pub no_frames: bool,
    /// Store every chunk, also those that reflections or exchanges of coordinates carry into others
    #[arg(long)]
    pub no_mirrors: bool,
    /// Bake the share I of N only (I from 1 to N) and write it as a shard for `merge`
    #[arg(long, value_name = "I/N", value_parser = share)]
    pub shard: Option<Share>,
    /// Go on with what an interrupted bake left in B.fan.parts
    #[arg(long)]
    pub resume: bool,
    /// Fresh random rays that the certificate takes
    #[arg(long, value_name = "RAYS", default_value_t = 20_000,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    pub certify_rays: u64,
}

/// One share of the chunks: those whose number leaves `index` − 1 when divided by `of`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// From 1 to `of`.
    pub index: u32,
    /// The number of shares.
    pub of: u32,
}

impl Share {
    /// Whether `chunk` belongs to it.
    pub fn has(self, chunk: u32) -> bool {
        chunk % self.of == self.index - 1
    }
}

/// The tightest and the loosest promise, mrad: below the first the exact tracer itself is not
/// exact enough; above the second a picture shows nothing.
const PROMISES: std::ops::RangeInclusive<f64> = 1e-5..=1e3;

/// A promise, mrad.
///
/// # Errors
/// A message for the user.
pub fn promise(text: &str) -> Result<f64, String> {
    let value = values::positive(text)?;
    if PROMISES.contains(&value) {
        return Ok(value);
    }
    let (start, end) = (PROMISES.start(), PROMISES.end());
    Err(format!("a promise lies between {start} and {end} mrad"))
}

/// The loosest promise that a size limit can lead to.
pub fn loosest() -> f64 {
    *PROMISES.end()
}

fn share(text: &str) -> Result<Share, String> {
    let wrong = || format!("`{text}` is not a share: write 1/4 for the first of four");
    let (index, of) = text.split_once('/').ok_or_else(wrong)?;
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let (index, of) = (number(index)?, number(of)?);
    match (1..=of).contains(&index) {
        true => Ok(Share { index, of }),
        false => Err(format!("shares are numbered from 1 to {of}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_counted_from_one() {
        assert_eq!(share("2/3"), Ok(Share { index: 2, of: 3 }));
        for wrong in ["0/3", "4/3", "1/0", "1", "a/b", "-1/2", ""] {
            assert!(share(wrong).is_err(), "{wrong}");
        }
        let chunks = (0..7).filter(|c| Share { index: 2, of: 3 }.has(*c));
        assert_eq!(chunks.collect::<Vec<_>>(), [1, 4]);
    }

    #[test]
    fn promises_have_a_range() {
        assert_eq!(promise("0.5"), Ok(0.5));
        for wrong in ["0", "-1", "1e-9", "1e9", "inf", "x"] {
            assert!(promise(wrong).is_err(), "{wrong}");
        }
    }
}
