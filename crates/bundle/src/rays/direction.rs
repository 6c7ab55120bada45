//! Directions as parameters, both ways: on cube faces, over the whole sphere, by what they aim at, and by angular momentum.
//!
//! # Cube faces
//!
//! In: a unit direction `d` (standard frame). Out: a face 0..6 and (p, q) in [−1, 1]², and back.
//! The tangent warp makes equal steps of p and q nearly equal angles (within a factor √2 over a
//! face), so that polynomials in p and q spend their freedom evenly.
//!
//! # The whole sphere
//!
//! In: a unit vector in the standard frame. Out: parameters (a, b) in [−1, 1]²: the azimuth `φ = π a`
//! about the pole and the polar angle `θ = π (b + 1)/2` from it, and back ([`Sphere`]). At the poles, and where the
//! azimuth jumps from 1 to −1, nothing is special about a direction: smooth functions of it continue over
//! a pole on the opposite meridian, and around the circle.
//!
//! # What they aim at
//!
//! In: a direction d and where its camera is. Out: the direction d₀ that a table knows it by, and back
//! ([`ReferenceSphere`]).
//!
//! Things near by are seen in other directions from each camera. In a table over cameras and
//! directions they then lie aslant, and what lies aslant takes tensor trains of high rank. A ray from
//! the camera at u is therefore named by the direction d₀ in which the middle m of the camera's cell
//! sees the point that the ray aims at on a sphere about m: `d ∝ d₀ − w`, with the parallax
//! `w = W (u − m)`. What is as far away as the sphere stays where it is when the camera moves. In flat
//! space with Cartesian coordinates that is exact for W = 1/R on the sphere of radius R. Elsewhere
//! `d₀ ↦ d` is a map of the sphere of directions onto itself all the same, for any |w| < 1, and all that
//! is lost is rank.
//!
//! # Under rotation symmetry
//!
//! In: the angle θ in [0, π] to the outward radius and the areal radius `R` of the camera (circumference over 2π). Out: a
//! face and a parameter in [−1, 1], and back ([`ImpactParameter`]). A ray keeps its angular momentum `b = R sin θ`, and the
//! rays at which paths change their kind (those that wind about a photon sphere, where `R` has an extremum)
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

use super::{cell_of, parameters_in_cell};
use geofan_expr::real::Real;
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// The number of faces.
pub const FACES: usize = 6;

/// The direction at (p, q) of `face`: axis `face / 2`, negative if `face` is odd; p and q run along
/// the next two axes in cyclic order.
pub fn direction(face: usize, pq: DVec2) -> DVec3 {
    let axis = face / 2;
    let mut d = [0.0; 3];
    d[axis] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    d[(axis + 1) % 3] = (pq.x * FRAC_PI_4).tan();
    d[(axis + 2) % 3] = (pq.y * FRAC_PI_4).tan();
    DVec3::from_array(d).normalize()
}

/// The face and (p, q) of a direction: the inverse of [`direction`].
pub fn face_and_parameters(d: DVec3) -> (usize, DVec2) {
    let size = d.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let warp = |x: f64| (x / size[axis]).atan() / FRAC_PI_4;
    let pq = DVec2::new(warp(d[(axis + 1) % 3]), warp(d[(axis + 2) % 3]));
    (2 * axis + usize::from(d[axis] < 0.0), pq)
}

/// A pole and where azimuths are counted from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Columns: the directions of azimuths 0 and π/2, and the pole.
    axes: DMat3,
}

impl Sphere {
    /// With these axes (orthonormal columns): the directions of azimuths 0 and π/2, and the pole.
    pub fn new(axes: DMat3) -> Self {
        Self { axes }
    }

    /// Returns whether the axes are orthonormal: files may hold anything.
    pub fn is_valid(self) -> bool {
        let off = self.axes.transpose() * self.axes - DMat3::IDENTITY;
        off.to_cols_array().iter().all(|x| x.abs() < 1e-9)
    }

    /// The unit vector at (a, b).
    pub fn direction(self, [a, b]: [f64; 2]) -> DVec3 {
        let (sin, cos) = (PI * a).sin_cos();
        let (across, along) = (FRAC_PI_2 * (b + 1.0)).sin_cos();
        self.axes * DVec3::new(across * cos, across * sin, along)
    }

    /// The parameters of a unit vector: the inverse of [`Sphere::direction`].
    pub fn parameters(self, direction: DVec3) -> [f64; 2] {
        let d = self.axes.transpose() * direction;
        let theta = d.truncate().length().atan2(d.z);
        [d.y.atan2(d.x) / PI, theta / FRAC_PI_2 - 1.0]
    }
}

/// The polar parameter of the parallel at height `z` in [−1, 1] over the equator: even steps of z are
/// even shares of the sphere.
pub fn parallel(z: f64) -> f64 {
    z.clamp(-1.0, 1.0).acos() / FRAC_PI_2 - 1.0
}

