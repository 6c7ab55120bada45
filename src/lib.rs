#![deny(unsafe_code)]
#![warn(missing_docs)]
//! geofan: precomputed geodesic lookup tables for curved 3-dimensional spaces.

pub mod diagnostic;
pub mod error;
pub mod expr;
pub mod files;
pub mod quantiles;
pub mod render;

pub use error::{Error, Result};
