//! Many geodesics from one camera: directions and camera positions as parameters, both ways, and
//! exact samples of them.
//!
//! In: a manifold. Out: [`RaySpace`] (which rays a table must know, after symmetry) and [`sample`]
//! (arrays of exact paths).

mod axis;
pub mod cell;
pub mod direction;
mod ends;
mod focus;
mod mirror;
mod orbit;
mod piece;
mod position;
mod sample;
mod space;
mod sphere;

pub use axis::Axis;
pub use direction::FACES;
pub use focus::ReferenceSphere;
pub use mirror::{Image, Mirror};
pub use orbit::ImpactParameter;
pub use piece::{EdgePiece, end_at, exit_met};
pub use position::{ChartMap, LiftedStart};
pub use sample::{
    BetweenEdges, CHANNELS, DISPLACEMENT, SampleNumbers, SamplingPlan, sample, speed_behind_end,
};
pub use space::{Located, Orbit, Place, RaySpace, Reduction, StoredCamera};
pub use sphere::{Sphere, parallel};
