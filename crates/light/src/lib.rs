//! Light of lamps in a curved space: intensity divided by how far the geodesics have spread.
//!
//! In: a lamp at a chart point, and surface points. Out: every geodesic that connects the two up to
//! a length ([`LightFan::connections`]), the irradiance that each brings ([`irradiance`]), and both
//! together for a whole scene at rest ([`bake_light`]), kept in a file ([`cache`]). [`path_tracer`]
//! follows light that surfaces pass on.
//!
//! A lamp of intensity `I` (per unit solid angle) gives `E = I cosθ / area(s)` along a geodesic,
//! where `area` is the determinant of the deviation matrix across it: `s²` in flat space. Several
//! geodesics add up. At a caustic the area is zero and the irradiance infinite, though the energy
//! that arrives is not; see [`MOST_GAIN`].

mod beam;
#[cfg(feature = "files")]
pub mod cache;
mod connection;
mod fan_refinement;
mod illumination;
mod light_fan;
pub mod path_tracer;
mod ray_leg;
mod segment_map;

pub use connection::Connection;
pub(crate) use connection::{Shadows, ShootingStart, connect};
pub use illumination::{IncidentLight, Lamps, MOST_GAIN, bake_light, even_points, irradiance};
pub use light_fan::LightFan;
