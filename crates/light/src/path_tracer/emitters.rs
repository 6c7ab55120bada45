//! Surfaces that give off light, chosen at random to connect to.
//!
//! In: a world. Out: points on its emitting triangles with their probability by area; connections to
//! them; and the probability with which a given connection would have been chosen.
//!
//! Two points may be joined by several geodesics. Newton's method from the chart-straight guess
//! finds one or none, and always the same: that one is the *principal* connection. Light that comes
//! by it is weighed between this and scattering; light that comes by another is found by scattering
//! alone, with its whole weight. So nothing is counted twice and nothing is lost.

use crate::{Connection, Shadows, ShootingStart, connect};
use geofan_core::random::Stream;
use geofan_render::{Footprint, Hit, World, redshift::SurfaceState, shade};
use glam::{DMat3, DVec3, Vec3};

/// Chooses among the emitting triangles of a world.
pub struct Emitters {
    triangles: Vec<u32>,
    /// Sums of the probabilities up to each and with it.
    sums: Vec<f64>,
}

/// A point on an emitter.
#[derive(Debug, Clone, Copy)]
pub struct EmitterPoint {
    /// Chart point.
    pub u: DVec3,
    /// Radiance given off, but as a black body.
    emitted: [f32; 3],
    /// Share of light that the surface stops there.
    solid: f32,
    /// The flat triangle's normal covector.
    pub normal: DVec3,
    /// Probability by area.
    pub by_area: f64,
    pub triangle: u32,
}

/// Directions of two geodesics between the same points that differ by less than this (radians) are
/// the same geodesic: the point where a traced ray meets an emitter is known to a hundredth of that,
/// and two that are as close have all but merged.
const SAME: f64 = 5e-3;

impl Emitters {
    /// Lists those of `world`, each chosen in proportion to its area and brightness. What moves while light is on its way is
    /// met by chance.
    pub fn new(world: &World) -> Self {
        let mut found = Self {
            triangles: Vec::new(),
            sums: Vec::new(),
        };
        let mut sum = 0.0;
        let shining = shining(world);
        let states = world.surface_states(&shining);
        for (k, (middle, triangle)) in shining.into_iter().enumerate() {
            let ke = ke(world, triangle);
            let sent = states.as_ref().map_or(ke, |states| states[k].sent(ke, 1.0));
            let bright: f64 = sent.iter().map(|k| f64::from(*k)).sum();
            let power = bright * square_area(world, triangle, middle);
            if power > 0.0 && power.is_finite() {
                sum += power;
                found.triangles.push(triangle);
                found.sums.push(sum);
            }
        }
        found.sums.iter_mut().for_each(|s| *s /= sum);
        found
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Tells whether `triangle` is one of them.
    pub fn has(&self, triangle: u32) -> bool {
        self.triangles.binary_search(&triangle).is_ok()
    }

    /// Chooses a point at random.
    pub fn choose(&self, world: &World, random: &mut Stream) -> EmitterPoint {
        let at = random.uniform();
        let i = self.sums.partition_point(|s| *s <= at);
        let triangle = self.triangles[i.min(self.triangles.len() - 1)];
        // Uniform in the triangle's own coordinates.
        let (mut b, mut c) = (random.uniform(), random.uniform());
        if b + c > 1.0 {
            (b, c) = (1.0 - b, 1.0 - c);
        }
        let [p, q, r] = world.accelerator.triangles()[triangle as usize];
        let mut chosen = self.at(world, triangle, p * (1.0 - b - c) + q * b + r * c);
        let here = Hit {
            s: 0.0,
            v: Vec3::ZERO,
            triangle,
            barycentric: [b as f32, c as f32],
        };
        chosen.emitted = shade::emission(world, &here, &Footprint::POINT);
        chosen.solid *= world.coverage(&here);
        chosen
    }

    /// Describes the point `u` of an emitting triangle.
    fn at(&self, world: &World, triangle: u32, u: DVec3) -> EmitterPoint {
        let [p, q, r] = world.accelerator.triangles()[triangle as usize];
        let material = world.faces[triangle as usize].material;
        let i = self.triangles.partition_point(|t| *t < triangle);
        let share = self.sums[i] - if i > 0 { self.sums[i - 1] } else { 0.0 };
        EmitterPoint {
            u,
            emitted: ke(world, triangle),
            solid: world.materials[material as usize].solid(),
            normal: (q - p).cross(r - p),
            // Uniform over the half unit square of coordinates, whose image is stretched.
            by_area: 2.0 * share / square_area(world, triangle, u),
            triangle,
        }
    }

    /// Returns the probability by solid angle at the start of `connection`, a principal one that ends
    /// at `hit`, on one of them, with which it would be chosen.
    pub fn probability(&self, world: &World, hit: &Hit, connection: &Connection) -> f64 {
        let chosen = self.at(world, hit.triangle, world.point(hit));
        chosen.by_solid_angle(world, connection)
    }
}

impl EmitterPoint {
    /// Returns the radiance given off at `g` times the frequencies of the surface, which is in this `state`.
    pub fn radiance(&self, state: Option<&SurfaceState>, g: f64) -> DVec3 {
        let light = state.map_or(self.emitted, |state| state.sent(self.emitted, g));
        DVec3::from_array(light.map(|x| f64::from(x * self.solid)))
    }

