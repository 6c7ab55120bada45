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

use super::{
    curve_edges::{CurveCrossing, EdgeFault, crossings},
    switching::ASIDE,
};
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
pub enum TransportFailed {
    /// Something is not finite there, or changes too fast.
    #[error(
        "the metric and the curve allow no transport beyond t = {at}: one of them is not finite there, or changes too fast"
    )]
    Stuck {
        /// The parameter up to which it went.
        at: f64,
    },
    /// It took too many steps.
    #[error(
        "the curve turns too often, or the frame along it, for one transport: after {steps} steps it had come to t = {at}; give it in pieces"
    )]
    TooLong {
        /// The parameter up to which it went.
        at: f64,
        /// The steps tried.
        steps: usize,
    },
    /// The metric jumps there, and nothing says how to go on.
    #[error("the metric has an edge at t = {at}, at ({}, {}, {}), over which nothing is carried: {fault}", point.x, point.y, point.z)]
    Edge {
        /// The parameter there.
        at: f64,
        /// The chart point.
        point: DVec3,
        /// The reason.
        fault: EdgeFault,
    },
}

impl TransportFailed {
    /// Returns the parameter up to which it went.
    pub fn at(&self) -> f64 {
        match self {
            Self::Stuck { at } | Self::TooLong { at, .. } | Self::Edge { at, .. } => *at,
        }
    }
}

/// The most steps tried, as of the integrator of rays: what turns faster is noise.
const MOST_STEPS: usize = 200_000;

/// The most along the path of a ray, which turns its frame a few times at most: paths that were followed take
/// some hundreds. A table that somebody forged ends here soon.
const MOST_STEPS_OF_A_RAY: usize = 4_000;

/// A step below this share of the interval cannot advance in double precision.
const SHORTEST_STEP: f64 = 1e-14;

/// The number of places, evenly along a curve, at which at least it is looked at: a Gaussian bump of the rate is seen if its
/// standard deviation is 1e-5 of the curve, as it is above what is tolerated up to seven of them from its summit. More would
/// cost more than the few milliseconds that most curves take.
const PLACES: usize = 8192;

/// The least number of them on a piece of a curve.
const LEAST_PLACES: usize = 16;

/// So many times farther from an axis of textbook coordinates than edges are told from rounding, nothing is looked at: errors
/// of rates, of some roundings over the cube of the distance, would be more than is tolerated.
const AXIS: f64 = 1e3;

/// How closely a curve is followed.
#[derive(Debug, Clone, Copy)]
struct Care {
    /// Error of a step, radians.
    tolerance: f64,
    /// The most steps tried.
    most_steps: usize,
    /// The distance between the places of a step at which rates are looked at (parameter): infinite for ends alone.
    apart: f64,
}

/// Transports along `curve` from parameter `from` to `to` (which may be the smaller), each step exact
/// to an angle of `tolerance` (radians). Steps end at surfaces where the metric is not smooth; over edges, where it jumps,
/// the turn is the limit of that over soft edges. Where the curve has a kink, steps become short.
///
/// # Errors
/// The curve or the metric on it is not finite, the steps shrink to nothing, or there are too many; an edge over which the
/// limit depends on the profile of soft ones, or which the curve touches.
pub fn transport(
    manifold: &Manifold,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    tolerance: f64,
) -> Result<Transport, TransportFailed> {
    transport_piece(manifold, curve, interval, tolerance, 1)
}

