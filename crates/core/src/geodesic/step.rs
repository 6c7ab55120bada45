//! Integration steps as curves: the trial steps of all lanes as polynomials, and one of them handed on.
//!
//! In: the states and rates at both ends of the steps. Out: the coefficients of the quintics of the
//! path and of the deviations and of the quaternion's dense output, a row for each, from which the
//! [`Step`] of one lane is only gathered.

use super::{
    LANES, NIL, Row,
    dormand_prince::{DENSE, Dense, Quintic, STAGES},
    each,
    face_crossing::carried_frame,
    state::StateLayout,
};
use geofan_expr::real::Real;
use glam::{DMat3, DQuat, DVec3};
use std::num::NonZeroU32;

/// A piece of a path between two points of the integration, continuous inside.
#[derive(Debug, Clone)]
pub struct Step {
    /// Arc length at the start.
    pub start: f64,
    /// Arc length at which the piece ends: the step's end, or the event that cut it.
    pub end: f64,
    /// The edge behind which the piece begins: a number for the surface met there, for the side that the path
    /// comes from and for whether it is refracted or reflected. Neighbours that go the same way have the same.
    pub edge: Option<NonZeroU32>,
    /// The whole step's length; the curves run over it.
    pub(super) h: f64,
    pub(super) curve: Quintic,
    pub(super) turn: Option<Dense<4>>,
    pub(super) deviation: Option<[Quintic; 2]>,
    /// Faces of a glued domain that the path has crossed before.
    pub crossings: u32,
    /// Set if they have turned right into left.
    pub reversed: bool,
}

impl Step {
    /// Returns the arc length at a fraction of the piece.
    pub(super) fn place(&self, fraction: f64) -> f64 {
        self.start + (self.end - self.start) * fraction
    }

    fn fraction(&self, s: f64) -> f64 {
        (s - self.start) / self.h
    }

    /// The chart point at arc length `s`.
    pub fn position(&self, s: f64) -> DVec3 {
        self.curve.position(self.fraction(s))
    }

    /// Corners of a box of the chart around the whole step; not the tightest.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.curve.bounds()
    }

    /// The tangent at arc length `s`, chart components, unit length to the integrator's tolerance.
    pub fn tangent(&self, s: f64) -> DVec3 {
        self.curve.velocity(self.fraction(s))
    }

    /// The transported rotation at `s`, relative to the standard frames: a camera that starts with
    /// `R` has axes `S(u) q R` here. `None` when the frame is not carried.
    ///
    /// In a glued space that turns right into left it stands for [`Step::frame`].
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let dense = self.turn.as_ref()?;
        Some(DQuat::from_array(dense.at(self.fraction(s))).normalize())
    }

    /// The transported frame at `s`, relative to the standard frames: a rotation, or after an odd number of
    /// reversals one with its first axis mirrored. `None` when the frame is not carried.
    pub fn frame(&self, s: f64) -> Option<DMat3> {
        let turn = self.rotation(s)?;
        Some(carried_frame(turn, self.reversed))
    }

    /// `∂u/∂(initial direction)` along the two initial deviations, chart components. `None` when
    /// deviation is not carried.
    pub fn deviation(&self, s: f64) -> Option<[DVec3; 2]> {
        let t = self.fraction(s);
        self.deviation
            .as_ref()
            .map(|columns| columns.each_ref().map(|c| c.position(t)))
    }

    /// The derivative of [`Step::deviation`] in the arc length, chart components.
    pub fn deviation_rate(&self, s: f64) -> Option<[DVec3; 2]> {
        let t = self.fraction(s);
        self.deviation
            .as_ref()
            .map(|columns| columns.each_ref().map(|c| c.velocity(t)))
    }
}

/// Error that rounding of the positions at both ends leaves in the quintic's last coefficient, relative to
/// them: six times half a unit in the last place of each.
const ROUNDING: f64 = 6.0 * f64::EPSILON;

/// Rows of a quintic: six coefficients of three components.
const QUINTIC: usize = 18;

/// Rows of the quaternion: four components of five terms.
const TURN: usize = 20;

