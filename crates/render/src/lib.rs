//! Camera, scene, tracers, lattice, intersection, shading and pictures.
//!
//! In: a scene file, its manifold and perhaps a bundle. Out: pictures. Steps: the camera's fan is
//! contracted from the table ([`geofan_bundle::Table::fan`]); paths are looked up on a lattice or
//! integrated one by one ([`frame`]); each is intersected with the placed scene ([`World`]); what is
//! found is shaded ([`shade`]).

pub mod accel;
mod camera;
mod cubics;
mod curve;
pub mod desk;
pub mod drawing;
pub mod endings;
pub mod film;
mod footprint;
pub mod frame;
pub mod intersect;
mod journey;
mod lanes;
mod last_pieces;
pub mod lattice;
pub mod lightmap;
pub mod local;
mod lone;
pub mod lookup;
pub mod outcome;
mod packet;
mod pencil;
pub mod picture;
mod rays;
mod ribbon;
pub mod scene;
pub mod shade;
mod sheaf;
pub mod sky;
mod stage;
pub mod strands;
mod strip;
pub mod tiles;
pub mod tracer;
pub mod view;
pub mod world;

pub use camera::{Camera, Moved};
pub use curve::{Curve, Ending, Piece};
pub use desk::Scratch;
pub use endings::EventLocator;
pub use footprint::Footprint;
pub use intersect::Hit;
pub use journey::Journey;
pub use lightmap::{Lightmap, SurfacePoint};
pub use lookup::{Lookup, TableTracer};
pub use outcome::Seen;
pub use rays::{Probe, first_seen};
pub use stage::Stage;
pub use strands::{PathBatch, PathView};
pub use tiles::Tally;
pub use tracer::{ExactTracer, FixedTracer, GridTracer};
pub use view::{View, camera_point};
pub use world::{Face, PointLight, World};
