//! Light of points in a curved space: intensity divided by how far the geodesics have spread.
//!
//! In: a light at a chart point, and surface points. Out: every geodesic that connects the two up to
//! a length ([`LightFan::connections`]), the irradiance that each brings ([`irradiance`]), and both
//! together for a whole scene at rest ([`bake_light`]), kept in a file ([`cache`]).
//!
//! A light of intensity `I` (per unit solid angle) gives `E = I cosθ / area(s)` along a geodesic,
//! where `area` is the determinant of the deviation matrix across it: `s²` in flat space. Several
//! geodesics add up. At a caustic the area is zero and the irradiance infinite, though the energy
//! that arrives is not; see [`MOST_GAIN`].

mod baked;
mod boxes;
pub mod cache;
mod cell;
mod connect;
mod fan;
mod icosphere;
mod illumination;
pub mod path_tracer;
mod prism;
mod slanted;
mod way;

pub use baked::{ADDED, EVEN, bake_light};
pub use connect::Connection;
pub(crate) use connect::{Attempt, connect};
pub use fan::LightFan;
pub use illumination::{Lamps, MOST_GAIN, irradiance};
pub(crate) use way::Way;