/// The ends of the trial steps of all lanes.
#[derive(Clone, Copy)]
pub(super) struct Trial<'a> {
    pub layout: StateLayout,
    /// Length of the steps.
    pub h: &'a Row,
    /// States at the start and at the end.
    pub y: &'a [Row],
    pub end: &'a [Row],
    /// The stages' rates: the first are those at the start, the last those at the end.
    pub k: &'a [Vec<Row>; STAGES],
}

/// The curves of all lanes.
pub(super) struct Curves {
    path: Vec<Row>,
    turn: Vec<Row>,
    deviation: Vec<Row>,
}

impl Curves {
    pub fn new(layout: StateLayout) -> Self {
        Self {
            path: vec![NIL; QUINTIC],
            turn: vec![NIL; layout.turn.map_or(0, |_| TURN)],
            deviation: vec![NIL; layout.deviation.map_or(0, |_| 2 * QUINTIC)],
        }
    }

    /// Makes the quintics of the paths.
    #[inline(always)]
    pub fn make_path(&mut self, trial: Trial<'_>) {
        quintic(trial, 0, &mut self.path);
    }

    /// Makes the curves of everything that is carried along.
    #[inline(always)]
    pub fn make_carried(&mut self, trial: Trial<'_>) {
        if let Some(at) = trial.layout.turn {
            dense(trial, at, &mut self.turn);
        }
        if let Some(at) = trial.layout.deviation {
            let (first, second) = self.deviation.split_at_mut(QUINTIC);
            quintic(trial, at, first);
            quintic(trial, at + 6, second);
        }
    }

    /// Component `c` of the points at the fraction `t` of the steps.
    #[inline(always)]
    pub fn point(&self, c: usize, t: f64) -> Row {
        let [p0, p1, p2, p3, p4, p5] = self.component(c);
        each(|l| p0[l] + (p1[l] + (p2[l] + (p3[l] + (p4[l] + p5[l] * t) * t) * t) * t) * t)
    }

    /// Component `c` of the tangents there; `inverse` is one over the steps' lengths.
    #[inline(always)]
    pub fn tangent(&self, c: usize, inverse: &Row, t: f64) -> Row {
        let [_, p1, p2, p3, p4, p5] = self.component(c);
        each(|l| {
            let inner = p3[l] * 3.0 + (p4[l] * 4.0 + p5[l] * (5.0 * t)) * t;
            (p1[l] + (p2[l] * 2.0 + inner * t) * t) * inverse[l]
        })
    }

    /// Component `c` of the accelerations there.
    #[inline(always)]
    pub fn acceleration(&self, c: usize, inverse: &Row, t: f64) -> Row {
        let [_, _, p2, p3, p4, p5] = self.component(c);
        each(|l| {
            let bend = p3[l] * 6.0 + (p4[l] * 12.0 + p5[l] * (20.0 * t)) * t;
            (p2[l] * 2.0 + bend * t) * (inverse[l] * inverse[l])
        })
    }

    #[inline(always)]
    fn component(&self, c: usize) -> [&Row; 6] {
        let p = &self.path;
        [
            &p[c],
            &p[3 + c],
            &p[6 + c],
            &p[9 + c],
            &p[12 + c],
            &p[15 + c],
        ]
    }

    /// 1 for the steps that may meet the box with these corners, else 0: see [`Quintic::bounds`].
    #[inline(always)]
    pub fn near(&self, (least, most): (DVec3, DVec3)) -> Row {
        let mut near = each(|_| 1.0);
        for c in 0..3 {
            let p = self.component(c);
            let (least, most) = (least[c], most[c]);
            near = each(|l| {
                let (mut low, mut high) = (p[0][l], p[0][l]);
                for term in &p[1..] {
                    low += Real::min(term[l], 0.0);
                    high += Real::max(term[l], 0.0);
                }
                f64::select((low > most) | (high < least), 0.0, near[l])
            });
        }
        near
    }

    /// The path of the step of one lane, from arc length `start` over `h`; without what is carried.
    pub fn path(&self, lane: usize, start: f64, h: f64) -> Step {
        Step {
            start,
            end: start + h,
            edge: None,
            h,
            curve: gathered(&self.path, lane, h),
            turn: None,
            deviation: None,
            crossings: 0,
            reversed: false,
        }
    }

