#![forbid(unsafe_code)]
#![warn(missing_docs)]
//! The offline side of geofan.

pub mod plan;
pub mod refine;
