//! A point of a surface as light meets it, and the scattering of light there by the numbers of an MTL material.
//!
//! In: a hit. Out: a [`SurfaceInteraction`]: frames, normals on the side from which the ray came, the light
//! it gives off and its scattering. Light is scattered in the frame of the surface: of what moves, in coordinates that
//! move with it.
//!
//! In: a material's colours at a point, and directions away from the surface in a frame whose z is
//! the normal on the side of `wo`. Out: reflectance, and directions at random with their
//! probability by solid angle ([`Bsdf`]). The frame is orthonormal in the metric, so nothing here is curved.
//!
//! | `illum` | model |
//! |---|---|
//! | 0, 1 | matt: `Kd` |
//! | 2 (and others) | matt `Kd` and glossy `Ks` with exponent `Ns` |
//! | 3, 4, 5, 8 | matt `Kd` and a mirror `Ks` |
//! | 6, 7 | glass of index `Ni` |
//!
//! `d` below 1 lets the rest of the light through unturned: that is all that 4 and 9 mean by glass, and
//! Maya gives 4 to whatever it exports. Where `Kd + Ks` exceeds 1, both are
//! scaled down, so that no surface gives off more than it receives.
//!
//! Directions of the glossy lobe come by microfacet normals drawn from those that are visible (E. Heitz, *Sampling the
//! GGX Distribution of Visible Normals*, JCGT 2018).

use geofan_core::{geodesic::perpendiculars, manifold::LocalFrame, random::Stream};
use geofan_render::{
    Footprint, Hit, SurfacePoint, World,
    redshift::SurfaceState,
    scene::Material,
    shade::{
        self, Reflectances,
        gloss::{distribution, lambda, lobe, roughness},
    },
};
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::{FRAC_1_PI, TAU};

/// Describes a surface where a ray has met it.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceInteraction {
    /// The hit of the ray.
    pub hit: Hit,
    /// The point, for lamps.
    pub point: SurfacePoint,
    /// The normal observer there, the same in coordinates that move with the surface, and the metric.
    local: LocalFrame,
    moving: LocalFrame,
    metric: DMat3,
    /// The frame of the surface, and its inverse.
    frame: DMat3,
    inverse: DMat3,
    /// How far the surface moves for each unit of arc length of lines of sight, chart components.
    pace: DVec3,
    /// The frame around the normal, on the side of the ray.
    around: DMat3,
    /// Towards where the ray came from, around the normal.
    pub wo: DVec3,
    /// Set if that is the side to which the mesh's normal points.
    pub outside: bool,
    /// The flat triangle's normal on that side, around the shading normal.
    flat: DVec3,
    /// Radiance given off, but as a black body.
    emitted: [f32; 3],
    /// How it moves and how hot it is; `None` where frequencies of light and motion do not matter.
    pub state: Option<SurfaceState>,
    pub bsdf: Bsdf,
}

impl SurfaceInteraction {
    /// Describes what each of `hits` met.
    pub fn of_hits(world: &World, hits: &[Hit]) -> Vec<Self> {
        let points: Vec<DVec3> = hits.iter().map(|hit| world.point(hit)).collect();
        let locals = world.manifold.local_frames(&points);
        let triangles = hits.iter().map(|hit| hit.triangle);
        let places: Vec<(DVec3, u32)> = points.iter().copied().zip(triangles).collect();
        let states = world.surface_states(&places);
        let observers = points.into_iter().zip(locals).enumerate();
        let surface = |(hit, (i, (u, local)))| {
            let state = states.as_ref().map(|states| states[i]);
            Self::new(world, hit, (u, local), state)
        };
        hits.iter().zip(observers).map(surface).collect()
    }

    /// Describes what `hit` met, at the chart point `u` with this `local`, and in this `state`.
    fn new(
        world: &World,
        hit: &Hit,
        (u, local): (DVec3, LocalFrame),
        state: Option<SurfaceState>,
    ) -> Self {
        let pace = state.map_or(DVec3::ZERO, |state| state.pace());
        let moving = match pace == DVec3::ZERO {
            true => local,
            false => local.moving(pace),
        };
        let metric = match moving.wind {
            Some(_) => world.manifold.metric(u),
            None => DMat3::IDENTITY,
        };
        let frame = moving.rest_frame(metric);
        let face = &world.faces[hit.triangle as usize];
        let material = &world.materials[face.material as usize];
        let inverse = frame.inverse();
        let back = -(inverse * (hit.v.as_dvec3() - pace)).normalize_or_zero();
        let (flat, normal, outside) = normals((world, hit), state, frame, back);
        let chosen = inverse.transpose() * normal;
        let emitted = shade::emission(world, hit, &Footprint::POINT);
        let kd = shade::diffuse(world, hit, &Footprint::POINT);
        let bsdf = Bsdf::new(material, kd, shade::specular(world, hit))
            .covering(f64::from(world.coverage(hit)));
        let around = frame_around(match bsdf.mirrors() {
            true => mirroring_normal(normal, flat, back),
            false => normal,
        });
        let glows = state.is_some_and(|state| state.glows());
        Self {
            hit: *hit,
            point: SurfacePoint {
                u,
                normal: state.map_or(chosen, |state| state.untilted(chosen)),
                triangle: hit.triangle,
            },
            local,
            moving,
            metric,
            frame,
            inverse,
            pace,
            wo: around.transpose() * back,
            flat: around.transpose() * flat,
            around,
            outside,
            emitted,
            state,
            bsdf: if glows { bsdf.black() } else { bsdf },
        }
    }

