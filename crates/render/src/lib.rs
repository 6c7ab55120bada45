//! Camera, scene, tracers, lattice, intersection, shading and pictures.
//!
//! In: a scene file, its manifold and perhaps a bundle. Out: pictures. Steps: the camera's fan is
//! contracted from the table ([`geofan_bundle::Table::fan`]); paths are looked up on a lattice or
//! integrated one by one ([`frame`]); each is intersected with the placed scene ([`World`]), and what it
//! sees is shaded ([`shade`]). Times come from a [`Clock`] of the caller.

pub mod accel;
mod camera_place;
mod chords;
mod copies;
mod curve;
pub mod drawing;
pub mod endings;
mod family;
mod filter;
mod first_hits;
pub mod frame;
mod halving;
pub mod intersect;
mod journey;
mod kept;
mod lanes;
pub mod lattice;
pub mod lightmap;
pub mod local;
pub mod lookup;
mod moving_objects;
pub mod panels;
pub mod path_batch;
mod path_patch;
pub mod picture;
mod placed_copies;
mod placement_checks;
pub mod redshift;
pub mod scene;
pub mod shade;
pub mod sky;
mod stage;
pub mod starts;
pub mod tiles;
pub mod tracer;
pub mod view;
pub mod world;

pub use camera_place::camera_point;
pub use copies::SceneCopies;
pub use curve::{Cubic, Curve, Ending};
pub use drawing::{
    DrawingOptions, DrawnPanels, PathSource, ShiftedTracer, count_unfinished, unfinished,
};
pub use endings::EventLocator;
pub use filter::Footprint;
pub use frame::{Clock, no_clock};
pub use intersect::{Hit, Seen, first_seen};
pub use journey::{Camera, Journey, Moved};
pub use lightmap::{Lightmap, SurfacePoint};
pub use lookup::{Lookup, TableTracer};
pub use panels::{Part, PicturePanel, PicturePanels, usual_size};
pub use path_batch::{PathBatch, PathView};
pub use stage::{Stage, load_manifold};
pub use tiles::TileScratch;
pub use tracer::{ExactGridTracer, ExactTracer, FixedTracer, GridTracer};
pub use view::{Optics, PictureRay, View};
pub use world::{Face, FaceCorner, PointLight, World};
