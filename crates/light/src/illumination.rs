//! The light that arrives at surfaces: connections, weakened by spreading, tilt and shadow.
//!
//! In: a world with its lamps, and points on its surfaces. Out: the light that arrives at each
//! ([`Lamps::incident_light`]), and a [`Lightmap`] of surfaces that do not move ([`bake_light`]):
//! irradiance on both sides of every triangle, at points that lie as close as the budget allows where
//! light changes.

use crate::{Connection, LightFan, Shadows};
use geofan_core::{
    manifold::{Frequencies, Manifold},
    parallel::*,
};
use geofan_render::{
    PointLight, SurfacePoint, World,
    lightmap::{DirectedLight, DirectedLights, FacetLayout, Light, Lightmap},
    redshift::{SurfaceFrame, SurfaceState},
    shade::is_glossy_triangle,
};
use glam::{DMat3, DVec3};

/// Caustics: no geodesic brings more than this many times the irradiance that it would bring over
/// the same arc length in flat space, `I cosθ / s²`. In terms of energy: of a beam whose cross-section
/// has shrunk to less than 1/10,000 of the flat one, only the share (area / s²) · 10,000 is delivered
/// while it is that small. At a fold, where irradiance goes like 1/√x, half of the light within the
/// clamped strip is lost, a strip about 1e-8 of the lens's width; at a perfect focus (an antipode of
/// S³) the light within the clamped disc of radius s/100 is. A smaller limit dims visible caustics; a
/// larger one lets single samples of a texel outshine its neighbourhood.
pub const MOST_GAIN: f64 = 1e4;

/// Computes the irradiance (per unit intensity) that `connection` brings to a surface at `u` with the
/// normal covector `normal`: `cosθ / area`, of what surfaces on the way let through. Positive on the side to which the normal points, negative
/// on the other.
pub fn irradiance(manifold: &Manifold, u: DVec3, normal: DVec3, connection: &Connection) -> f64 {
    let frames = manifold.rest_frames(&[u]);
    irradiance_in(SurfaceFrame::at_rest(frames[0]), normal, connection)
}

/// Computes [`irradiance`] where the frame of the surface is known.
fn irradiance_in(surface: SurfaceFrame, normal: DVec3, connection: &Connection) -> f64 {
    let n = surface.normal(normal);
    // Lines of sight run against the light.
    let v = (surface.frame.inverse() * (connection.v + surface.pace)).normalize_or_zero();
    let least = connection.s * connection.s / MOST_GAIN;
    -n.dot(v) * connection.through / connection.area.abs().max(least)
}

/// The lamps of a world, ready to be connected.
pub struct Lamps<'w> {
    world: &'w World,
    lamps: Vec<(PointLight, LightFan<'w>)>,
    tolerance: f64,
}

/// Light that reaches a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IncidentLight {
    /// The number of the lamp that sends it.
    pub lamp: usize,
    /// Irradiance, red, green and blue; not negative.
    pub irradiance: [f64; 3],
    /// Set if it falls on the side to which the normal points.
    pub front: bool,
    /// The tangent of the light's path at the point, chart components.
    pub v: DVec3,
}

impl<'w> Lamps<'w> {
    /// Follows the light of the world's lamps over `length`; geodesics are found at a local
    /// tolerance.
    pub fn new(world: &'w World, length: f64, tolerance: f64) -> Self {
        let nowhere = (DVec3::ZERO, DVec3::ZERO);
        let region = world.accelerator.bounds().unwrap_or(nowhere);
        let fan = |light: &PointLight| {
            let fan = LightFan::new(&world.lamplight, light.u, length, region);
            (*light, fan)
        };
        Self {
            world,
            lamps: world.lights.iter().map(fan).collect(),
            tolerance,
        }
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.lamps.is_empty()
    }

    /// Finds all light that arrives at `points` outside of shadows, by the number of the point; and
    /// tells how many geodesics were followed to find it.
    pub fn incident_light(&self, points: &[SurfacePoint]) -> (Vec<(usize, IncidentLight)>, usize) {
        let (mut incident, mut rays) = (Vec::new(), 0);
        for (lamp, (light, fan)) in self.lamps.iter().enumerate() {
            let shadows = Shadows::Cast(self.world, points);
            let places = points.iter().map(|p| p.u);
            let (connections, followed) = fan.connected(places, self.tolerance, shadows);
            rays += followed;
            let places = connections.iter().map(|(i, _)| &points[*i]);
            let places: Vec<(DVec3, u32)> = places.map(|p| (p.u, p.triangle)).collect();
            let states = self.world.surface_states(&places);
            let frames = self.world.surface_frames(&places, states.as_deref());
            let sent = SentLight::of(self.world, light);
            for (k, (index, connection)) in connections.into_iter().enumerate() {
                let connection = carried_back(self.world, points[index].u, connection);
                let share = irradiance_in(frames[k], points[index].normal, &connection);
                let gain = sent.as_ref().zip(states.as_ref());
                let gain = gain.map_or(1.0, |(sent, states)| sent.gain(&states[k], &connection));
                let light = IncidentLight::new((lamp, light), share * gain, connection.v);
                incident.push((index, light));
            }
        }
        (incident, rays)
    }
}

