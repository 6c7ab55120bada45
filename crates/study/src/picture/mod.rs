//! Measures of pictures, and errors drawn as pictures.

pub mod colormap;
mod error_picture;
pub mod lettering;
mod metrics;

pub use colormap::Colormap;
pub use error_picture::error_picture;
pub use lettering::side_by_side;
pub use metrics::{DEFAULT_PIXELS_PER_DEGREE, flip, mean_flip, psnr};
