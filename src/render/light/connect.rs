//! The geodesics that connect two points, exactly.
//!
//! In: guesses of direction and length. Out: [`Connection`]s, by Newton's method with the deviation
//! matrix: `(J₁, J₂, v) (δ₁, δ₂, δs) = x − u(s)`.

use super::fan::LightFan;
use crate::{
    geodesic::{Ray, Settings, Step, ends, perpendiculars, signed_area},
    manifold::{Carried, Manifold},
};
use glam::{DMat3, DVec3};

/// A geodesic from a point (a light) to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Connection {
    /// Its direction at the start, in the standard frame there; unit.
    pub direction: DVec3,
    /// Its arc length.
    pub s: f64,
    /// Where it ends: the point asked for, or its image whole periods away.
    pub u: DVec3,
    /// Its tangent at the end, chart components; unit.
    pub v: DVec3,
    /// The area by which a unit solid angle at the start has spread at the end; negative after an
    /// odd number of caustics.
    pub area: f64,
}

/// A connection being found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attempt {
    /// What it is for.
    pub index: usize,
    /// The point to start from, and the one to reach.
    pub from: DVec3,
    pub to: DVec3,
    /// Direction in the standard frame at the start, and arc length.
    pub direction: DVec3,
    pub s: f64,
}

/// An attempt with what its last steps have shown.
#[derive(Debug, Clone, Copy)]
struct State {
    attempt: Attempt,
    /// The best so far: direction, arc length and how far it missed.
    best: (DVec3, f64, f64),
    /// The step from the best that is being tried: two angles and an arc length.
    step: DVec3,
}

/// Most integrations of one attempt: honest ones need two to four.
const MOST_STEPS: usize = 14;

/// Largest turn (radians) of one step, and largest change of the arc length as a share of it: from
/// farther away the linear map says nothing.
const LARGEST_TURN: f64 = 0.3;
const LARGEST_STRETCH: f64 = 0.4;

/// An attempt has arrived when it misses by this many tolerances times the arc length.
const ARRIVED: f64 = 30.0;

/// Finishes attempts at a local tolerance; those that do not arrive are left out, as are repetitions
/// for the same index. By ascending index, and for each by arc length; with the number of geodesics
/// that were followed.
pub(crate) fn connect(
    manifold: &Manifold,
    attempts: Vec<Attempt>,
    tolerance: f64,
) -> (Vec<(usize, Connection)>, usize) {
    let mut followed = 0;
    let begin = |attempt: Attempt| State {
        attempt,
        best: (attempt.direction, attempt.s, f64::INFINITY),
        step: DVec3::ZERO,
    };
    let mut open: Vec<State> = attempts.into_iter().map(begin).collect();
    let mut found = Vec::new();
    for _ in 0..MOST_STEPS {
        if open.is_empty() {
            break;
        }
        let settings = Settings {
            tolerance,
            carried: Carried {
                frame: false,
                deviation: true,
            },
            events: false,
        };
        let rays = open.iter().map(|state| {
            let (d, s) = state.tried();
            Ray::new(manifold, state.attempt.from, d, s)
        });
        followed += open.len();
        let ends = ends(manifold, settings, rays);
        let mut next = Vec::new();
        for (state, end) in open.into_iter().zip(&ends) {
            match state.judged(manifold, end.as_ref(), tolerance) {
                Verdict::Arrived(connection) => found.push((state.attempt.index, connection)),
                Verdict::Open(state) => next.push(state),
                Verdict::Lost => {}
            }
        }
        open = next;
    }
    (distinct(found), followed)
}

enum Verdict {
    Arrived(Connection),
    Open(State),
    Lost,
}

impl State {
    /// The direction and arc length that the present step leads to.
    fn tried(&self) -> (DVec3, f64) {
        let (d, s, _) = self.best;
        stepped(d, s, self.step)
    }

