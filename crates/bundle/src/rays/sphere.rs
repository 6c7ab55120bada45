//! Directions over the whole sphere as an azimuth and a polar angle, both ways.
//!
//! In: a unit vector in the standard frame. Out: parameters (a, b) in [−1, 1]²: the azimuth `φ = π a`
//! about the pole and the polar angle `θ = π (b + 1)/2` from it, and back. At the poles, and where the
//! azimuth jumps from 1 to −1, nothing is special about a direction: smooth functions of it continue over
//! a pole on the opposite meridian, and around the circle.

use glam::{DMat3, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
