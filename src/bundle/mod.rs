//! The table: patches, quantisation, contraction, file format and certificate.

mod bytes;
pub mod chebyshev;
pub mod measure;
mod patch;
mod table;
mod tree;

pub use bytes::Damage;
pub use patch::{Contracted, Patch, Polynomial, Tensor};
pub use table::{Division, Fan, FanPath, Table};
pub use tree::{Shape, Tree};