    fn judged(mut self, manifold: &Manifold, end: Option<&(Step, f64)>, tolerance: f64) -> Verdict {
        let (direction, s) = self.tried();
        let reached = end
            .filter(|(_, reached)| *reached >= s)
            .map(|(step, _)| step);
        let Some((step, columns)) = reached.and_then(|step| Some((step, step.deviation(s)?)))
        else {
            return self.shortened();
        };
        let (u, v) = (step.position(s), step.tangent(s));
        let into = manifold.standard_frame(u).inverse();
        let miss = into * (self.attempt.to - u);
        let slope = DMat3::from_cols(into * columns[0], into * columns[1], into * v);
        if miss.length() <= ARRIVED * tolerance * s {
            // What is still missing is put right to first order, so that attempts that have come to
            // the same geodesic from different sides agree.
            let (nearer, s) = stepped(direction, s, limited(least_squares(slope, miss, s), s));
            return Verdict::Arrived(Connection {
                direction: nearer,
                s,
                u,
                v,
                area: signed_area(into, v, columns),
            });
        }
        if !(miss.length() < self.best.2) {
            return self.shortened();
        }
        self.best = (direction, s, miss.length());
        self.step = limited(least_squares(slope, miss, s), s);
        match self.step.is_finite() {
            true => Verdict::Open(self),
            false => Verdict::Lost,
        }
    }

    /// Tries half the step from the best so far.
    fn shortened(mut self) -> Verdict {
        self.step *= 0.5;
        match self.best.2.is_finite() {
            true => Verdict::Open(self),
            false => Verdict::Lost,
        }
    }
}

/// A direction turned by two angles, and an arc length changed, by `step`.
fn stepped(d: DVec3, s: f64, step: DVec3) -> (DVec3, f64) {
    let [e1, e2] = perpendiculars(d);
    ((d + e1 * step.x + e2 * step.y).normalize(), s + step.z)
}

/// The smallest solution of `slope x = miss`, damped by rounding's share of the arc length so that
/// it stays finite at caustics.
fn least_squares(slope: DMat3, miss: DVec3, s: f64) -> DVec3 {
    let normal = slope.transpose() * slope + DMat3::from_diagonal(DVec3::splat(1e-14 * s * s));
    normal.inverse() * (slope.transpose() * miss)
}

fn limited(step: DVec3, s: f64) -> DVec3 {
    let turn = step.truncate().length() / LARGEST_TURN;
    let stretch = step.z.abs() / (LARGEST_STRETCH * s);
    step / turn.max(stretch).max(1.0)
}

/// Two solutions for one point are the same if they differ by less than this, in direction and as a
/// share of the arc length. They agree to the tolerance except beside a caustic, where two that are
/// closer than this have merged for all purposes.
const SAME: f64 = 1e-5;

fn distinct(mut found: Vec<(usize, Connection)>) -> Vec<(usize, Connection)> {
    // The sort is stable and by the key alone, so the order does not depend on when each arrived.
    found.sort_by(|(i, a), (j, b)| i.cmp(j).then(a.s.total_cmp(&b.s)));
    let mut kept: Vec<(usize, Connection)> = Vec::with_capacity(found.len());
    for (index, new) in found {
        let same = |(other, old): &&(usize, Connection)| {
            *other == index
                && (old.direction - new.direction).length() < SAME
                && (old.s - new.s).abs() < SAME * new.s
        };
        let of_index = kept.iter().rev().take_while(|(other, _)| *other == index);
        if of_index.clone().find(same).is_none() {
            kept.push((index, new));
        }
    }
    kept
}

impl LightFan<'_> {
    /// All geodesics from the light to each of `points` (chart), up to the fan's length; by the
    /// number of the point, and for each by ascending arc length; with the number of geodesics that
    /// were followed to find them.
    pub fn connections(
        &self,
        points: &[DVec3],
        tolerance: f64,
    ) -> (Vec<(usize, Connection)>, usize) {
        let mut attempts = Vec::new();
        for (index, point) in points.iter().enumerate() {
            for (to, guess) in self.guesses(*point) {
                attempts.push(Attempt {
                    index,
                    from: self.u,
                    to,
                    direction: guess.direction,
                    s: guess.s,
                });
            }
        }
        let (mut found, followed) = connect(self.manifold, attempts, tolerance);
        found.retain(|(_, c)| c.s <= self.length);
        (found, followed)
    }
}
