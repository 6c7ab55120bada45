//! Light of points in a curved space: intensity divided by how far the geodesics have spread.
//!
//! In: a light at a chart point, and surface points. Out: every geodesic that connects the two up to
//! a length ([`LightFan::connections`]), the irradiance that each brings ([`irradiance`]), and both
//! together for a whole scene at rest ([`Baked`]), kept in a file ([`cache`]).
//!
//! A light of intensity `I` (per unit solid angle) gives `E = I cosθ / area(s)` along a geodesic,
//! where `area` is the determinant of the deviation matrix across it: `s²` in flat space. Several
//! geodesics add up. At a caustic the area is zero and the irradiance infinite, though the energy
//! that arrives is not; see [`MOST_GAIN`].

pub mod baked;
mod boxes;
pub mod cache;
mod cell;
mod connect;
mod facets;
mod fan;
mod icosphere;
mod illumination;
mod prism;
mod slanted;
mod way;

pub use baked::Baked;
pub use connect::Connection;
pub(crate) use connect::{Attempt, connect};
pub use fan::LightFan;
pub use illumination::{Lamps, MOST_GAIN, SurfacePoint, irradiance};
pub(crate) use way::Way;

use glam::DVec3;

/// A light without extent that shines equally in all directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLight {
    /// Chart point.
    pub u: DVec3,
    /// Linear red, green and blue per unit solid angle.
    pub intensity: [f32; 3],
}
