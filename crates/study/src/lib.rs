//! Measuring what tables are worth: comparisons of pictures, sweeps over table sizes, rivals.
//!
//! In: scenes, manifolds, bundles. Out: numbers, pictures and pages about them.
//!
//! 1. [`comparison`] draws one view by table, by exact integration and by the strongest rival.
//! 2. [`local_comparison`] holds the first-order view against the exact one.
//! 3. [`picture`] has the measures of pictures (PSNR, FLIP) and draws errors as pictures.
//! 4. [`sweep`] measures accuracy against table size.

pub mod comparison;
pub mod local_comparison;
pub mod picture;
pub mod sweep;

use std::{
    sync::LazyLock,
    time::{Duration, Instant},
};

/// Reads this machine's clock, for frames to measure their times by: the time since its first reading.
pub fn clock() -> Duration {
    static FIRST: LazyLock<Instant> = LazyLock::new(Instant::now);
    FIRST.elapsed()
}