    /// Returns the radiance that it gives off, seen at `g` times the frequencies that it has there.
    pub fn emitted(&self, g: f64) -> DVec3 {
        let light = match &self.state {
            Some(state) => state.sent(self.emitted, g),
            None => self.emitted,
        };
        DVec3::from_array(light.map(f64::from)) * self.bsdf.solid()
    }

    /// Returns the direction (around the normal) of a path with the tangent `v`, of any length.
    pub fn direction(&self, v: DVec3) -> DVec3 {
        let along = self.inverse * (v - self.pace);
        self.around.transpose() * along.normalize_or_zero()
    }

    /// Returns the tangent of the path in a direction around the normal.
    pub fn tangent(&self, w: DVec3) -> DVec3 {
        let along = self.frame * (self.around * w);
        match self.moving.wind {
            Some(_) => self.moving.along(self.metric, along) + self.pace,
            None => along,
        }
    }

    /// Returns the direction around the normal that the normal observer sees as `d` (standard frame).
    pub fn around_normal(&self, d: DVec3) -> DVec3 {
        match self.moving.wind {
            Some(_) => self.direction(self.local.tangent(d)),
            None => self.around.transpose() * d,
        }
    }

    /// Inverts [`Self::around_normal`].
    pub fn sight_of(&self, w: DVec3) -> DVec3 {
        match self.moving.wind {
            Some(_) => self.local.direction(self.tangent(w)),
            None => self.around * w,
        }
    }

    /// Tells how much larger a solid angle around the direction `w` is to the normal observer.
    pub fn spread_to_sight(&self, w: DVec3) -> f64 {
        let tangent = || self.tangent(w) - self.pace;
        match self.moving.wind {
            Some(_) => self.moving.spread_against_rest(self.metric, tangent()),
            None => 1.0,
        }
    }

    /// Tells whether the smooth surface and the flat triangle agree about which side `w` is on.
    pub fn is_possible(&self, w: DVec3) -> bool {
        (w.z > 0.0) == (w.dot(self.flat) > 0.0)
    }

    /// Returns the chart point a distance `off` (in the metric) from the triangle, on the side of `w`: rays
    /// that start there do not meet the triangle again by rounding.
    pub fn beside(&self, w: DVec3, off: f64) -> DVec3 {
        let side = off.copysign(w.dot(self.flat));
        self.point.u + self.frame * (self.around * self.flat) * side
    }
}

/// Scatters light at one point of a surface.
#[derive(Debug, Clone, Copy)]
pub struct Bsdf {
    diffuse: DVec3,
    specular: DVec3,
    specular_model: SpecularModel,
    /// Probability that light goes through unturned.
    through: f64,
}

/// Says how the specular part is reflected.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SpecularModel {
    /// Microfacets of a roughness.
    Glossy(f64),
    Mirror,
    /// Everything is refracted or reflected, by the index of refraction.
    Glass(f64),
}

/// A direction at random.
#[derive(Debug, Clone, Copy)]
pub struct Scattered {
    /// Set if the light has gone through unturned, as if nothing were there.
    pub unturned: bool,
    /// Away from the surface; below it (z < 0) if the light goes through.
    pub wi: DVec3,
    /// Reflectance times cosine over probability.
    pub weight: DVec3,
    /// Probability by solid angle; `None` if this is the only direction there is (mirror, glass).
    pub probability: Option<f64>,
}

