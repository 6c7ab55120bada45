//! The geodesics that connect two points.
//!
//! In: guesses of direction and length. Out: [`Connection`]s, by Newton's method with the deviation
//! matrix: `(J₁, J₂, v) (δ₁, δ₂, δs) = x − u(s)`. A guess that brings its own matrix is first followed
//! without deviation, which costs a fraction; when its next step is small, an attempt is followed with
//! deviation, and what stands in its way is found on the same path.

use super::{
    cell::Guess,
    fan::{LightFan, Room},
    way::{Arrival, Reached, Way, reached},
};
use crate::{
    geodesic::{Ray, Settings, perpendiculars, signed_area},
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
    /// The share of light that surfaces on the way let through.
    pub through: f64,
}

/// A connection being found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attempt {
    /// What it is for.
    pub index: usize,
    /// The point to start from with the standard frame there, and the one to reach.
    pub from: DVec3,
    pub frame: DMat3,
    pub to: DVec3,
    /// Direction in the standard frame at the start, and arc length.
    pub direction: DVec3,
    pub s: f64,
    /// Roughly the two deviations at the end, chart components, if something is known about them.
    pub spread: Option<[DVec3; 2]>,
}

/// An attempt with what its last steps have shown.
#[derive(Debug, Clone, Copy)]
struct State {
    attempt: Attempt,
    /// The best so far: direction, arc length and how far it missed.
    best: (DVec3, f64, f64),
    /// The step from the best that is being tried: two angles and an arc length.
    step: DVec3,
    /// Whether the step is so small that it may be the last.
    near: bool,
    /// Whether it is to be followed without deviation, and the next step found by the guess.
    bare: bool,
    /// Whether the step was found so.
    guided: bool,
}

/// Most integrations of one attempt: honest ones need two, beside caustics three or four. The others
/// look for light beyond a fold, where there is none.
const MOST_STEPS: usize = 8;

/// Largest turn (radians) of one step, and largest change of the arc length as a share of it: from
/// farther away the linear map says nothing.
const LARGEST_TURN: f64 = 0.3;
const LARGEST_STRETCH: f64 = 0.4;

/// An attempt has arrived when it misses by this share of the arc length times the square root of the
/// tolerance. The miss is then put right to first order, so that direction and length are as good as
/// the integration (see [`COARSE`]); the area stays that of the path beside, off by some ten times the
/// miss: a part in a million at a tolerance of 1e-10. A tenth of this would cost another integration
/// for most.
const ARRIVED: f64 = 1e-2;

/// Integrations have a tolerance of this many times the miss that is allowed: what they leave of the
/// area is no more than what the miss does, and it is well below the distance at which two solutions
/// are told apart.
const COARSE: f64 = 1.0;

/// A step that turns by less than this (radians), and changes the arc length by less than this share,
/// is expected to be the last: what it leaves out is of the order of its square, and what is in its
/// way is in the way of the connection.
const NEAR: f64 = 2e-3;

/// Finishes attempts at a local tolerance; those that do not arrive are left out, as are those with
/// something in their way, and repetitions for the same index. By ascending index, and for each by
/// arc length; with the number of geodesics that were followed.
pub(crate) fn connect(
    manifold: &Manifold,
    attempts: Vec<Attempt>,
    tolerance: f64,
    way: Way<'_>,
) -> (Vec<(usize, Connection)>, usize) {
    let local = tolerance.max(COARSE * allowed(tolerance).min(0.1 * SAME));
    let mut open: Vec<State> = attempts.into_iter().map(State::new).collect();
    let (mut found, mut followed) = (Vec::new(), 0);
    for _ in 0..MOST_STEPS {
        if open.is_empty() {
            break;
        }
        followed += open.len();
        let (near, far): (Vec<State>, Vec<State>) = open.into_iter().partition(|s| s.near);
        open = approached(manifold, far, local);
        let (arrived, others) = arrived(manifold, near, [local, allowed(tolerance)], way);
        found.extend(arrived);
        open.extend(others);
    }
    (distinct(found), followed)
}

/// By how much an arrived attempt may miss, as a share of the arc length.
fn allowed(tolerance: f64) -> f64 {
    ARRIVED * tolerance.sqrt()
}

fn settings(tolerance: f64, deviation: bool, events: bool) -> Settings {
    Settings {
        tolerance,
        carried: Carried {
            frame: false,
            deviation,
        },
        events,
    }
}

/// How far what the attempts try now comes on its `way`.
fn followed(
    manifold: &Manifold,
    settings: Settings,
    states: &[State],
    way: Way<'_>,
) -> Vec<Reached> {
    let numbers = states.iter().map(|state| state.attempt.index).collect();
    let rays = states.iter().map(State::ray).collect();
    reached(manifold, settings, rays, numbers, way)
}

/// Follows attempts whatever is in their way: those that have a next step, with it.
fn approached(manifold: &Manifold, states: Vec<State>, tolerance: f64) -> Vec<State> {
    let (bare, others): (Vec<State>, Vec<State>) = states.into_iter().partition(|s| s.bare);
    let mut open = Vec::with_capacity(bare.len() + others.len());
    for (states, deviation) in [(bare, false), (others, true)] {
        let settings = settings(tolerance, deviation, false);
        let flights = followed(manifold, settings, &states, Way::Any);
        let next = |(state, flight): (State, Reached)| {
            let target = state.target(&flight);
            state.stepped(target)
        };
        open.extend(states.into_iter().zip(flights).filter_map(next));
    }
    open
}

