//! Geodesics of a manifold: integrators, transport, deviation, paths with dense output.
//!
//! In: a [`Manifold`] and [`Ray`]s. Out: [`Step`]s given to a [`Sink`], or whole [`Path`]s.
//! Arc length is measured in the metric; tangents have unit length. Besides: parallel transport along
//! any curve ([`transport`]), and the exponential map with its differential ([`exponential()`]).

mod control;
mod departure;
mod deviation;
mod dormand_prince;
mod events;
mod exponential;
mod face_crossing;
mod fixed;
mod integrator;
mod path;
mod refraction;
mod rows;
mod starts;
mod state;
mod step;
mod switching;
mod transport;
mod unfinished;

pub use departure::{TOLERANCES, beyond_exit, check_point, check_start, depart, unit};
pub use deviation::{JacobiField, conjugate_points, perpendiculars, signed_area};
pub use events::{crossing, first_event};
pub use exponential::{Exponential, exponential};
pub use fixed::fixed_steps;
pub use integrator::follow;
pub use path::{Path, Sample, elapsed, ends, paths, sample, samples};
pub use refraction::turn_at_edge;
pub use step::Step;
pub use transport::{Transport, TransportFailed, carry, transport};
pub use unfinished::{UnfinishedPaths, end_lengths};

use crate::manifold::{Carried, LocalFrame, Manifold};
use glam::DVec3;
use rows::{LANES, NIL, Row, each, weighted};

/// A geodesic to follow.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Chart point.
    pub u: DVec3,
    /// Tangent, chart components: of unit length in the metric at `u`, or against the wind there.
    pub v: DVec3,
    /// Arc length to follow it to.
    pub length: f64,
    /// The initial δv of the two deviations, chart components; used only when deviation is carried.
    pub spread: [DVec3; 2],
}

impl Ray {
    /// The ray seen from `u` in the direction `d` (standard frame, unit), with deviations along two
    /// perpendicular directions that make a right-handed triple with it.
    pub fn new(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> Self {
        Self::seen_by(&manifold.local_frame(u), u, d, length)
    }

    /// [`Ray::new`] where the observer at `u` is known.
    pub fn seen_by(local: &LocalFrame, u: DVec3, d: DVec3, length: f64) -> Self {
        let across = perpendiculars(d);
        Self {
            u,
            v: local.tangent(d),
            length,
            spread: across.map(|e| local.frame * e),
        }
    }

    /// Makes a ray from `u` with the tangent `v` whose neighbours do not matter: deviation must not be carried.
    pub fn without_spread(u: DVec3, v: DVec3, length: f64) -> Self {
        Self {
            u,
            v,
            length,
            spread: [DVec3::ZERO; 2],
        }
    }
}

/// The reason of a path's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// At the length asked for, or where its [`Sink`] had seen enough.
    Length,
    /// Through the exit with this index in [`Manifold::exits`].
    Exit(usize),
    /// Where the metric allows no further step.
    Singular,
}

impl End {
    /// The name that `trace` prints.
    pub fn name(self, manifold: &Manifold) -> &str {
        match self {
            Self::Length => "length",
            Self::Singular => "singular",
            Self::Exit(k) => &manifold.exits[k].name,
        }
    }
}

/// Settings of the integrator: error budget, quantities carried along, events.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Largest local error of a step: an angle in radians for directions and frames, a share of the
    /// arc length for positions.
    pub tolerance: f64,
    /// Quantities to carry along.
    pub carried: Carried,
    /// Set to end rays at exits and at the end of the domain.
    pub events: bool,
}

/// Takes the steps of many rays as they are made.
pub trait Sink {
    /// Returns whether the step of `ray` that ends at arc length `to` is to be made into a curve and given to
    /// [`Sink::step`]; the one in which the ray ends always is.
    fn wants(&self, ray: usize, to: f64) -> bool {
        let _ = (ray, to);
        true
    }
    /// The box of the chart in which steps are of interest: others are not wanted. Lanes see that for
    /// all of their steps at once, before any is made into a curve. `None` for everywhere.
    fn region(&self) -> Option<(DVec3, DVec3)> {
        None
    }
    /// Returns whether steps are to have what is carried along; that in which a ray ends always has.
    fn wants_carried(&self) -> bool {
        true
    }
    /// The next step of `ray` that was wanted; steps of one ray come in order, those of different rays mixed.
    fn step(&mut self, ray: usize, step: &Step);
    /// Returns whether to follow `ray` further; asked after each of its steps. A ray that is given up ends
    /// as [`End::Length`] at the end of that step.
    fn wants_more(&self, _ray: usize) -> bool {
        true
    }
    /// `ray` goes on behind face `face` of a glued domain: steps after this are there.
    fn crossed(&mut self, ray: usize, face: usize) {
        let _ = (ray, face);
    }
    /// `ray` has ended at arc length `s` after `steps` steps tried.
    fn end(&mut self, ray: usize, end: End, s: f64, steps: usize);
}