impl Bsdf {
    /// Takes `material` where its diffuse and specular reflectances are `kd` and `ks`.
    pub fn new(material: &Material, kd: [f32; 3], ks: [f32; 3]) -> Self {
        let specular_model = match material.illumination {
            3 | 4 | 5 | 8 => SpecularModel::Mirror,
            _ if material.is_glass() => SpecularModel::Glass(f64::from(material.ni).max(1e-3)),
            _ => SpecularModel::Glossy(roughness(f64::from(material.ns))),
        };
        let glass = matches!(specular_model, SpecularModel::Glass(_));
        let Reflectances { diffuse, specular } = match glass {
            true => Reflectances {
                diffuse: DVec3::ZERO,
                specular: DVec3::ONE,
            },
            false => Reflectances::new(kd, ks),
        };
        Self {
            diffuse,
            specular,
            specular_model,
            through: 1.0 - f64::from(material.solid()),
        }
    }

    /// Restricts it to a share of the surface; the rest lets light through.
    pub fn covering(self, share: f64) -> Self {
        let through = 1.0 - self.solid() * share;
        Self { through, ..self }
    }

    /// Takes away all that it reflects; what goes through still does.
    pub fn black(self) -> Self {
        Self {
            diffuse: DVec3::ZERO,
            specular: DVec3::ZERO,
            specular_model: SpecularModel::Glossy(1.0),
            ..self
        }
    }

    /// Returns the share of light that does not go through unturned.
    pub fn solid(&self) -> f64 {
        1.0 - self.through
    }

    /// Tells whether light from a given direction is reflected to the viewer at all: not by mirrors alone.
    pub fn is_rough(&self) -> bool {
        self.through < 1.0
            && (self.diffuse != DVec3::ZERO
                || matches!(self.specular_model, SpecularModel::Glossy(_))
                    && self.specular != DVec3::ZERO)
    }

    /// Tells whether a part of it reflects as a mirror does.
    fn mirrors(&self) -> bool {
        !matches!(self.specular_model, SpecularModel::Glossy(_))
    }

    /// Returns the reflectance per solid angle, without the cosine, of the rough parts; zero through the surface.
    pub fn reflectance(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return DVec3::ZERO;
        }
        let glossy = match self.specular_model {
            SpecularModel::Glossy(alpha) if self.specular != DVec3::ZERO => {
                self.specular * lobe(wo, wi, alpha)
            }
            _ => DVec3::ZERO,
        };
        (self.diffuse * FRAC_1_PI + glossy) * (1.0 - self.through)
    }

    /// Returns the probability by solid angle with which [`Bsdf::scatter`] gives `wi` by its rough parts.
    pub fn probability(&self, wo: DVec3, wi: DVec3) -> f64 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return 0.0;
        }
        let matt = self.matt_share();
        let glossy = match self.specular_model {
            SpecularModel::Glossy(alpha) => lobe_probability(wo, wi, alpha),
            _ => 0.0,
        };
        (1.0 - self.through) * (matt * wi.z * FRAC_1_PI + (1.0 - matt) * glossy)
    }

    /// Returns the share of the light that is scattered by the matt part.
    fn matt_share(&self) -> f64 {
        let (matt, other) = (self.diffuse.element_sum(), self.specular.element_sum());
        if matt + other > 0.0 {
            matt / (matt + other)
        } else {
            1.0
        }
    }

    /// Chooses a direction at random for light that leaves towards `wo`; `outside` says whether that is the
    /// side to which the surface's normal points. `None`: the light is absorbed.
    pub fn scatter(&self, wo: DVec3, outside: bool, random: &mut Stream) -> Option<Scattered> {
        if random.uniform() < self.through {
            return Some(Scattered {
                unturned: true,
                wi: -wo,
                weight: DVec3::ONE,
                probability: None,
            });
        }
        let matt = self.matt_share();
        let choice = random.uniform();
        let two = DVec2::new(random.uniform(), random.uniform());
        let wi = match self.specular_model {
            SpecularModel::Glass(index) => {
                return refracted(wo, if outside { index } else { 1.0 / index }, two.x);
            }
            _ if choice < matt => cosine_direction(two),
            SpecularModel::Mirror => {
                return Some(Scattered {
                    unturned: false,
                    wi: DVec3::new(-wo.x, -wo.y, wo.z),
                    weight: self.specular / (1.0 - matt),
                    probability: None,
                });
            }
            SpecularModel::Glossy(alpha) => lobe_sample(wo, alpha, two),
        };
        let probability = self.probability(wo, wi);
        (probability > 0.0).then(|| Scattered {
            unturned: false,
            wi,
            weight: self.reflectance(wo, wi) * (wi.z / probability),
            probability: Some(probability),
        })
    }
}

/// Chooses a direction above the surface with probability cosθ / π.
fn cosine_direction(random: DVec2) -> DVec3 {
    let (r, phi) = (random.x.sqrt(), TAU * random.y);
    DVec3::new(
        r * phi.cos(),
        r * phi.sin(),
        (1.0 - random.x).max(0.0).sqrt(),
    )
}

