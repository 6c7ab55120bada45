//! Measuring the worth of tables: comparisons of pictures, sweeps over table sizes, rivals.
//!
//! In: scenes, manifolds, bundles. Out: numbers, pictures and pages about them.
//!
//! 1. [`comparison`] draws one view by table, by exact integration and by the strongest rival; or by
//!    first order and exactly.
//! 2. [`picture`] has the measures of pictures (PSNR, FLIP) and draws errors as pictures.
//! 3. [`sweep`] measures accuracy against table size.

pub mod comparison;
pub mod sweep;

/// Measures of pictures, and errors drawn as pictures.
pub mod picture {
    mod error_picture;
    pub mod lettering;
    mod metrics;

    pub use error_picture::{Colormap, error_picture};
    pub use lettering::side_by_side;
    pub use metrics::{DEFAULT_PIXELS_PER_DEGREE, flip, mean_flip, psnr};
}

use std::{
    sync::LazyLock,
    time::{Duration, Instant},
};

/// Reads this machine's clock, for frames to measure their times by: the time since its first reading.
pub fn clock() -> Duration {
    static FIRST: LazyLock<Instant> = LazyLock::new(Instant::now);
    FIRST.elapsed()
}
