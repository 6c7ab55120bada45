//! Many geodesics from one camera: directions and camera positions as parameters, both ways, and
//! exact samples of them.
//!
//! In: a manifold. Out: [`FanSpace`] (which rays a table must know, after symmetry) and [`sample`]
//! (arrays of exact paths).

mod axis;
pub mod cell;
pub mod direction;
mod ends;
mod focus;
mod mirror;
mod orbit;
mod position;
mod sample;
mod slowing;
mod space;
mod sphere;

pub use axis::Axis;
pub use direction::FACES;
pub use focus::Focus;
pub use mirror::{Image, Mirror};
pub use orbit::OrbitAngles;
pub use position::{Lift, Start};
pub use sample::{CHANNELS, DISPLACEMENT, Sample, Samples, sample};
pub use space::{FanSpace, Located, Orbit, Place, Reduction, StoredCamera};
pub use sphere::{Sphere, parallel};