    /// Returns the step with the curves of [`Curves::make_carried`] as well.
    pub fn step(&self, lane: usize, start: f64, h: f64) -> Step {
        Step {
            turn: (!self.turn.is_empty()).then(|| {
                let mut terms = [[0.0; 5]; 4];
                for (term, row) in terms.as_flattened_mut().iter_mut().zip(&self.turn) {
                    *term = row[lane];
                }
                Dense(terms)
            }),
            deviation: (!self.deviation.is_empty()).then(|| {
                let (first, second) = self.deviation.split_at(QUINTIC);
                [gathered(first, lane, h), gathered(second, lane, h)]
            }),
            ..self.path(lane, start, h)
        }
    }

    /// Returns the step of one lane where the curves of all lanes have not been made.
    pub fn lone_step(&self, trial: Trial<'_>, lane: usize, start: f64) -> Step {
        let h = trial.h[lane];
        Step {
            turn: (trial.layout.turn)
                .map(|at| Dense(std::array::from_fn(|c| lone_turn(trial, at + c, lane)))),
            deviation: (trial.layout.deviation)
                .map(|at| [lone(trial, at, lane), lone(trial, at + 6, lane)]),
            ..self.path(lane, start, h)
        }
    }
}

fn gathered(rows: &[Row], lane: usize, h: f64) -> Quintic {
    let mut coefficients = [DVec3::ZERO; 6];
    for (p, rows) in coefficients.iter_mut().zip(rows.as_chunks::<3>().0) {
        *p = DVec3::new(rows[0][lane], rows[1][lane], rows[2][lane]);
    }
    Quintic { coefficients, h }
}

/// The terms of the dense output of row `c` of one lane.
fn lone_turn(trial: Trial<'_>, c: usize, lane: usize) -> [f64; 5] {
    let Trial { h, y, end, k, .. } = trial;
    let k = k.each_ref().map(|k| k[c][lane]);
    turn_terms(h[lane], y[c][lane], end[c][lane], k)
}

/// The quintic of one lane for the vector that begins at row `at`.
fn lone(trial: Trial<'_>, at: usize, lane: usize) -> Quintic {
    let Trial { h, y, end, k, .. } = trial;
    let last = &k[STAGES - 1];
    let [x, y, z] = [at, at + 1, at + 2].map(|c| {
        let start = [y[c][lane], y[c + 3][lane], k[0][c + 3][lane]];
        let end = [end[c][lane], end[c + 3][lane], last[c + 3][lane]];
        quintic_terms(h[lane], start, end)
    });
    Quintic {
        coefficients: std::array::from_fn(|i| DVec3::new(x[i], y[i], z[i])),
        h: h[lane],
    }
}

/// The quintics of all lanes for the vector that begins at row `at`.
#[inline(always)]
fn quintic(trial: Trial<'_>, at: usize, rows: &mut [Row]) {
    let Trial { h, y, end, k, .. } = trial;
    for c in at..at + 3 {
        let (u0, v0, a0) = (&y[c], &y[c + 3], &k[0][c + 3]);
        let (u1, v1, a1) = (&end[c], &end[c + 3], &k[STAGES - 1][c + 3]);
        let mut p = [NIL; 6];
        for l in 0..LANES {
            let (start, end) = ([u0[l], v0[l], a0[l]], [u1[l], v1[l], a1[l]]);
            let terms = quintic_terms(h[l], start, end);
            for i in 0..6 {
                p[i][l] = terms[i];
            }
        }
        for (i, p) in p.iter().enumerate() {
            rows[3 * i + c - at] = *p;
        }
    }
}