/// [`transport()`] along one of `pieces` pieces of a curve, which need not be looked at in as many places as the whole.
///
/// # Errors
/// As [`transport()`].
pub fn transport_piece(
    manifold: &Manifold,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    tolerance: f64,
    pieces: usize,
) -> Result<Transport, TransportFailed> {
    let [from, to] = interval;
    let width = to - from;
    let places = (PLACES / pieces.max(1)).max(LEAST_PLACES);
    let parameter = |s: f64| if s < 1.0 { from + width * s } else { to };
    let offset = from.abs().max(to.abs()) / width.abs();
    let ends = closed_by_rounding(&curve, interval, offset);
    let way = |s: f64| {
        let (u, v) = curve(parameter(s));
        let u = if s < 1.0 { u } else { ends[1] };
        (u, v * width)
    };
    let crossings = match width == 0.0 {
        true => Ok(Vec::new()),
        false => crossings(manifold, way, places, offset),
    };
    let crossings = crossings.map_err(|met| TransportFailed::Edge {
        at: parameter(met.s),
        point: way(met.s).0,
        fault: met.fault,
    })?;
    let apart = width.abs() / places as f64;
    let care = Care {
        tolerance,
        most_steps: MOST_STEPS,
        apart,
    };
    let rate = |t: f64| {
        let (u, v) = curve(t);
        manifold.turning(u, v)
    };
    // Near an axis of textbook coordinates rounding would look like something overlooked.
    let look = |t: f64| {
        let (u, v) = curve(t);
        let rounding = ASIDE * (u.length() + v.length() * width.abs());
        match manifold.is_beside_axis(u, AXIS * rounding) {
            true => DVec3::NAN,
            false => manifold.turning(u, v),
        }
    };
    // From surface to surface, and over them.
    let (mut start, mut q, mut steps) = (from, DQuat::IDENTITY, 0);
    for CurveCrossing { between, turn } in crossings {
        let [before, behind] = between.map(parameter);
        let (carried, taken) = follow(&rate, &look, [start, before], care)?;
        (start, q, steps) = (behind, (turn * carried * q).normalize(), steps + taken);
    }
    let (carried, taken) = follow(&rate, &look, [start, to], care)?;
    Ok(between(
        manifold,
        ends,
        (carried * q).normalize(),
        steps + taken,
    ))
}

/// Returns both ends of a curve, the second as the first where rounding alone parts them: one that begins on an edge ends
/// on the same side of it. `offset` is as in [`crossings`].
fn closed_by_rounding(
    curve: &impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    offset: f64,
) -> [DVec3; 2] {
    let [(from, v), (to, _)] = interval.map(curve);
    let way = v.length() * (interval[1] - interval[0]).abs();
    let rounding = ASIDE * (way * (1.0 + offset) + from.length());
    let closed = rounding.is_finite() && (to - from).length() <= rounding;
    [from, if closed { from } else { to }]
}

/// Carries vectors along the path of a ray as its frame is carried. Where there is a wind, that is not parallel.
///
/// # Errors
/// As [`transport()`], but for edges: the path must meet none.
pub fn carry(
    manifold: &Manifold,
    path: impl Fn(f64) -> (DVec3, DVec3),
    interval: [f64; 2],
    tolerance: f64,
) -> Result<Transport, TransportFailed> {
    let rate = |t: f64| {
        let (u, v) = path(t);
        manifold.carrying(u, v)
    };
    let care = Care {
        tolerance,
        most_steps: MOST_STEPS_OF_A_RAY,
        apart: f64::INFINITY,
    };
    let (rotation, steps) = follow(&rate, &rate, interval, care)?;
    Ok(between(
        manifold,
        interval.map(|t| path(t).0),
        rotation,
        steps,
    ))
}

/// Makes the transport that turns by `rotation` from one point to the other.
fn between(manifold: &Manifold, ends: [DVec3; 2], rotation: DQuat, steps: usize) -> Transport {
    let [start, end] = ends.map(|u| manifold.standard_frame(u));
    Transport {
        rotation,
        steps,
        frames: [start.inverse(), end],
    }
}

