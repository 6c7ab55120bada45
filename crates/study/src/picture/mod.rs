//! Measures of pictures, and errors drawn as pictures.

pub mod colormap;
pub mod error_picture;
pub mod flip;
pub mod lettering;
mod metrics;
pub mod side_by_side;

pub use colormap::Colormap;
pub use error_picture::{Decades, error_picture};
pub use flip::{Flip, flip};
pub use metrics::psnr;
pub use side_by_side::side_by_side;
