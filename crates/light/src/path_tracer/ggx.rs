//! Directions of the glossy lobe ([`geofan_render::shade::ggx`]) at random.
//!
//! In: unit vectors in a frame whose z is the normal, and the roughness α. Out: directions by microfacet normals
//! drawn from those that are visible (E. Heitz, *Sampling the GGX Distribution of Visible Normals*, JCGT 2018), and their
//! probability.

use geofan_render::shade::ggx::{distribution, lambda};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Returns the probability by solid angle with which [`sample`] gives `wi`.
pub fn probability(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let m = (wo + wi).normalize_or_zero();
    distribution(m, alpha) / ((1.0 + lambda(wo, alpha)) * 4.0 * wo.z)
}

/// Returns the mirror direction of `wo` in a random visible microfacet; it may point below the surface.
pub fn sample(wo: DVec3, alpha: f64, random: DVec2) -> DVec3 {
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
    use geofan_render::shade::ggx::lobe;

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
                let wi = sample(wo, alpha, DVec2::new(stream.uniform(), stream.uniform()));
                if wanted(&wi) && wi.y > 0.0 {
                    sum += 1.0 / probability(wo, wi, alpha);
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
            let wi = sample(
                DVec3::Z,
                1.0,
                DVec2::new(stream.uniform(), stream.uniform()),
            );
            if wi.z > 0.0 {
                sum += lobe(DVec3::Z, wi, 1.0) * wi.z / probability(DVec3::Z, wi, 1.0);
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
                    let wi = sample(wo, alpha, DVec2::new(stream.uniform(), stream.uniform()));
                    if wi.z > 0.0 {
                        sum += lobe(wo, wi, alpha) * wi.z / probability(wo, wi, alpha);
                    }
                }
                let albedo = sum / f64::from(n);
                assert!(albedo < 1.001 && albedo > 0.3, "{alpha} {z}: {albedo}");
            }
        }
    }
}
