//! One integration step as a curve: what the integrator hands on.

use super::dormand_prince::{Dense, Quintic};
use glam::{DQuat, DVec3};

/// A piece of a path between two points of the integration, continuous inside.
#[derive(Debug, Clone)]
pub struct Step {
    /// Arc length at the start.
    pub start: f64,
    /// Arc length at which the piece ends: the step's end, or the event that cut it.
    pub end: f64,
    /// The whole step's length; the curves run over it.
    pub(super) h: f64,
    pub(super) curve: Quintic,
    pub(super) turn: Option<Dense<4>>,
    pub(super) deviation: Option<[Quintic; 2]>,
}

impl Step {
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
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let dense = self.turn.as_ref()?;
        Some(DQuat::from_array(dense.at(self.fraction(s))).normalize())
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