/// The largest parallax: at 1 a direction would be lost.
const FARTHEST: f64 = 0.9;

/// The sphere on which rays of a cell are compared: rays of nearby cameras to one of its points have equal
/// parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceSphere {
    /// W: from chart coordinates to the standard frame; zero if directions are named by themselves.
    parallax: DMat3,
    /// Cells along each stored camera parameter.
    cells: Vec<usize>,
}

impl Default for ReferenceSphere {
    /// Makes a sphere without parallax: each direction is its own aim.
    fn default() -> Self {
        Self::new(DMat3::ZERO, Vec::new())
    }
}

impl ReferenceSphere {
    /// With the `parallax` W of cameras in `cells`.
    pub fn new(parallax: DMat3, cells: Vec<usize>) -> Self {
        Self { parallax, cells }
    }

    /// The parameters in the middle of the cell that holds `camera`; `None` without parallax.
    pub(super) fn middle(&self, intervals: &[[f64; 2]], camera: &[f64]) -> Option<Vec<f64>> {
        if self.parallax == DMat3::ZERO || camera.is_empty() {
            return None;
        }
        let (cell, inner) = cell_of(&self.cells, intervals, camera);
        let middle = vec![0.0; inner.len()];
        Some(parameters_in_cell(&self.cells, intervals, &cell, &middle))
    }

    /// The parallax of a camera at `offset` from the middle of its cell (chart coordinates).
    pub(super) fn parallax(&self, offset: DVec3) -> DVec3 {
        (self.parallax * offset).clamp_length_max(FARTHEST)
    }
}

/// The direction of a ray that is known as `aim`, a unit vector.
pub fn direction_of(aim: DVec3, parallax: DVec3) -> DVec3 {
    (aim - parallax).normalize()
}

/// The unit vector that a ray in the direction `d`, of any length, is known by: the inverse of
/// [`direction_of`].
pub fn aim_of(d: DVec3, parallax: DVec3) -> DVec3 {
    let d = d.normalize();
    let along = d.dot(parallax);
    let t = (along * along + 1.0 - parallax.length_squared()).sqrt() - along;
    d * t + parallax
}

/// The most faces by angular momentum.
const FACES_BY_MOMENTUM: usize = 3;

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
        if self.least > 0.0 {
            FACES_BY_MOMENTUM
        } else {
            1
        }
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
    fn parameters_and_directions_are_inverse() {
        for face in 0..FACES_BY_MOMENTUM {
            for i in 0..=20 {
                for j in 0..=20 {
                    let pq = DVec2::new(i as f64 - 10.0, j as f64 - 10.0) / 10.001;
                    let d = direction(face, pq);
                    assert!((d.length() - 1.0).abs() < 1e-15);
                    let (back, found) = face_and_parameters(d);
                    assert_eq!(back, face);
                    assert!((found - pq).length() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn directions_and_parameters_are_inverse() {
        let axes = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0);
        let sphere = Sphere::new(axes);
        assert!(sphere.is_valid() && !Sphere::new(axes * 1.1).is_valid());
        for i in 0..20 {
            for j in 0..=20 {
                let given = [f64::from(i) / 10.0 - 0.97, f64::from(j) / 10.0 - 1.0];
                let d = sphere.direction(given);
                assert!((d.length() - 1.0).abs() < 1e-15);
                let back = sphere.direction(sphere.parameters(d));
                assert!((d - back).length() < 1e-14);
            }
        }
        let z = (axes.transpose() * sphere.direction([0.2, parallel(0.3)])).z;
        assert!((z - 0.3).abs() < 1e-15);
    }

    #[test]
    fn directions_come_back() {
        for (parallax, d) in [
            (DVec3::ZERO, DVec3::new(0.3, -0.4, 0.8)),
            (DVec3::new(0.1, 0.5, -0.2), DVec3::new(0.3, -0.4, 0.8)),
            (DVec3::new(0.9, 0.0, 0.0), DVec3::new(2.0, 1e-3, 0.0)),
            (DVec3::new(0.9, 0.0, 0.0), DVec3::new(-2.0, 1e-3, 0.0)),
        ] {
            let aim = aim_of(d, parallax);
            assert!((aim.length() - 1.0).abs() < 1e-14);
            assert!((direction_of(aim, parallax) - d.normalize()).length() < 1e-14);
        }
    }

    /// In flat space all cameras of a cell aim at the same point of the sphere.
    #[test]
    fn cameras_aim_at_points_of_a_sphere() {
        let sphere = ReferenceSphere::new(DMat3::from_diagonal(DVec3::splat(0.5)), vec![1]);
        let target = 2.0 * DVec3::new(0.6, 0.0, 0.8);
        for offset in [DVec3::ZERO, DVec3::new(0.3, -0.7, 0.1)] {
            let d = (target - offset).normalize();
            let aim = aim_of(d, sphere.parallax(offset));
            assert!((aim - target / 2.0).length() < 1e-14);
        }
    }

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
