//! Many geodesics from one camera: directions and camera positions as parameters, both ways, and
//! exact samples of them.
//!
//! In: a manifold. Out: [`RaySpace`] (which rays a table must know, after symmetry) and [`sample`]
//! (arrays of exact paths).

pub mod direction;
mod mirror;
mod position;
mod sample;
mod space;

pub use direction::{FACES, ImpactParameter, ReferenceSphere, Sphere, parallel};
pub use mirror::{Image, Mirror};
pub use position::{ChartMap, LiftedStart};
pub use sample::{
    BetweenEdges, CHANNELS, DISPLACEMENT, EdgePiece, SampleNumbers, SamplingPlan, end_at, exit_met,
    sample, speed_behind_end,
};
pub use space::{
    Axis, Located, Orbit, Place, RaySpace, Reduction, StoredCamera, cell_of, parameters_in_cell,
};
