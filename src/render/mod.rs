//! Camera, scene, tracers, lattice, intersection, shading and pictures.
//!
//! In: a scene file, its manifold and perhaps a bundle. Out: pictures. Steps: the camera's fan is
//! contracted from the table ([`crate::bundle::Table::fan`]); paths are looked up on a lattice or
//! integrated one by one ([`frame`]); each is intersected with the placed scene ([`World`]); what is
//! found is shaded ([`shade`]).

pub mod accel;
mod behind;
mod camera;
pub mod comparison;
mod cubics;
mod curve;
mod desk;
pub mod drawing;
mod endings;
pub mod film;
mod footprint;
pub mod frame;
mod intersect;
mod journey;
mod lanes;
mod last_pieces;
pub mod lattice;
pub mod light;
pub mod local;
pub mod local_comparison;
mod lone;
mod lookup;
mod outcome;
mod packet;
pub mod path_tracer;
mod pencil;
pub mod picture;
mod rays;
mod ribbon;
pub mod scene;
pub mod shade;
mod sheaf;
pub mod sky;
mod stage;
mod strands;
mod strip;
pub mod tiles;
mod tracer;
mod view;
mod world;

pub use camera::{Camera, Moved};
pub use curve::{Curve, Ending, Piece};
pub use desk::Desk;
pub use endings::EndingFinder;
pub use footprint::Footprint;
pub use intersect::Hit;
pub use journey::Journey;
pub use lookup::{Lookup, TableTracer};
pub use outcome::Seen;
pub use rays::{Probe, first_seen};
pub use stage::Stage;
pub use strands::{Strand, Strands};
pub use tiles::Tally;
pub use tracer::{ExactTracer, FixedTracer, GridTracer};
pub use view::{View, camera_point};
pub use world::{Face, World};
