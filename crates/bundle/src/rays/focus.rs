//! Directions named by what they aim at.
//!
//! In: a direction d and where its camera is. Out: the direction d₀ that a table knows it by, and back.
//!
//! Things near by are seen in other directions from each camera. In a table over cameras and
//! directions they then lie aslant, and what lies aslant takes tensor trains of high rank. A ray from
//! the camera at u is therefore named by the direction d₀ in which the middle m of the camera's cell
//! sees the point that the ray aims at on a sphere about m: `d ∝ d₀ − w`, with the parallax
//! `w = W (u − m)`. What is as far away as the sphere stays where it is when the camera moves. In flat
//! space with Cartesian coordinates that is exact for W = 1/R on the sphere of radius R. Elsewhere
//! `d₀ ↦ d` is a map of the sphere of directions onto itself all the same, for any |w| < 1, and all that
//! is lost is rank.

use super::cell;
use glam::{DMat3, DVec3};

/// The largest parallax: at 1 a direction would be lost.
const FARTHEST: f64 = 0.9;

/// The sphere that directions of a space aim at: nearby cameras then see alike in equal parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceSphere {
    /// W: from chart coordinates to the standard frame; zero if directions are named by themselves.
    parallax: DMat3,
    /// Cells along each stored camera parameter.
    cells: Vec<usize>,
}

impl Default for ReferenceSphere {
    /// Directions named by themselves.
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
        let (cell, inner) = cell::locate(&self.cells, intervals, camera);
        let middle = vec![0.0; inner.len()];
        Some(cell::parameters(&self.cells, intervals, &cell, &middle))
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

#[cfg(test)]
mod tests {
    use super::*;

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
        let focus = ReferenceSphere::new(DMat3::from_diagonal(DVec3::splat(0.5)), vec![1]);
        let target = 2.0 * DVec3::new(0.6, 0.0, 0.8);
        for offset in [DVec3::ZERO, DVec3::new(0.3, -0.7, 0.1)] {
            let d = (target - offset).normalize();
            let aim = aim_of(d, focus.parallax(offset));
            assert!((aim - target / 2.0).length() < 1e-14);
        }
    }
}
