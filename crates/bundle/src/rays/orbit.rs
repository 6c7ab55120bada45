//! Directions under rotation symmetry: the angle θ to the outward radius, by faces along which the
//! angular momentum is constant.
//!
//! In: θ in [0, π] and the areal radius `R` of the camera (circumference over 2π). Out: a face and
//! a parameter in [−1, 1], and back. A ray keeps its angular momentum `b = R sin θ`, and the rays at
//! which paths change their kind (those that wind about a photon sphere, where `R` has an extremum)
//! share one `b` for all cameras. With `b` as the parameter the edge between the kinds is a line of
//! constant parameter, to which boxes can be halved in one axis; with θ it is a curve, along which
//! boxes must be halved in both (measured on the Ellis wormhole: five times as many).
//!
//! | face | rays | θ |
//! |---|---|---|
//! | 0 | inwards, `b ≤ R₀` | `π − asin(b/R)` |
//! | 1 | outwards, `b ≤ R₀` | `asin(b/R)` |
//! | 2 | across, `b > R₀` | from `asin(R₀/R)` evenly to `π − asin(R₀/R)` |
//!
//! `R₀` is the least areal radius of the camera region, so that every camera has every `b` up to
//! it; where that is 0 all rays are across, on face 0. `b = R₀ sin(πt/2)`: where `R = R₀` this makes θ itself even in `t`.

use geofan_expr::real::Real;
use std::f64::consts::{FRAC_PI_2, PI};

/// The most faces.
const FACES: usize = 3;

/// Cones narrower than this would be faces of no rays.
const NARROWEST: f64 = 1e-6;

/// The division of the angles for a region of cameras.
#[derive(Debug, Clone, Copy, Default)]
pub struct ImpactParameter {
    /// The least areal radius of the region; 0 leaves the rays across alone.
    least: f64,
}

impl ImpactParameter {
    /// For cameras with areal radii from `least` to `most`.
    pub fn new(least: f64, most: f64) -> Self {
        let least = if least > NARROWEST * most { least } else { 0.0 };
        Self { least }
    }

    /// The number of faces: all, or only the rays across.
    pub fn faces(&self) -> usize {
        if self.least > 0.0 { FACES } else { 1 }
    }

    /// The half-angle of the cones that faces 0 and 1 fill, at areal radius `radius`.
    fn cone(&self, radius: f64) -> f64 {
        match radius > 0.0 {
            true => (self.least / radius).min(1.0).asin(),
            false => 0.0,
        }
    }

    /// θ at a parameter of a face.
    pub fn angle(&self, face: usize, parameter: f64, radius: f64) -> f64 {
        let t = 0.5 * (parameter + 1.0);
        let inner = || {
            (self.least * (FRAC_PI_2 * t).sin() / radius)
                .min(1.0)
                .asin()
        };
        match face {
            0 | 1 if self.least <= 0.0 => PI * t,
            0 if radius > 0.0 => PI - inner(),
            1 if radius > 0.0 => inner(),
            0 => PI,
            1 => 0.0,
            _ => {
                let cone = self.cone(radius);
                cone + (PI - 2.0 * cone) * t
            }
        }
    }

    /// The face and the parameter of each of the directions θ with (cos θ, sin θ) along `directions`, whose
    /// second component is at least 0, at areal radius `radius`: the inverse of [`ImpactParameter::angle`].
    #[inline(always)]
    pub fn parameters<const W: usize>(
        &self,
        directions: &[[f64; W]; 2],
        radius: f64,
    ) -> ([usize; W], [f64; W]) {
        let cone = self.cone(radius);
        let width = (PI - 2.0 * cone).max(f64::MIN_POSITIVE);
        let last = self.faces() - 1;
        let (mut faces, mut parameters) = ([0; W], [0.0; W]);
        for l in 0..W {
            let [x, y] = [directions[0][l], directions[1][l]];
            let sine = (y / Real::sqrt(x * x + y * y)).clamp(0.0, 1.0);
            let inner = radius * sine / self.least;
            let in_cone = (self.least > 0.0) & (inner <= 1.0);
            let across = ((Real::atan2(y, x) - cone) / width).clamp(0.0, 1.0);
            let t = if in_cone {
                Real::asin(inner) / FRAC_PI_2
            } else {
                across
            };
            faces[l] = if in_cone { usize::from(x >= 0.0) } else { last };
            parameters[l] = 2.0 * t - 1.0;
        }
        (faces, parameters)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_and_parameters_are_inverse() {
        for least in [0.0, 0.3, 1.0] {
            let orbits = ImpactParameter::new(least, 40.0);
            for radius in [1.0, 1.001, 1.7, 40.0] {
                for i in 0..=400 {
                    let theta = PI * f64::from(i) / 400.0;
                    let along = [[theta.cos()], [theta.sin()]];
                    let ([face], [parameter]) = orbits.parameters(&along, radius);
                    assert!(face < orbits.faces() && parameter.abs() <= 1.0);
                    let back = orbits.angle(face, parameter, radius);
                    assert!(
                        (back - theta).abs() < 1e-7,
                        "{least} {radius} {theta} {back}"
                    );
                }
            }
        }
    }

    #[test]
    fn angular_momentum_is_constant_along_parameters() {
        let orbits = ImpactParameter::new(1.0, 9.0);
        for radius in [1.0, 2.0, 9.0] {
            let b = radius * orbits.angle(0, 0.2, radius).sin();
            assert!((b - orbits.angle(0, 0.2, 1.0).sin()).abs() < 1e-14);
        }
    }
}