/// Follows attempts as far as the way is free: those that have arrived, missing by at most the share
/// `allowed`, and those others that have a next step, with it.
fn arrived(
    manifold: &Manifold,
    states: Vec<State>,
    [tolerance, allowed]: [f64; 2],
    way: Way<'_>,
) -> (Vec<(usize, Connection)>, Vec<State>) {
    let flights = followed(manifold, settings(tolerance, true, true), &states, way);
    let (mut found, mut others) = (Vec::new(), Vec::new());
    for (state, flight) in states.into_iter().zip(flights) {
        if matches!(flight, Reached::Blocked) {
            continue;
        }
        match state.target(&flight) {
            Some(target) if target.miss.length() <= allowed * target.s => {
                found.push((state.attempt.index, target.connection()));
            }
            target => others.extend(state.stepped(target)),
        }
    }
    (found, others)
}

/// Where a tried geodesic has come to.
struct Target {
    direction: DVec3,
    s: f64,
    u: DVec3,
    v: DVec3,
    /// From there to the point, in the standard frame.
    miss: DVec3,
    /// The derivatives of the end by two angles and the arc length, in the standard frame.
    slope: DMat3,
    area: f64,
    through: f64,
}

impl Target {
    /// The Newton step towards the point.
    fn step(&self) -> DVec3 {
        limited(least_squares(self.slope, self.miss, self.s), self.s)
    }

    /// What is still missing is put right to first order, so that attempts that have come to the same
    /// geodesic from different sides agree.
    fn connection(&self) -> Connection {
        let (direction, s) = stepped(self.direction, self.s, self.step());
        Connection {
            direction,
            s,
            u: self.u,
            v: self.v,
            area: self.area,
            through: self.through,
        }
    }
}

impl State {
    fn new(attempt: Attempt) -> Self {
        Self {
            attempt,
            best: (attempt.direction, attempt.s, f64::INFINITY),
            step: DVec3::ZERO,
            near: false,
            bare: attempt.spread.is_some(),
            guided: false,
        }
    }

    /// The direction and arc length that the present step leads to.
    fn tried(&self) -> (DVec3, f64) {
        let (d, s, _) = self.best;
        stepped(d, s, self.step)
    }

    fn ray(&self) -> Ray {
        let (d, s) = self.tried();
        Ray::in_frame(self.attempt.frame, self.attempt.from, d, s)
    }

    /// Where the present step has led to, if its path has reached its end.
    fn target(&self, flight: &Reached) -> Option<Target> {
        let &Reached::End(Arrival {
            u,
            v,
            spread,
            frame,
            through,
        }) = flight
        else {
            return None;
        };
        let (direction, s) = self.tried();
        let into = frame.inverse();
        let columns = spread.or(self.attempt.spread)?;
        Some(Target {
            direction,
            s,
            u,
            v,
            miss: into * (self.attempt.to - u),
            slope: DMat3::from_cols(into * columns[0], into * columns[1], into * v),
            area: signed_area(into, v, columns),
            through,
        })
    }

    /// With the next step, from where the present one has led to if that is better than the best, else
    /// half the present one; `None` if there is none.
    fn stepped(mut self, target: Option<Target>) -> Option<Self> {
        match target.filter(|target| target.miss.length() < self.best.2) {
            Some(target) => {
                self.best = (target.direction, target.s, target.miss.length());
                self.step = target.step();
                self.guided = self.bare;
            }
            // The guess has led astray: once more from the best, with deviation.
            None if self.guided => {
                let (direction, s, _) = self.best;
                return Some(Self::new(Attempt {
                    direction,
                    s,
                    spread: None,
                    ..self.attempt
                }));
            }
            None => self.step *= 0.5,
        }
        self.bare = false;
        let (turn, stretch) = (self.step.truncate().length(), self.step.z / self.best.1);
        self.near = turn.max(stretch.abs()) <= NEAR;
        (self.best.2.is_finite() && self.step.is_finite()).then_some(self)
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
        self.connected(points.iter().copied(), tolerance, Way::Any)
    }

    /// The same, but only those on a `way` of their own.
    pub(super) fn connected(
        &self,
        points: impl Iterator<Item = DVec3>,
        tolerance: f64,
        way: Way<'_>,
    ) -> (Vec<(usize, Connection)>, usize) {
        let mut room = Room::default();
        let attempts = points.enumerate().flat_map(|(index, point)| {
            let attempt = move |(to, guess): (DVec3, Guess)| Attempt {
                index,
                from: self.u,
                frame: self.frame,
                to,
                direction: guess.direction,
                s: guess.s,
                spread: Some(guess.spread),
            };
            self.guesses(point, &mut room).into_iter().map(attempt)
        });
        let (mut found, followed) = connect(self.manifold, attempts.collect(), tolerance, way);
        found.retain(|(_, c)| c.s <= self.length);
        (found, followed)
    }
}