    /// Returns the cosine between the emitter's normal and the geodesic that arrives.
    pub fn cosine(&self, world: &World, connection: &Connection) -> f64 {
        let frame = rest_frame(world, self.u);
        let n = (frame.transpose() * self.normal).normalize_or_zero();
        let v = (frame.inverse() * connection.v).normalize_or_zero();
        n.dot(v).abs()
    }

    /// Returns the probability by area as one by solid angle at the other end.
    pub fn by_solid_angle(&self, world: &World, connection: &Connection) -> f64 {
        let cosine = self.cosine(world, connection).max(1e-12);
        self.by_area * connection.area.abs() / cosine
    }
}

/// Lists the triangles that give off light, with their middles, but those that move while light is on its way.
fn shining(world: &World) -> Vec<(DVec3, u32)> {
    let triangles = world.accelerator.triangles();
    let shines = |i: &u32| {
        let moves = world.accelerator.motion(*i).is_some();
        !moves && (world.glows(*i) || ke(world, *i) != [0.0; 3])
    };
    let found = (0..world.faces.len() as u32).filter(shines);
    let middle = |i: u32| triangles[i as usize].iter().sum::<DVec3>() / 3.0;
    found.map(|i| (middle(i), i)).collect()
}

/// Returns what the material of a triangle gives off, but as a black body.
fn ke(world: &World, triangle: u32) -> [f32; 3] {
    world.materials[world.faces[triangle as usize].material as usize].ke
}

/// Returns the area, in the metric at `u`, that the unit square of a triangle's barycentric
/// coordinates covers: twice that of the triangle.
fn square_area(world: &World, triangle: u32, u: DVec3) -> f64 {
    let [p, q, r] = world.accelerator.triangles()[triangle as usize];
    let into = rest_frame(world, u).inverse();
    (into * (q - p)).cross(into * (r - p)).length()
}

/// Returns the frame at `u` of what does not move.
fn rest_frame(world: &World, u: DVec3) -> DMat3 {
    match world.manifold.has_wind() {
        true => world.manifold.rest_frames(&[u])[0],
        false => world.manifold.standard_frame(u),
    }
}

/// Finds the principal connections of pairs of chart points, `None` where there is none; and tells
/// how many geodesics were followed for it.
pub fn principal_connections(
    world: &World,
    pairs: &[(DVec3, DVec3)],
    tolerance: f64,
) -> (Vec<Option<Connection>>, usize) {
    let starts: Vec<DVec3> = pairs.iter().map(|(from, _)| *from).collect();
    let locals = world.cover.local_frames(&starts);
    let starts = pairs.iter().zip(locals).enumerate();
    let starts = starts.filter_map(|(index, ((from, to), local))| {
        let to = nearest_image(world, *from, *to);
        let straight = local.frame.inverse() * (to - *from);
        Some(ShootingStart {
            index,
            from: *from,
            local,
            to,
            direction: straight.try_normalize()?,
            s: straight.length(),
            spread: None,
        })
    });
    let starts = starts.collect();
    let (found, followed) = connect(&world.cover, starts, tolerance, Shadows::Ignored);
    let mut principal = vec![None; pairs.len()];
    for (index, connection) in found {
        principal[index] = Some(connection);
    }
    (principal, followed)
}

/// Returns the image of `to`, whole periods away, that is nearest to `from` in each glued coordinate.
fn nearest_image(world: &World, from: DVec3, to: DVec3) -> DVec3 {
    let near = |k: usize| match world.manifold.domain.period(k) {
        Some(period) => to[k] - period * ((to[k] - from[k]) / period).round(),
        None => to[k],
    };
    DVec3::new(near(0), near(1), near(2))
}

/// Tells whether a ray that left in `direction` (standard frame) and came to the point after `s` is the
/// connection.
pub fn is_same_geodesic(connection: &Connection, direction: DVec3, s: f64) -> bool {
    (connection.direction - direction).length() < SAME && (connection.s / s - 1.0).abs() < SAME
}
