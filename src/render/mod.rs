//! Camera, scene, tracers, lattice, intersection, shading and pictures.

pub mod accel;
mod curve;
pub mod picture;
pub mod scene;
pub mod sky;
mod tracer;
mod view;

pub use curve::{Curve, Ending, EndingFinder, Piece};
pub use tracer::{ExactTracer, GridTracer, TableTracer, Tracer};
pub use view::{View, camera_point};
