//! Geodesic lookup tables: which rays a table must know, how it stores them in few bytes, and how a path is
//! looked up in it.
//!
//! In: the bytes of a bundle. Out: paths from any camera in its region, in any direction, at any arc
//! length:
//!
//! ```text
//! Bundle ── fan(camera) ──▶ Fan ── path(direction) ──▶ TablePath ── at(s), sample(&[s]) ──▶ point, tangent
//! ```
//!
//! Without default features the crate needs neither threads nor files nor clocks and builds for
//! `wasm32-unknown-unknown`; `files` adds reading and writing of files, `parallel` all cores.
//!
//! # Example
//!
//! A bundle of flat space whose cameras lie on the x axis. Each of its six faces of directions is one
//! constant polynomial: paths depart nowhere from straight lines, so all coefficients are zero.
//!
//! ```
//! use geofan_bundle::{
//!     Bundle, Contents, LookupError, PlanRecord, Polynomial, StepSize, Train, Tree, Variables, rays::RaySpace,
//! };
//! use geofan_core::{diagnostic::SourceText, manifold::Manifold};
//! use glam::DVec3;
//! use ndarray::{ArrayD, IxDyn};
//! use std::sync::Arc;
//!
//! let text = r#"
//! name = "flat"
//! coordinates = ["x", "y", "z"]
//! metric = { conformal = "1" }
//! [cameras]
//! parameters = { c = [-1, 1] }
//! at = ["c", "0", "0"]
//! length = 5.0
//! "#;
//! let manifold = Arc::new(Manifold::from_source(SourceText::new("flat.toml", text), &[])?);
//! let space = RaySpace::new(manifold)?;
//!
//! // A baker fits polynomials to exact paths; here they are known. Axes: camera, two of direction, arc
//! // length, channel (x, y, z).
//! let plan = PlanRecord::new(5.0, 0.5, vec![1], vec![1, 1, 1, 1]);
//! let polynomial = Polynomial {
//!     coefficients: ArrayD::zeros(IxDyn(&[1, 1, 1, 1, 3])),
//!     variables: Variables::of_face(1, plan.mapping),
//! };
//! let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-6)).expect("zeros are small");
//! let chunk = Tree::Leaf(Arc::new(tensor)).encode();
//! let chunks = (0..6).map(|face| (face, chunk.clone())).collect();
//! let bytes = Contents::new(space, plan, 0, chunks)?.encode()?;
//!
//! // A reader has the bytes alone.
//! let bundle = Bundle::from_bytes(&bytes)?;
//! let fan = bundle.fan(DVec3::new(0.25, 0.0, 0.0))?;
//! let path = fan.path(DVec3::new(0.6, 0.8, 0.0));
//! let (point, tangent) = path.at(2.0).expect("no patch is flagged");
//! assert!((point - DVec3::new(1.45, 1.6, 0.0)).length() < 1e-9);
//! assert!((tangent - DVec3::new(0.6, 0.8, 0.0)).length() < 1e-9);
//! assert_eq!(path.sample(&[0.0, 1.0, 2.0]).len(), 3);
//!
//! // Errors can be told apart.
//! let outside = bundle.fan(DVec3::new(3.0, 0.0, 0.0));
//! assert!(matches!(outside, Err(LookupError::OutsideRegion { .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Where to begin
//!
//! - [`rays`]: cameras and directions as parameters, after symmetry.
//! - [`Tree`], [`Tensor`], [`Polynomial`], [`Train`]: patches, from samples to rounded cores.
//! - [`container`], [`Header`], [`Bundle`]: the file.
//! - [`Table`], [`Fan`], [`TablePath`]: looking up.
//! - [`measure`], [`Certificate`]: how good it is.

mod bundle;
pub mod chebyshev;
mod coder;
pub mod container;
mod context;
mod contracted;
mod contraction;
mod decode;
mod fan;
mod header;
mod householder;
mod matrix;
pub mod measure;
mod packed_matrix;
pub mod path_coefficients;
mod polynomial;
pub mod rays;
mod sections;
pub mod spherical;
#[cfg(feature = "files")]
mod stored;
mod table;
mod tensor;
mod traced;
mod train;
mod train_core;
mod tree;

pub use bundle::{Bundle, Contents, MOST_CHUNKS, identity};
pub use chebyshev::MappedChebyshev;
pub use contracted::Contracted;
pub use decode::{BundleError, ByteReader, DecodeBudget, DecodeError, LookupError, put_bytes};
pub use fan::{Fan, TablePath};
pub use header::{
    Header, LENGTHS, MOST_CERTIFY_RAYS, ManifoldRecord, PROMISES, PlanRecord, ShardRecord,
};
pub use matrix::double_product;
pub use measure::{BoxPlace, Certificate, Checked, FAR, MOST, Outlier, TangentPromise};
pub use path_coefficients::PathCoefficients;
pub use polynomial::{Polynomial, Variables};
pub use sections::CodedTree;
#[cfg(feature = "files")]
pub use stored::{StoredChunks, StoredContents, write_chunks};
pub use table::{Chunk, Division, Table};
pub use tensor::{Layout, Tensor};
pub use traced::{Traced, trace, trace_in};
pub use train::{Train, unweighted, weighted, weighted_in_order};
pub use train_core::{Power, Scale, StepSize};
pub use tree::{SideReach, TensorShape, Tree, divided_at_edge};
