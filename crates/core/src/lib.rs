//! Documents, manifolds and geodesics.
//!
//! In: the text of a manifold file. Out: geodesics with their transported frames and deviation.
//!
//! 1. [`document`] reads TOML and remembers where everything stands; [`diagnostic`] turns a mistake
//!    into a message with the line, the column and the text underlined.
//! 2. [`field`] makes functions of files of samples; [`manifold`] makes a space of expressions: metric, standard frames, geodesic equation, domain,
//!    exits, symmetry, camera region. A claim of the file that is false is refused here.
//! 3. [`geodesic`] follows rays: an adaptive integrator with dense output that carries the
//!    transported frame and the geodesic deviation along.
//!
//! [`error`], [`keeping`], [`observer`], [`parallel`], [`quantiles`], [`random`], [`reading`] and, with the feature `files`,
//! [`files`] serve every crate.

pub mod diagnostic;
pub mod document;
pub mod error;
pub mod field;
#[cfg(feature = "files")]
pub mod files;
pub mod geodesic;
pub mod keeping;
pub mod manifold;
pub mod observer;
pub mod parallel;
pub mod quantiles;
pub mod random;
pub mod reading;

pub use error::{Error, Result};
pub use observer::{Muted, Observer, Progress, Stop, Unobserved};
