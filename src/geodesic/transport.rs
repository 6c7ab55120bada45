//! Parallel transport along any curve of the chart, geodesic or not.
//!
//! In: a curve `t -> (u, u̇)` and an interval of its parameter. Out: a [`Transport`], which carries
//! vectors and rotations from one end to the other.
//!
//! In the standard frame transport is `q̇ = ½ (ω(t), 0) ⊗ q` with `ω` linear in the velocity. It is
//! solved by the Magnus expansion of order six on three Gauss points, so `q` is a product of unit
//! quaternions and never leaves the rotations: S. Blanes, F. Casas, J. A. Oteo, J. Ros, *The Magnus
//! expansion and some of its applications*, Phys. Rep. 470 (2009) 151, eq. 253 and 257. In so(3) the
//! commutator of two rates is their cross product.

use crate::manifold::Manifold;
use glam::{DMat3, DQuat, DVec3};

/// The isometry of tangent spaces that transport along a curve gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transport {
    /// Relative to the standard frames: a camera that starts with `R` arrives with `q R`.
    pub rotation: DQuat,
    /// The number of steps taken.
    pub steps: usize,
    /// `S⁻¹` at the start, `S` at the end.
    frames: [DMat3; 2],
}

impl Transport {
    /// The transported vector, chart components to chart components.
    pub fn vector(&self, w: DVec3) -> DVec3 {
        self.frames[1] * (self.rotation * (self.frames[0] * w))
    }

    /// The matrix of [`Transport::vector`].
    pub fn matrix(&self) -> DMat3 {
        self.frames[1] * DMat3::from_quat(self.rotation) * self.frames[0]
    }
}

/// Why a transport failed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the metric allows no transport along the curve beyond t = {at}")]
pub struct TransportFailed {
    /// The parameter up to which it went.
    pub at: f64,
}

/// A step below this share of the interval cannot advance in double precision.
const SHORTEST_STEP: f64 = 1e-14;

/// Transports along `curve` from parameter `from` to `to` (which may be the smaller), each step exact
/// to an angle of `tolerance` (radians). Steps end at no kink of the metric by themselves; there they
/// become short.
///
/// # Errors
/// The curve or the metric on it is not finite, or the steps shrink to nothing.
pub fn transport(
    manifold: &Manifold,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    [from, to]: [f64; 2],
    tolerance: f64,
) -> Result<Transport, TransportFailed> {
    let rate = |t: f64| {
        let (u, v) = curve(t);
        manifold.turning(u, v)
    };
    let (mut t, mut q, mut steps) = (from, DQuat::IDENTITY, 0);
    let mut h = (to - from) / 16.0;
    while t != to {
        // What is left is split evenly, so that no sliver remains.
        let left = to - t;
        let last = (left / h) <= 1.0 + 1e-9;
        let step = if last { left } else { h };
        let (turn, error) = magnus(&rate, t, step);
        let error = error / tolerance;
        let factor = match error.is_finite() {
            true => (0.9 * error.max(1e-10).powf(-1.0 / 5.0)).clamp(0.2, 4.0),
            false => 0.2,
        };
        if error <= 1.0 {
            t = if last { to } else { t + step };
            q = (DQuat::from_scaled_axis(turn) * q).normalize();
            steps += 1;
        }
        h = step * factor;
        if !(h.abs() > SHORTEST_STEP * (to - from).abs()) {
            return Err(TransportFailed { at: t });
        }
    }
    let standard = |t: f64| manifold.standard_frame(curve(t).0);
    Ok(Transport {
        rotation: q,
        steps,
        frames: [standard(from).inverse(), standard(to)],
    })
}

/// The rotation vector over `[t, t + h]` to order six, and its distance from that of order four.
fn magnus(rate: &impl Fn(f64) -> DVec3, t: f64, h: f64) -> (DVec3, f64) {
    let offset = 0.15_f64.sqrt();
    let [a, b, c] = [0.5 - offset, 0.5, 0.5 + offset].map(|x| rate(t + x * h));
    let first = b * h;
    let second = (c - a) * (15.0_f64.sqrt() / 3.0 * h);
    let third = (c - b * 2.0 + a) * (10.0 / 3.0 * h);
    let c1 = first.cross(second);
    let c2 = -first.cross(third * 2.0 + c1) / 60.0;
    let low = first + third / 12.0 - c1 / 12.0;
    let high = first + third / 12.0 + (c1 - first * 20.0 - third).cross(second + c2) / 240.0;
    (high, (high - low).length())
}

/// The rotation vector of `steps` equal steps, for measuring the order of the method.
#[cfg(test)]
fn equal_steps(rate: impl Fn(f64) -> DVec3, length: f64, steps: u32) -> DQuat {
    let h = length / f64::from(steps);
    (0..steps).fold(DQuat::IDENTITY, |q, i| {
        DQuat::from_scaled_axis(magnus(&rate, f64::from(i) * h, h).0) * q
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_falls_sixty_four_fold_when_steps_are_halved() {
        let rate = |t: f64| DVec3::new((2.0 * t).sin(), 1.0 - t * t, (0.3 + t).cos());
        let truth = equal_steps(rate, 2.0, 2048);
        let error = |steps| {
            2.0 * (equal_steps(rate, 2.0, steps).inverse() * truth)
                .xyz()
                .length()
        };
        let errors = [8, 16, 32].map(error);
        for pair in errors.windows(2) {
            assert!((50.0..80.0).contains(&(pair[0] / pair[1])), "{errors:?}");
        }
    }

    #[test]
    fn the_estimate_bounds_the_error_of_a_step() {
        let rate = |t: f64| DVec3::new((2.0 * t).sin(), 1.0 - t * t, (0.3 + t).cos());
        for h in [0.3, 0.1, 0.03] {
            let (turn, estimate) = magnus(&rate, 0.2, h);
            let truth = equal_steps(|t| rate(0.2 + t), h, 64);
            let off = 2.0
                * (DQuat::from_scaled_axis(turn).inverse() * truth)
                    .xyz()
                    .length();
            assert!(off <= estimate, "{h}: {off} {estimate}");
        }
    }
}