/// Turns a frame at `rate`; returns its rotation and the number of steps. `look` is the rate for places between those
/// that steps are made of; where it is not a number nothing is overlooked.
fn follow(
    rate: &impl Fn(f64) -> DVec3,
    look: &impl Fn(f64) -> DVec3,
    [from, to]: [f64; 2],
    care: Care,
) -> Result<(DQuat, usize), TransportFailed> {
    let (mut t, mut q, mut steps, mut tried) = (from, DQuat::IDENTITY, 0, 0);
    let mut h = (to - from) / 16.0;
    let rounding = 4.0 * f64::EPSILON * from.abs().max(to.abs());
    while t != to {
        // What is left is split evenly, so that no sliver remains, by rounding of the parameter neither.
        let left = to - t;
        let last = left.abs() <= h.abs() * (1.0 + 1e-9) + rounding;
        let step = if last { left } else { h };
        let whole = magnus(rate, t, step);
        let parts = [t, t + 0.5 * step].map(|t| gauss(rate, t, 0.5 * step));
        let [first, second] = parts.map(|rates| turned(rates, 0.5 * step));
        let halves = second * first;
        let error = angle_between(whole, halves) / care.tolerance;
        let after = if last { to } else { t + step };
        let overlooked = error <= 1.0 && overlooks(look, [t, after, step], parts, care);
        let factor = match error.is_finite() && !overlooked {
            true => (0.9 * error.max(1e-10).powf(-1.0 / 7.0)).clamp(0.2, 4.0),
            false => 0.2,
        };
        if error <= 1.0 && !overlooked {
            t = after;
            q = (halves * q).normalize();
            steps += 1;
        }
        h = step * factor;
        tried += 1;
        if !(h.abs() > SHORTEST_STEP * (to - from).abs()) {
            return Err(TransportFailed::Stuck { at: t });
        }
        if tried >= care.most_steps {
            let steps = care.most_steps;
            return Err(TransportFailed::TooLong { at: t, steps });
        }
    }
    Ok((q, steps))
}

/// A step that hides more than so many tolerances between its Gauss points is taken again, shorter: of a kink before
/// the first and behind the last, where rates jump, or of a narrow bump between two, whole and half steps see the same
/// nothing. Of smooth rates a polynomial is off by no more than the step itself.
const HIDDEN: f64 = 100.0;

/// Returns whether the Gauss points `parts` of the two halves of the `step` from `t` to `after` overlook something: at one of
/// the places looked at the rate is off the polynomial through all six by more than [`HIDDEN`] over the gap at an end.
fn overlooks(
    look: &impl Fn(f64) -> DVec3,
    [t, after, step]: [f64; 3],
    parts: [[DVec3; 3]; 2],
    care: Care,
) -> bool {
    let [a, b, c] = gauss_points().map(|x| 0.5 * x);
    let nodes = [a, b, c, a + 0.5, b + 0.5, c + 0.5];
    let rates = parts.as_flattened();
    let expected = |place: f64| -> DVec3 {
        let weight = |i: usize| -> f64 {
            let others = (0..6).filter(|j| *j != i);
            others
                .map(|j| (place - nodes[j]) / (nodes[i] - nodes[j]))
                .product()
        };
        (0..6).map(|i| rates[i] * weight(i)).sum()
    };
    let looks = (step.abs() / care.apart).ceil().max(1.0) as usize;
    let inside = (1..looks).map(|k| k as f64 / looks as f64);
    let inside = inside.map(|place| (place, t + step * place));
    let mut places = [(0.0, t), (1.0, after)].into_iter().chain(inside);
    places.any(|(place, t)| {
        let off = (look(t) - expected(place)).length();
        a * step.abs() * off > HIDDEN * care.tolerance
    })
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
        assert!(given_up.at() < 1e-3, "{given_up}");
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
    fn narrow_bumps_are_not_stepped_over() {
        let text = "name = \"bump\"\ncoordinates = [\"x\", \"y\", \"z\"]\nparameters = { w = 0.1 }\n\
                    metric = { conformal = \"exp(0.5*exp(-((x-0.3)^2+(y-0.9)^2+z^2)/(2*w^2)))\" }\n";
        for w in [0.1, 2e-3, 1e-4, 3e-5] {
            let settings = [("w".to_owned(), w)];
            let manifold = Manifold::from_source(SourceText::new("bump", text), &settings).unwrap();
            let line = |t: f64| (DVec3::new(0.3 + t, 0.9 + w, 0.0), DVec3::X);
            let found = transport(&manifold, line, [-1.0, 1.0], 1e-12).unwrap();
            // The integral of the slope across the line.
            let expected = 0.5 * (-0.5_f64).exp() * std::f64::consts::TAU.sqrt();
            let angle = 2.0 * found.rotation.xyz().length().asin();
            assert!((angle - expected).abs() < 1e-9, "{w}: {angle} {expected}");
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
