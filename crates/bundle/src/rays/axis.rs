//! Rotations about an axis of the chart.
//!
//! In: a chart point. Out: its distance from the axis and its place along it, the stored point on the
//! meridian with the same two, and the rotation that takes the stored point to it. For the axis z the
//! stored point is (ρ, 0, z); for x and y the coordinates follow each other in the same order.

use glam::{DMat3, DVec3};

/// An axis of the chart about which everything may be turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axis(pub usize);

impl Axis {
    /// The coordinates in which the stored meridian lies and across it.
    fn across(self) -> [usize; 2] {
        [(self.0 + 1) % 3, (self.0 + 2) % 3]
    }

    /// The distance of `u` from the axis and its place along it.
    pub fn invariants(self, u: DVec3) -> [f64; 2] {
        let [i, j] = self.across();
        [u[i].hypot(u[j]), u[self.0]]
    }

    /// The stored point with these invariants.
    pub fn stored(self, [distance, along]: [f64; 2]) -> DVec3 {
        let mut u = DVec3::ZERO;
        u[self.across()[0]] = distance;
        u[self.0] = along;
        u
    }

    /// The rotation by `angle`.
    pub fn rotation(self, angle: f64) -> DMat3 {
        DMat3::from_axis_angle(DVec3::AXES[self.0], angle)
    }

    /// The rotation that takes the stored meridian to `u`; any on the axis itself.
    pub fn to(self, u: DVec3) -> DMat3 {
        let [i, j] = self.across();
        let distance = u[i].hypot(u[j]);
        let (cos, sin) = match distance > 0.0 {
            true => (u[i] / distance, u[j] / distance),
            false => (1.0, 0.0),
        };
        let mut columns = [DVec3::AXES[self.0]; 3];
        columns[i] = DVec3::AXES[i] * cos + DVec3::AXES[j] * sin;
        columns[j] = DVec3::AXES[j] * cos - DVec3::AXES[i] * sin;
        DMat3::from_cols(columns[0], columns[1], columns[2])
    }

    /// Computes the change of the invariants when the point `u` moves by `du`: the distance, then the place.
    pub fn change(self, u: DVec3, du: DVec3) -> [f64; 2] {
        let [i, j] = self.across();
        let distance = u[i].hypot(u[j]);
        let outwards = (u[i] * du[i] + u[j] * du[j]) / distance;
        [if distance > 0.0 { outwards } else { 0.0 }, du[self.0]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_come_back_from_the_meridian() {
        for axis in [Axis(0), Axis(1), Axis(2)] {
            for u in [
                DVec3::new(0.3, -1.2, 0.7),
                DVec3::AXES[axis.0],
                DVec3::ZERO,
                -DVec3::AXES[(axis.0 + 1) % 3],
            ] {
                let stored = axis.stored(axis.invariants(u));
                let rotation = axis.to(u);
                assert!((rotation * stored - u).length() < 1e-15);
                assert!((rotation.determinant() - 1.0).abs() < 1e-15);
                let turned = axis.rotation(0.4) * u;
                assert!((axis.stored(axis.invariants(turned)) - stored).length() < 1e-15);
            }
        }
    }

    #[test]
    fn changes_of_invariants_are_their_derivatives() {
        let (axis, u, du) = (
            Axis(1),
            DVec3::new(0.3, -1.2, 0.7),
            DVec3::new(2.0, 0.1, -0.4),
        );
        let h = 1e-6;
        let [above, below] = [h, -h].map(|h| axis.invariants(u + du * h));
        let found = axis.change(u, du);
        for k in 0..2 {
            assert!((found[k] - (above[k] - below[k]) / (2.0 * h)).abs() < 1e-8);
        }
    }
}