/// Reflects or refracts at random in Fresnel's proportion; `index` is that of the far side over
/// that of the near one. Radiance grows by the square of the index on the way in and shrinks on the
/// way out.
fn refracted(wo: DVec3, index: f64, choice: f64) -> Option<Scattered> {
    let sin2 = (1.0 - wo.z * wo.z).max(0.0) / (index * index);
    let mirrored = |weight: f64| Scattered {
        unturned: false,
        wi: DVec3::new(-wo.x, -wo.y, wo.z),
        weight: DVec3::splat(weight),
        probability: None,
    };
    if sin2 >= 1.0 {
        return Some(mirrored(1.0));
    }
    let cosine = (1.0 - sin2).sqrt();
    let parallel = (index * wo.z - cosine) / (index * wo.z + cosine);
    let across = (wo.z - index * cosine) / (wo.z + index * cosine);
    let fresnel = 0.5 * (parallel * parallel + across * across);
    if choice < fresnel {
        return Some(mirrored(1.0));
    }
    Some(Scattered {
        unturned: false,
        wi: DVec3::new(-wo.x / index, -wo.y / index, -cosine),
        weight: DVec3::splat(1.0 / (index * index)),
        probability: None,
    })
}

/// Returns the normal of the flat triangle that was hit and the one for shading, both in `frame` and on the side of a ray
/// that came from `back`; and whether this is the outside.
fn normals(
    (world, hit): (&World, &Hit),
    state: Option<SurfaceState>,
    frame: DMat3,
    back: DVec3,
) -> (DVec3, DVec3, bool) {
    let tilted = |covector: DVec3| state.map_or(covector, |state| state.tilted(covector));
    let [p, q, r] = world.accelerator.triangles()[hit.triangle as usize];
    let across = (frame.transpose() * tilted((q - p).cross(r - p))).normalize_or_zero();
    let flat = if across.dot(back) < 0.0 {
        -across
    } else {
        across
    };
    let smooth = (frame.transpose() * tilted(world.covector(hit))).normalize_or(flat);
    let outside = smooth.dot(flat) >= 0.0;
    let facing = if outside { smooth } else { -smooth };
    // A smoothed normal that looks away from the viewer is not used.
    let normal = if facing.dot(back) > 0.0 { facing } else { flat };
    (flat, normal, outside)
}

/// Sine of the least angle to its triangle at which a mirror's light leaves, and the most of the angle at which it comes: what
/// comes along the triangle leaves along it.
const SHALLOWEST: f64 = 0.01;
const SHALLOWER: f64 = 0.9;

/// Returns the smoothed `normal`, turned so far that what comes from `back` is reflected to the front of the triangle with
/// the normal `flat`: at the rim of a smoothed mesh a mirror would reflect into itself and be black there.
fn mirroring_normal(normal: DVec3, flat: DVec3, back: DVec3) -> DVec3 {
    let mirrored = normal * (2.0 * normal.dot(back)) - back;
    let least = SHALLOWEST.min(SHALLOWER * back.dot(flat));
    if mirrored.dot(flat) >= least {
        return normal;
    }
    let along = (mirrored - flat * mirrored.dot(flat)).normalize_or_zero();
    let lifted = along * (1.0 - least * least).sqrt() + flat * least;
    (back + lifted).normalize_or(flat)
}

/// Makes an orthonormal frame with `normal` (unit) as z. It takes a vector around the normal to the frame in which the
/// normal is given; its transpose takes one back.
fn frame_around(normal: DVec3) -> DMat3 {
    let [x, y] = perpendiculars(normal);
    DMat3::from_cols(x, y, normal)
}

/// Weighs probabilities against each other (E. Veach's balance heuristic): returns the share of `own`.
pub fn balance(own: f64, other: f64) -> f64 {
    if own + other > 0.0 {
        own / (own + other)
    } else {
        0.0
    }
}

/// Returns the probability by solid angle with which [`lobe_sample`] gives `wi`.
fn lobe_probability(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let m = (wo + wi).normalize_or_zero();
    distribution(m, alpha) / ((1.0 + lambda(wo, alpha)) * 4.0 * wo.z)
}

