//! Fans on a uniform grid: the plain way to make a table, as a yardstick for patches.
//!
//! In: the rays of a space, numbers of cells. Out: a [`Grid`] with multilinear or cubic B-spline
//! interpolation, in single precision or 16 bits. The axes are those of a bundle: camera parameters
//! after symmetry, direction parameters on faces, arc length; so are the channels, the slope of the
//! departure, whose integral along the path gives points.

mod axes;
mod balance;
mod samples;
mod stencil;
mod storage;
mod table;

pub use axes::Axes;
pub use balance::{balanced, cells, mean};
pub use samples::{Samples, Stored};
pub use stencil::{FEWEST, Interpolation};
pub use storage::Number;
pub use table::{Grid, GridFan, GridPath};

#[cfg(test)]
mod tests;
