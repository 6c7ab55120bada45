//! The table: patches, quantisation, contraction, file format and certificate.

mod bytes;
mod coding;
mod contracted;
mod certificate;
pub mod chebyshev;
pub mod container;
mod file;
pub mod measure;
mod patch;
mod polynomial;
mod records;
mod table;
mod tensor;
mod trace;
mod tree;

pub use bytes::{Damage, Reader, Writer};
pub use certificate::{Certificate, certify};
pub use contracted::Contracted;
pub use file::{Bundle, BundleError, Contents, identity};
pub use patch::Patch;
pub use polynomial::Polynomial;
pub use records::{Header, ManifoldRecord, PlanRecord, RecordError, ShardRecord};
pub use table::{Chunk, Division, Fan, FanPath, Table};
pub use tensor::{Layout, Scale, Tensor, Train};
pub use trace::{Traced, trace};
pub use tree::{Shape, Tree};
