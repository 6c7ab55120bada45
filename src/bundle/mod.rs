//! The table: patches, quantisation, contraction, file format and certificate.

pub mod arc;
mod bytes;
mod certificate;
pub mod chebyshev;
mod coding;
pub mod container;
mod contracted;
mod division;
mod fan;
mod file;
mod matrix;
pub mod measure;
mod outlier;
mod polynomial;
mod random_rays;
mod records;
mod table;
mod tensor;
mod trace;
mod tree;

pub use bytes::{Damage, Reader, Writer};
pub use certificate::{Certificate, Checked, certify};
pub use contracted::Contracted;
pub use division::{Division, Stored};
pub use fan::{Fan, FanPath};
pub use file::{Bundle, BundleError, Contents, identity};
pub use outlier::{BoxPlace, FAR, Outlier};
pub use polynomial::Polynomial;
pub use random_rays::RandomRays;
pub use records::{Header, ManifoldRecord, PlanRecord, RecordError, ShardRecord};
pub use table::{Chunk, Table};
pub use tensor::{Layout, Scale, Tensor, Train};
pub use trace::{Traced, trace};
pub use tree::{Shape, Tree};
