//! Parallel transport along any curve of the chart, geodesic or not.
//!
//! In: a curve `t -> (u, u̇)` and an interval of its parameter. Out: a [`Transport`], which carries
//! vectors and rotations from one end to the other.
//!
//! In the standard frame, transport is `q̇ = ½ (ω(t), 0) ⊗ q` with `ω` linear in the velocity. It is
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

/// Says how far a transport got.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the metric and the curve allow no transport beyond t = {at}: one of them is not finite there, or changes too fast"
)]
pub struct TransportFailed {
    /// The parameter up to which it went.
    pub at: f64,
}

/// The most steps tried, as of the integrator of rays: what turns faster is noise.
const MOST_STEPS: usize = 200_000;

/// The most along the path of a ray, which turns its frame a few times at most: paths that were followed take
/// some hundreds. A table that somebody forged ends here soon.
const MOST_STEPS_OF_A_RAY: usize = 4_000;

/// A step below this share of the interval cannot advance in double precision.
const SHORTEST_STEP: f64 = 1e-14;

/// Transports along `curve` from parameter `from` to `to` (which may be the smaller), each step exact
/// to an angle of `tolerance` (radians). Where the metric or the curve has a kink, steps
/// become short.
///
/// # Errors
/// The curve or the metric on it is not finite, the steps shrink to nothing, or there are too many.
pub fn transport(
    manifold: &Manifold,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    tolerance: f64,
) -> Result<Transport, TransportFailed> {
    let rate = |u, v| manifold.turning(u, v);
    follow(manifold, rate, curve, interval, (tolerance, MOST_STEPS))
}

/// Carries vectors along the path of a ray as its frame is carried. Where there is a wind, that is not parallel.
///
/// # Errors
/// As [`transport`].
pub fn carry(
    manifold: &Manifold,
    path: impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    tolerance: f64,
) -> Result<Transport, TransportFailed> {
    let rate = |u, v| manifold.carrying(u, v);
    let limits = (tolerance, MOST_STEPS_OF_A_RAY);
    follow(manifold, rate, path, interval, limits)
}

