#![deny(unsafe_code)]
#![warn(missing_docs)]
//! geofan: precomputed geodesic lookup tables for curved 3-dimensional spaces.

pub mod bundle;
pub mod diagnostic;
pub mod document;
pub mod error;
pub mod expr;
pub mod fan;
pub mod files;
pub mod geodesic;
pub mod manifold;
pub mod quantiles;
pub mod random;
pub mod render;
pub mod spelling;
pub mod terminal;

pub use error::{Error, Result};
