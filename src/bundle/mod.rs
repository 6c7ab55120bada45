//! The table: patches, quantisation, contraction, file format and certificate.

mod bytes;
mod certificate;
pub mod chebyshev;
pub mod container;
mod contracted;
mod fan;
mod file;
pub mod measure;
mod patch;
mod records;
mod table;
mod trace;
mod tree;

pub use bytes::{Damage, Reader, Writer};
pub use certificate::{Certificate, certify};
pub use contracted::Contracted;
pub use fan::{Fan, FanPath};
pub use file::{Bundle, BundleError, Contents, decode_chunk, encode_chunk, identity};
pub use patch::{Patch, Polynomial, Tensor};
pub use records::{Header, ManifoldRecord, PlanRecord, RecordError, ShardRecord};
pub use table::{Division, Table};
pub use trace::{Traced, trace};
pub use tree::{Shape, Tree};
