//! Scattering of light at a surface, by the numbers of an MTL material.
//!
//! In: a material's colours at a point, and directions away from the surface in a frame whose z is
//! the normal on the side of `wo`. Out: reflectance, and directions at random with their
//! probability by solid angle. The frame is orthonormal in the metric, so nothing here is curved.
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

use geofan_core::{geodesic::perpendiculars, random::Stream};
use geofan_render::{
    scene::Material,
    shade::{
        Reflectances,
        gloss::{distribution, lambda, lobe, roughness},
    },
};
use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_1_PI, TAU};

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
    /// Takes `material` where its diffuse reflectance is `kd`.
    pub fn new(material: &Material, kd: [f32; 3]) -> Self {
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
            false => Reflectances::new(material, kd),
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

/// An orthonormal frame around a normal, for directions.
#[derive(Debug, Clone, Copy)]
pub struct ShadingFrame {
    axes: [DVec3; 3],
}

impl ShadingFrame {
    /// Makes a frame with `normal` (unit) as z.
    pub fn new(normal: DVec3) -> Self {
        let [x, y] = perpendiculars(normal);
        Self {
            axes: [x, y, normal],
        }
    }

    /// Takes a vector from the frame around the normal to the one in which the normal is given.
    pub fn global(&self, w: DVec3) -> DVec3 {
        self.axes[0] * w.x + self.axes[1] * w.y + self.axes[2] * w.z
    }

    /// Undoes [`ShadingFrame::global`].
    pub fn local(&self, w: DVec3) -> DVec3 {
        DVec3::from_array(self.axes.map(|axis| axis.dot(w)))
    }
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
pub fn lobe_probability(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let m = (wo + wi).normalize_or_zero();
    distribution(m, alpha) / ((1.0 + lambda(wo, alpha)) * 4.0 * wo.z)
}

/// Returns the mirror direction of `wo` in a random visible microfacet; it may point below the surface.
pub fn lobe_sample(wo: DVec3, alpha: f64, random: DVec2) -> DVec3 {
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
    use geofan_core::random::Stream;
    use geofan_render::shade::gloss::lobe;

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