/// The coefficients of the quintic that matches position, velocity and acceleration at both ends of a
/// step of length `h`.
#[inline(always)]
fn quintic_terms(h: f64, [u0, v0, a0]: [f64; 3], [u1, v1, a1]: [f64; 3]) -> [f64; 6] {
    let half = 0.5 * h * h;
    let (p1, p2) = (v0 * h, a0 * half);
    // What the end conditions still ask of the cubic to quintic terms.
    let rise = u1 - u0 - p1 - p2;
    let slope = v1 * h - p1 - p2 * 2.0;
    let bend = a1 * half - p2;
    let last = rise * 6.0 - slope * 3.0 + bend;
    // In a very short step the difference of the positions is rounding, and divided by `h` it would
    // spoil the velocity: there the velocities alone decide, and the last coefficient is zero.
    let noise = ROUNDING * Real::max(u0.abs(), u1.abs());
    let noisy = last.abs() <= noise;
    let rise = f64::select(noisy, slope * 0.5 - bend * (1.0 / 6.0), rise);
    [
        u0,
        p1,
        p2,
        rise * 10.0 - slope * 4.0 + bend,
        rise * -15.0 + slope * 7.0 - bend * 2.0,
        f64::select(noisy, 0.0, last),
    ]
}

/// The dense output of the quaternions of all lanes, which begin at row `at`.
#[inline(always)]
fn dense(trial: Trial<'_>, at: usize, rows: &mut [Row]) {
    let Trial { h, y, end, k, .. } = trial;
    for c in 0..4 {
        let (y, end) = (&y[at + c], &end[at + c]);
        let k = k.each_ref().map(|k| &k[at + c]);
        let mut p = [NIL; 5];
        for l in 0..LANES {
            let terms = turn_terms(h[l], y[l], end[l], k.map(|k| k[l]));
            for i in 0..5 {
                p[i][l] = terms[i];
            }
        }
        rows[5 * c..5 * c + 5].copy_from_slice(&p);
    }
}

/// The terms of the dense output of one component from `y` to `end`, with the rates `k` of the stages.
#[inline(always)]
fn turn_terms(h: f64, y: f64, end: f64, k: [f64; STAGES]) -> [f64; 5] {
    let rise = end - y;
    let bend = h * k[0] - rise;
    let mut fourth = 0.0;
    for (weight, k) in DENSE.iter().zip(k).filter(|(w, _)| **w != 0.0) {
        fourth += weight * k;
    }
    [y, rise, bend, rise - h * k[STAGES - 1] - bend, h * fourth]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::Settings;

    #[test]
    fn quintic_reproduces_a_quintic() {
        let p = |t: f64| DVec3::new(t.powi(5), 1.0 - t.powi(4), 2.0 * t.powi(3) + t);
        let v = |t: f64| DVec3::new(5.0 * t.powi(4), -4.0 * t.powi(3), 6.0 * t * t + 1.0);
        let a = |t: f64| DVec3::new(20.0 * t.powi(3), -12.0 * t * t, 12.0 * t);
        let (s0, h) = (0.3, 1.7);
        let rows = |vectors: [DVec3; 2]| -> Vec<Row> {
            let numbers = vectors.iter().flat_map(|x| x.to_array());
            numbers.map(|x| each(|_| x)).collect()
        };
        let s1 = s0 + h;
        let mut k: [Vec<Row>; STAGES] = std::array::from_fn(|_| vec![NIL; 6]);
        k[0] = rows([v(s0), a(s0)]);
        k[STAGES - 1] = rows([v(s1), a(s1)]);
        let layout = StateLayout::of(Settings::bare(1.0));
        let mut curves = Curves::new(layout);
        let width = each(|_| h);
        curves.make_path(Trial {
            layout,
            h: &width,
            y: &rows([p(s0), v(s0)]),
            end: &rows([p(s1), v(s1)]),
            k: &k,
        });
        let step = curves.step(5, s0, h);
        for t in [0.0, 0.2, 0.5, 0.9, 1.0] {
            let s = s0 + t * h;
            assert!((step.position(s) - p(s)).length() < 1e-12);
            assert!((step.tangent(s) - v(s)).length() < 1e-12);
            for c in 0..3 {
                let inverse = each(|_| 1.0 / h);
                assert!((curves.point(c, t)[9] - p(s)[c]).abs() < 1e-12);
                assert!((curves.tangent(c, &inverse, t)[9] - v(s)[c]).abs() < 1e-12);
                assert!((curves.acceleration(c, &inverse, t)[9] - a(s)[c]).abs() < 1e-11);
            }
        }
    }
}
