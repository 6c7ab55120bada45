//! The light that arrives at surfaces: connections, weakened by spreading, tilt and shadow.
//!
//! In: a world with its lights, and points on its surfaces. Out: irradiance on either side.

use super::{Connection, LightFan, PointLight, way::Way};
use crate::{manifold::Manifold, render::World};
use glam::{DMat3, DVec3};

/// Caustics: no geodesic brings more than this many times the irradiance that it would bring over
/// the same arc length in flat space, `I cosθ / s²`. In terms of energy: of a pencil of light whose
/// cross-section has shrunk to less than 1/10,000 of the flat one, only the share (area / s²) ·
/// 10,000 is delivered while it is that small. At a fold, where irradiance goes like 1/√x, half of
/// the light within the clamped strip is lost, a strip about 1e-8 of the lens's width; at a perfect
/// focus (an antipode of S³) the light within the clamped disc of radius s/100 is. A smaller limit
/// dims visible caustics; a larger one lets single samples of a texel outshine its neighbourhood.
pub const MOST_GAIN: f64 = 1e4;

/// A point of a surface that light falls on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Chart point.
    pub u: DVec3,
    /// Normal covector, chart components; any length.
    pub normal: DVec3,
    /// The triangle that it is on.
    pub triangle: u32,
}

/// Irradiance (per unit intensity) that `connection` brings to a surface at `u` with the normal
/// covector `normal`: `cosθ / area`. Positive on the side to which the normal points, negative on
/// the other.
pub fn irradiance(manifold: &Manifold, u: DVec3, normal: DVec3, connection: &Connection) -> f64 {
    irradiance_in(manifold.standard_frame(u), normal, connection)
}

/// The same where the standard frame at the point is known.
fn irradiance_in(frame: DMat3, normal: DVec3, connection: &Connection) -> f64 {
    let n = (frame.transpose() * normal).normalize_or_zero();
    let v = (frame.inverse() * connection.v).normalize_or_zero();
    let least = connection.s * connection.s / MOST_GAIN;
    -n.dot(v) * connection.through / connection.area.abs().max(least)
}

/// The lights of a world, ready to be connected.
pub struct Lamps<'w> {
    world: &'w World,
    lamps: Vec<(PointLight, LightFan<'w>)>,
    tolerance: f64,
}

/// Light that reaches a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Irradiance, red, green and blue; not negative.
    pub irradiance: [f64; 3],
    /// Whether it falls on the side to which the normal points.
    pub front: bool,
    /// The tangent of the light's path at the point, chart components; unit.
    pub v: DVec3,
}

impl<'w> Lamps<'w> {
    /// Follows the light of the world's lights over `length`; geodesics are found at a local
    /// tolerance.
    pub fn new(world: &'w World, length: f64, tolerance: f64) -> Self {
        let nowhere = (DVec3::ZERO, DVec3::ZERO);
        let region = world.accelerator.bounds().unwrap_or(nowhere);
        let fan = |light: &PointLight| {
            let fan = LightFan::new(&world.manifold, light.u, length, region);
            (*light, fan)
        };
        Self {
            world,
            lamps: world.lights.iter().map(fan).collect(),
            tolerance,
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.lamps.is_empty()
    }

    /// All light that arrives at `points` unhindered, by the number of the point; and how many
    /// geodesics were followed to find it.
    pub fn arrivals(&self, points: &[SurfacePoint]) -> (Vec<(usize, Arrival)>, usize) {
        let (mut arrivals, mut rays) = (Vec::new(), 0);
        for (light, fan) in &self.lamps {
            let way = Way::Clear(self.world, points);
            let places = points.iter().map(|p| p.u);
            let (connections, followed) = fan.connected(places, self.tolerance, way);
            rays += followed;
            let places: Vec<DVec3> = connections.iter().map(|(i, _)| points[*i].u).collect();
            let frames = self.world.manifold.standard_frames(&places);
            let arrival = |((index, connection), frame): ((usize, Connection), DMat3)| {
                let share = irradiance_in(frame, points[index].normal, &connection);
                (index, Arrival::new(light, share, connection.v))
            };
            arrivals.extend(connections.into_iter().zip(frames).map(arrival));
        }
        (arrivals, rays)
    }
}

impl Arrival {
    /// Light that brings `share` of the light's intensity, positive on the front; `v` is its tangent.
    fn new(light: &PointLight, share: f64, v: DVec3) -> Self {
        Self {
            irradiance: light.intensity.map(|i| f64::from(i) * share.abs()),
            front: share > 0.0,
            v,
        }
    }
}