/// Turns a frame along `curve` at `rate` (point, velocity).
fn follow(
    manifold: &Manifold,
    rate: impl Fn(DVec3, DVec3) -> DVec3,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    [from, to]: [f64; 2],
    (tolerance, most): (f64, usize),
) -> Result<Transport, TransportFailed> {
    let rate = |t: f64| {
        let (u, v) = curve(t);
        rate(u, v)
    };
    let (mut t, mut q, mut steps, mut tried) = (from, DQuat::IDENTITY, 0, 0);
    let mut h = (to - from) / 16.0;
    while t != to {
        // What is left is split evenly, so that no sliver remains.
        let left = to - t;
        let last = (left / h) <= 1.0 + 1e-9;
        let step = if last { left } else { h };
        let whole = magnus(&rate, t, step);
        let parts = [t, t + 0.5 * step].map(|t| gauss(&rate, t, 0.5 * step));
        let [first, second] = parts.map(|rates| turned(rates, 0.5 * step));
        let halves = second * first;
        let error = angle_between(whole, halves) / tolerance;
        let after = if last { to } else { t + step };
        let kink = error <= 1.0 && {
            let ends = [rate(t), rate(after)];
            hidden_at_ends(parts, ends, step) > KINK * tolerance
        };
        let factor = match error.is_finite() && !kink {
            true => (0.9 * error.max(1e-10).powf(-1.0 / 7.0)).clamp(0.2, 4.0),
            false => 0.2,
        };
        if error <= 1.0 && !kink {
            t = after;
            q = (halves * q).normalize();
            steps += 1;
        }
        h = step * factor;
        tried += 1;
        if tried >= most || !(h.abs() > SHORTEST_STEP * (to - from).abs()) {
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

/// A step that hides more than so many tolerances before its first and behind its last Gauss point is taken again,
/// shorter: of a kink there, where rates jump, whole and half steps see the same nothing. Of smooth rates
/// extrapolation is off by no more than the step itself.
const KINK: f64 = 100.0;

/// Estimates the angle that no Gauss point of the two halves of a step sees: the difference of the rates at its
/// `ends` from the polynomial through all six points, over the gaps there.
fn hidden_at_ends(parts: [[DVec3; 3]; 2], ends: [DVec3; 2], step: f64) -> f64 {
    let [a, b, c] = gauss_points().map(|x| 0.5 * x);
    let nodes = [a, b, c, a + 0.5, b + 0.5, c + 0.5];
    let rates = parts.as_flattened();
    let off = |place: f64, there: DVec3| {
        let weight = |i: usize| -> f64 {
            let others = (0..6).filter(|j| *j != i);
            others
                .map(|j| (place - nodes[j]) / (nodes[i] - nodes[j]))
                .product()
        };
        let expected: DVec3 = (0..6).map(|i| rates[i] * weight(i)).sum();
        (there - expected).length()
    };
    a * step.abs() * off(0.0, ends[0]).max(off(1.0, ends[1]))
}

/// The rotation over `[t, t + h]`, with an error of order h⁷.
fn magnus(rate: &impl Fn(f64) -> DVec3, t: f64, h: f64) -> DQuat {
    turned(gauss(rate, t, h), h)
}

/// The Gauss points of [0, 1].
fn gauss_points() -> [f64; 3] {
    let offset = 0.15_f64.sqrt();
    [0.5 - offset, 0.5, 0.5 + offset]
}

/// The rates at the Gauss points of `[t, t + h]`.
fn gauss(rate: &impl Fn(f64) -> DVec3, t: f64, h: f64) -> [DVec3; 3] {
    gauss_points().map(|x| rate(t + x * h))
}

/// The rotation over a step from the rates at its Gauss points.
fn turned([a, b, c]: [DVec3; 3], h: f64) -> DQuat {
    let first = b * h;
    let second = (c - a) * (15.0_f64.sqrt() / 3.0 * h);
    let third = (c - b * 2.0 + a) * (10.0 / 3.0 * h);
    let c1 = first.cross(second);
    let c2 = -first.cross(third * 2.0 + c1) / 60.0;
    let turn = first + third / 12.0 + (c1 - first * 20.0 - third).cross(second + c2) / 240.0;
    DQuat::from_scaled_axis(turn)
}

/// The angle of the rotation from `a` to `b`, exact for small ones.
fn angle_between(a: DQuat, b: DQuat) -> f64 {
    2.0 * (a.inverse() * b).xyz().length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::SourceText;

    /// The rotation by `steps` equal steps from 0 to `length`.
    fn equal_steps(rate: impl Fn(f64) -> DVec3, length: f64, steps: u32) -> DQuat {
        let h = length / f64::from(steps);
        (0..steps).fold(DQuat::IDENTITY, |q, i| {
            magnus(&rate, f64::from(i) * h, h) * q
        })
    }

    #[test]
    fn the_error_falls_sixty_four_fold_when_steps_are_halved() {
        let rate = |t: f64| DVec3::new((2.0 * t).sin(), 1.0 - t * t, (0.3 + t).cos());
        let truth = equal_steps(rate, 2.0, 1024);
        let error = |steps| angle_between(equal_steps(rate, 2.0, steps), truth);
        let errors = [8, 16, 32].map(error);
        for pair in errors.windows(2) {
            assert!((50.0..80.0).contains(&(pair[0] / pair[1])), "{errors:?}");
        }
    }

    #[test]
    fn a_curve_that_turns_without_end_is_given_up() {
        let text = "name = \"bent\"\ncoordinates = [\"x\", \"y\", \"z\"]\n\
                    metric = { conformal = \"exp(x + y)\" }\n";
        let manifold = Manifold::from_source(SourceText::new("bent", text), &[]).unwrap();
        let curve = |t: f64| {
            let (sin, cos) = (1e9 * t).sin_cos();
            (DVec3::new(sin, cos, t), DVec3::new(cos, -sin, 0.0) * 1e9)
        };
        let given_up = carry(&manifold, curve, [0.0, 1.0], 1e-9).unwrap_err();
        assert!(given_up.at < 1e-3, "{given_up}");
    }

    #[test]
    fn a_kink_beside_the_end_of_a_step_is_not_overlooked() {
        let text = "name = \"wedge\"\ncoordinates = [\"x\", \"y\", \"z\"]\n\
                    metric = { conformal = \"exp(max(x, 0))\" }\n";
        let manifold = Manifold::from_source(SourceText::new("wedge", text), &[]).unwrap();
        // A straight chart line along (1, 1, 0): for x > 0 it turns by the angle 1 for each unit of y.
        for end in [0.1, 0.003, 1e-3] {
            let curve = |t: f64| (DVec3::new(t, t, 0.0), DVec3::new(1.0, 1.0, 0.0));
            let found = transport(&manifold, curve, [-0.15, end], 1e-11).unwrap();
            let angle = 2.0 * found.rotation.xyz().length().asin();
            assert!((angle - end).abs() < 1e-8, "{end}: {angle}");
        }
    }

    #[test]
    fn turns_about_one_axis_are_integrals() {
        let rate = |t: f64| DVec3::new(0.0, 0.6, 0.8) * (3.0 * t).cos();
        let turn = equal_steps(rate, 1.0, 64);
        let expected = DQuat::from_scaled_axis(DVec3::new(0.0, 0.6, 0.8) * 3.0_f64.sin() / 3.0);
        assert!(angle_between(turn, expected) < 1e-12);
    }
}
