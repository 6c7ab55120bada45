//! Camera, scene, tracers, lattice, intersection, shading and pictures.
//!
//! In: a scene file, its manifold and perhaps a bundle. Out: pictures. Steps: the camera's fan is
//! contracted from the table ([`crate::bundle::Table::fan`]); paths are looked up on a lattice or
//! integrated one by one ([`frame`]); each is intersected with the placed scene ([`World`]); what is
//! found is shaded ([`shade`]).

pub mod accel;
mod camera;
pub mod comparison;
mod curve;
pub mod frame;
mod intersect;
mod lattice;
pub mod light;
pub mod local;
pub mod local_comparison;
mod outcome;
pub mod path_tracer;
pub mod picture;
mod rays;
pub mod scene;
pub mod shade;
pub mod sky;
mod stage;
mod tracer;
mod view;
mod world;

pub use camera::{Camera, Moved};
pub use curve::{Curve, Ending, EndingFinder, Piece};
pub use intersect::Hit;
pub use lattice::LatticeTally;
pub use outcome::{Outcome, Seen};
pub use rays::{Probe, first_seen};
pub use stage::Stage;
pub use tracer::{ExactTracer, FixedTracer, GridTracer, TableTracer, Tracer};
pub use view::{View, camera_point};
pub use world::{Face, World};
