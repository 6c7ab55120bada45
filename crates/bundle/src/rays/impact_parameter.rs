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
//! In a radial wind the tangent differs from the direction in which a ray is seen, and θ is that of the
//! latter. A ray of energy 1 then has the angular momentum `b = R sin θ/(1 + w cos θ)`, with w the outward
//! component of the wind: at most `R/√(1 − w²)`, at `cos θ = −w`, which parts inwards from outwards and
//! stands for `R` below. In a wind as fast as light there is no such bound, and all rays are across.
//!
//! `R₀` is the least areal radius of the camera region, so that every camera has every `b` up to
//! it; where that is 0 all rays are across, on face 0. `b = R₀ sin(πt/2)`: where `R = R₀` this makes θ itself even in `t`.

use geofan_expr::real::Real;
use std::f64::consts::{FRAC_PI_2, PI};

/// The most faces.
const FACES: usize = 3;

/// Cones narrower than this would be faces of no rays.
const NARROWEST: f64 = 1e-6;

/// A camera as its rays' angular momenta know it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Radius {
    /// The areal radius R.
    pub areal: f64,
    /// The outward component w of the wind, in the standard frame; 0 without one.
    pub wind: f64,
}

impl Radius {
    /// Without a wind.
    pub fn still(areal: f64) -> Self {
        Self { areal, wind: 0.0 }
    }

    /// The largest angular momentum of a ray; 0 where there is none.
    pub fn most(self) -> f64 {
        match 1.0 - self.wind * self.wind {
            _ if self.wind == 0.0 => self.areal,
            slow if slow > 0.0 => self.areal / slow.sqrt(),
            _ => 0.0,
        }
    }

    /// The angles to the outward radius, the outward one first, of the rays with angular momentum `b`:
    /// the solutions of `R sin θ − b w cos θ = b`.
    fn angles(self, b: f64) -> [f64; 2] {
        let (turn, size) = match self.wind == 0.0 {
            true => (0.0, self.areal),
            false => {
                let beside = b * self.wind;
                (beside.atan2(self.areal), self.areal.hypot(beside))
            }
        };
        let inner = (b / size).min(1.0).asin();
        [turn + inner, turn + (PI - inner)]
    }
}

/// The division of the angles for a region of cameras.
#[derive(Debug, Clone, Copy, Default)]
pub struct ImpactParameter {
    /// The least areal radius of the region; 0 leaves the rays across alone.
    least: f64,
}

impl ImpactParameter {
    /// For cameras whose largest radius is from `least` to `most`.
    pub fn new(least: f64, most: f64) -> Self {
        let least = if least > NARROWEST * most { least } else { 0.0 };
        Self { least }
    }

    /// The number of faces: all, or only the rays across.
    pub fn faces(&self) -> usize {
        if self.least > 0.0 { FACES } else { 1 }
    }

    /// The angle up to which face 1 goes, and from there the width of what is across.
    fn across(&self, radius: Radius) -> [f64; 2] {
        let [low, high] = match radius.areal > 0.0 {
            true => radius.angles(self.least),
            false => [0.0, PI],
        };
        // Without a wind both cones are the same.
        let width = match radius.wind == 0.0 {
            true => PI - 2.0 * low,
            false => high - low,
        };
        [low, width]
    }

    /// θ at a parameter of a face.
    pub fn angle(&self, face: usize, parameter: f64, radius: Radius) -> f64 {
        let t = 0.5 * (parameter + 1.0);
        let sides = || radius.angles(self.least * (FRAC_PI_2 * t).sin());
        match face {
            0 | 1 if self.least <= 0.0 => PI * t,
            0 if radius.areal > 0.0 => sides()[1],
            1 if radius.areal > 0.0 => sides()[0],
            0 => PI,
            1 => 0.0,
            _ => {
                let [low, width] = self.across(radius);
                low + width * t
            }
        }
    }

    /// The face and the parameter of each of the directions θ with (cos θ, sin θ) along `directions`, whose
    /// second component is at least 0, at areal radius `radius`: the inverse of [`ImpactParameter::angle`].
    #[inline(always)]
    pub fn parameters<const W: usize>(
        &self,
        directions: &[[f64; W]; 2],
        radius: Radius,
    ) -> ([usize; W], [f64; W]) {
        let [low, width] = self.across(radius);
        let width = width.max(f64::MIN_POSITIVE);
        let (last, still) = (self.faces() - 1, radius.wind == 0.0);
        let (mut faces, mut parameters) = ([0; W], [0.0; W]);
        for l in 0..W {
            let [x, y] = [directions[0][l], directions[1][l]];
            let length = Real::sqrt(x * x + y * y);
            let sine = (y / length).clamp(0.0, 1.0);
            let share = if still {
                1.0
            } else {
                1.0 + radius.wind * (x / length)
            };
            let inner = radius.areal * sine / share / self.least;
            let in_cone = (self.least > 0.0) & (inner <= 1.0);
            let across = ((Real::atan2(y, x) - low) / width).clamp(0.0, 1.0);
            let t = if in_cone {
                Real::asin(inner) / FRAC_PI_2
            } else {
                across
            };
            let outwards = x >= -radius.wind * length;
            faces[l] = if in_cone { usize::from(outwards) } else { last };
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
                    for wind in [0.0, 0.3, -0.8] {
                        let radius = Radius {
                            areal: radius,
                            wind,
                        };
                        let ([face], [parameter]) = orbits.parameters(&along, radius);
                        assert!(face < orbits.faces() && parameter.abs() <= 1.0);
                        let back = orbits.angle(face, parameter, radius);
                        assert!(
                            (back - theta).abs() < 1e-7,
                            "{least} {radius:?} {theta} {back}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn in_a_wind_angular_momentum_is_that_of_light_with_energy_one() {
        let orbits = ImpactParameter::new(1.0, 9.0);
        let momentum = |radius: Radius, face| {
            let angle = orbits.angle(face, 0.2, radius);
            radius.areal * angle.sin() / (1.0 + radius.wind * angle.cos())
        };
        let still = momentum(Radius::still(2.0), 0);
        for wind in [-0.7, 0.4] {
            for face in [0, 1] {
                let b = momentum(Radius { areal: 3.0, wind }, face);
                assert!((b - still).abs() < 1e-14, "{wind} {face}: {b} {still}");
            }
        }
    }

    #[test]
    fn angular_momentum_is_constant_along_parameters() {
        let orbits = ImpactParameter::new(1.0, 9.0);
        for radius in [1.0, 2.0, 9.0] {
            let b = radius * orbits.angle(0, 0.2, Radius::still(radius)).sin();
            let nearest = orbits.angle(0, 0.2, Radius::still(1.0)).sin();
            assert!((b - nearest).abs() < 1e-14);
        }
    }
}