/// Compares the light that a lamp sends with what arrives, where the scene asks for frequencies. A lamp sends as the
/// normal observer: it is a small surface at rest there.
struct SentLight {
    frame: DMat3,
    frequencies: Frequencies,
}

impl SentLight {
    /// Prepares to compare that of a lamp; `None` where frequencies do not matter.
    fn of(world: &World, light: &PointLight) -> Option<Self> {
        let lamplight = &world.lamplight;
        world.redshift.then(|| Self {
            frame: lamplight.standard_frame(light.u),
            frequencies: lamplight.frequencies(light.u),
        })
    }

    /// Computes the factor by which `connection` brings more light because it arrives at another frequency at a surface in
    /// this `state`: `g² (N_lamp/N)²`, because what a solid angle at the lamp sends stays together, and intensity and area
    /// are those of the metric, which are `1/N²` of what clocks and rods there measure.
    fn gain(&self, state: &SurfaceState, connection: &Connection) -> f64 {
        let sent = self.frequencies.normal(self.frame * connection.direction);
        // Lines of sight run against the light.
        let g = state.frequency(-connection.v) / sent;
        let g = if g > 0.0 { g } else { 0.0 };
        (g * self.frequencies.lapse() / state.lapse()).powi(2)
    }
}

/// Carries the end of a connection with an image of `u` in a glued space back to `u` itself.
fn carried_back(world: &World, u: DVec3, connection: Connection) -> Connection {
    let manifold = &world.manifold;
    let Some(gluing) = manifold.gluing() else {
        return connection;
    };
    let back = || {
        let (_, v, _) = manifold.brought_in(connection.u, connection.v)?;
        let (_, word) = gluing.locate(u)?;
        Some(gluing.carried(&word, u, DMat3::IDENTITY).inverse() * v)
    };
    let v = back().unwrap_or(connection.v);
    Connection { u, v, ..connection }
}

impl IncidentLight {
    /// Takes `share` of the lamp's intensity, positive on the front, along the tangent `v` of the light.
    fn new((lamp, light): (usize, &PointLight), share: f64, v: DVec3) -> Self {
        Self {
            lamp,
            irradiance: light.intensity.map(|i| f64::from(i) * share.abs()),
            front: share > 0.0,
            v,
        }
    }

    /// Returns what gloss asks of it.
    fn directed(&self) -> DirectedLight {
        DirectedLight {
            lamp: self.lamp as u32,
            front: self.front,
            v: self.v.as_vec3(),
            irradiance: self.irradiance.map(|x| x as f32),
        }
    }
}

/// Returns how many of the points at which `world` asks for light are spread evenly over its surfaces; all others are added
/// where light changes. Behind a bump one core lights 15,000 points a second.
pub fn even_points(world: &World) -> usize {
    2 * world.light_points / 5
}

/// Points lit by one thread at a time: enough to fill the integrator's lanes many times over.
const BLOCK: usize = 256;

/// Lights the points of `layout`, and as many more as the world asks for beside the [even ones](even_points); `done` is told
/// how many more are finished, and how many there are to be.
pub fn bake_light(
    lamps: &Lamps<'_>,
    mut layout: FacetLayout,
    done: impl Fn(usize, usize) + Sync,
) -> Lightmap {
    let world = lamps.world;
    let most = layout.len() + world.light_points - even_points(world);
    let more = |more: usize| done(more, most);
    let (mut values, mut directed) = (Vec::new(), DirectedLights::default());
    loop {
        let glossy = layout.points_on(|triangle| is_glossy_triangle(world, triangle));
        let new = values.len()..;
        for (light, images) in lit(lamps, (&layout.points[new.clone()], &glossy[new]), &more) {
            values.push(light);
            directed.push(images);
        }
        if !layout.refine(&values, most) {
            // There may be fewer than were allowed.
            done(0, values.len());
            let light = Lightmap::new(layout, values);
            let light = light.and_then(|light| light.with_directions(directed));
            return light.expect("every point has been lit");
        }
    }
}

/// Lights points, those that are `glossy` with the images that their light comes from; `done` is told how many more are
/// finished.
fn lit(
    lamps: &Lamps<'_>,
    (points, glossy): (&[SurfacePoint], &[bool]),
    done: &(impl Fn(usize) + Sync),
) -> Vec<(Light, Vec<DirectedLight>)> {
    let block = |(points, glossy): (&[SurfacePoint], &[bool])| -> Vec<_> {
        let mut sums = vec![([0.0_f64; 6], Vec::new()); points.len()];
        for (index, incident) in lamps.incident_light(points).0 {
            let side = if incident.front { 0 } else { 3 };
            let (sum, images) = &mut sums[index];
            for k in 0..3 {
                sum[side + k] += incident.irradiance[k];
            }
            if glossy[index] {
                images.push(incident.directed());
            }
        }
        done(points.len());
        let rounded = |(sum, images): ([f64; 6], _)| (sum.map(|x| x as f32), images);
        sums.into_iter().map(rounded).collect()
    };
    let blocks = points.par_chunks(BLOCK).zip(glossy.par_chunks(BLOCK));
    blocks.flat_map_iter(block).collect()
}