/// Returns the mirror direction of `wo` in a random visible microfacet; it may point below the surface.
fn lobe_sample(wo: DVec3, alpha: f64, random: DVec2) -> DVec3 {
    // Stretch space until the microfacets are a hemisphere.
    let stretched = DVec3::new(alpha * wo.x, alpha * wo.y, wo.z).normalize();
    let flat = DVec2::new(stretched.x, stretched.y);
    let t1 = match flat.length() > 1e-12 {
        true => DVec3::new(-flat.y, flat.x, 0.0) / flat.length(),
        false => DVec3::X,
    };
    let t2 = stretched.cross(t1);
    // A random point of the disc under it, moved to the visible part.
    let r = random.x.sqrt();
    let (x, y) = (r * (TAU * random.y).cos(), r * (TAU * random.y).sin());
    let half = 0.5 * (1.0 + stretched.z);
    let y = (1.0 - half) * (1.0 - x * x).sqrt() + half * y;
    let z = (1.0 - x * x - y * y).max(0.0).sqrt();
    // The normal there, with the stretch undone.
    let m = t1 * x + t2 * y + stretched * z;
    let m = DVec3::new(alpha * m.x, alpha * m.y, m.z.max(1e-12)).normalize();
    m * (2.0 * wo.dot(m)) - wo
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_reflects_to_the_front_of_its_triangle() {
        let (flat, mut stream) = (DVec3::Z, Stream::new(&[5]));
        for _ in 0..1000 {
            let turn = |stream: &mut Stream| stream.between(-1.0, 1.0);
            let normal = DVec3::new(turn(&mut stream), turn(&mut stream), 1.0).normalize();
            let back = DVec3::new(turn(&mut stream), turn(&mut stream), 0.02).normalize();
            if normal.dot(back) <= 0.0 {
                continue;
            }
            let bent = mirroring_normal(normal, flat, back);
            let mirrored = bent * (2.0 * bent.dot(back)) - back;
            assert!(mirrored.z > 0.0 && bent.dot(back) > 0.0, "{normal} {back}");
        }
        let steep = DVec3::new(0.1, 0.2, 1.0).normalize();
        assert_eq!(mirroring_normal(steep, flat, DVec3::Z), steep);
    }

    #[test]
    fn the_samples_are_as_probable_as_said() {
        // The mean of 1 / p over samples in the upper half is its solid angle, in any part of it.
        let mut stream = Stream::new(&[4]);
        let wo = DVec3::new(0.5, -0.3, 0.6).normalize();
        for alpha in [0.2, 0.7] {
            let wanted = |wi: &DVec3| wi.z > 0.3 && wi.z < 0.8 && wi.x < 0.0;
            let n = 200_000;
            let mut sum = 0.0;
            for _ in 0..n {
                let wi = lobe_sample(wo, alpha, DVec2::new(stream.uniform(), stream.uniform()));
                if wanted(&wi) && wi.y > 0.0 {
                    sum += 1.0 / lobe_probability(wo, wi, alpha);
                }
            }
            // A quarter of the zone between the two heights.
            let expected = TAU * 0.5 / 4.0;
            let found = sum / f64::from(n);
            assert!(
                (found / expected - 1.0).abs() < 0.03,
                "{alpha}: {found} {expected}"
            );
        }
    }

    #[test]
    fn the_roughest_surface_seen_from_above_reflects_what_an_integral_says() {
        // For α = 1 and wo = z microfacet normals are cosine-distributed, Λ = (1/cosθ − 1)/2, and
        // the albedo is ∫ c/(1 + c) dc over [0, 1].
        let mut stream = Stream::new(&[8]);
        let n = 200_000;
        let mut sum = 0.0;
        for _ in 0..n {
            let wi = lobe_sample(
                DVec3::Z,
                1.0,
                DVec2::new(stream.uniform(), stream.uniform()),
            );
            if wi.z > 0.0 {
                sum += lobe(DVec3::Z, wi, 1.0) * wi.z / lobe_probability(DVec3::Z, wi, 1.0);
            }
        }
        let expected = 1.0 - 2.0_f64.ln();
        assert!((sum / f64::from(n) - expected).abs() < 3e-3);
    }

    #[test]
    fn no_energy_is_made() {
        let mut stream = Stream::new(&[4]);
        for alpha in [0.05, 0.3, 1.0] {
            for z in [0.1, 0.5, 0.99] {
                let wo = DVec3::new((1.0_f64 - z * z).sqrt(), 0.0, z);
                let n = 20_000;
                let mut sum = 0.0;
                for _ in 0..n {
                    let wi = lobe_sample(wo, alpha, DVec2::new(stream.uniform(), stream.uniform()));
                    if wi.z > 0.0 {
                        sum += lobe(wo, wi, alpha) * wi.z / lobe_probability(wo, wi, alpha);
                    }
                }
                let albedo = sum / f64::from(n);
                assert!(albedo < 1.001 && albedo > 0.3, "{alpha} {z}: {albedo}");
            }
        }
    }
}
