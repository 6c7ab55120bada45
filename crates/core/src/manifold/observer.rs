//! What an observer at a point sees: directions against the wind, frequencies.
//!
//! In: a chart point. Out: the normal observer's [`Observer`], which turns directions in the standard
//! frame into tangents and back, and frequencies of light there.
//!
//! Light keeps `|v − W| = 1`: where there is a wind, the tangent `v` of its path is not the direction
//! `n = v − W` in which the normal observer sees it. Lines of sight run into the past, and along them
//! `n` points to where the light comes from and `W` is the wind reversed.

use super::{Follows, Manifold};
use glam::{DMat3, DVec3};

/// The standard frame at a point, and the wind there if there is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observer {
    /// `S(u)`: columns are the standard frame.
    pub frame: DMat3,
    /// `W(u)` as the paths followed meet it, chart components.
    pub wind: Option<DVec3>,
}

impl Observer {
    /// The tangent of a path that is seen in the direction `d` (standard frame, unit).
    #[inline(always)]
    pub fn tangent(&self, d: DVec3) -> DVec3 {
        let n = self.frame * d;
        match self.wind {
            Some(wind) => n + wind,
            None => n,
        }
    }

    /// The direction, chart components, in which a path with tangent `v` is seen.
    #[inline(always)]
    pub fn sight(&self, v: DVec3) -> DVec3 {
        match self.wind {
            Some(wind) => v - wind,
            None => v,
        }
    }

    /// The direction in the standard frame, of unit length for the tangent of a path: the inverse of
    /// [`Observer::tangent`].
    pub fn direction(&self, v: DVec3) -> DVec3 {
        self.frame.inverse() * self.sight(v)
    }

    /// The tangent `v` with what is left of it against the wind at unit length in the metric `g` here:
    /// between the ends of a step, a curve keeps it only to the tolerance.
    pub fn restored(&self, g: DMat3, v: DVec3) -> DVec3 {
        let n = self.sight(v);
        let length = n.dot(g * n).sqrt();
        match self.wind {
            _ if !(length > 0.0) => v,
            Some(wind) => n / length + wind,
            None => n / length,
        }
    }
}

/// Wind, lapse and drift at a point, as the paths followed meet them.
struct Medium {
    wind: DVec3,
    lapse: f64,
    drift: DVec3,
    /// The exterior derivative of the drift, entries 12, 13, 23.
    exterior: DVec3,
    /// Columns: `∂_k W`.
    slopes: DMat3,
}

impl Manifold {
    /// Whether light has unit speed against a wind, or drifts: paths then are no geodesics.
    pub fn has_wind(&self) -> bool {
        self.tapes.moving
    }

    /// Whether there is a wind, beside which there may be a drift.
    pub fn blows(&self) -> bool {
        self.tapes.parts.wind
    }

    /// Whether clocks of normal observers run at rates of their own.
    pub fn has_lapse(&self) -> bool {
        self.tapes.parts.lapse
    }

    /// Whether time is not what paths of light are measured by.
    pub fn has_drift(&self) -> bool {
        self.tapes.parts.drift
    }

    /// Whether light may change its frequency: there is a wind, a drift or a lapse.
    pub fn has_redshift(&self) -> bool {
        self.kin.is_some() || self.tapes.medium.is_some()
    }

    /// The normal observer at `u`.
    pub fn observer(&self, u: DVec3) -> Observer {
        Observer {
            frame: self.standard_frame(u),
            wind: self.wind(u),
        }
    }

    /// The normal observers at many points.
    pub fn observers(&self, points: &[DVec3]) -> Vec<Observer> {
        let frames = self.standard_frames(points).into_iter();
        let observer = |(frame, u): (DMat3, &DVec3)| Observer {
            frame,
            wind: self.wind(*u),
        };
        frames.zip(points).map(observer).collect()
    }

    /// `W(u)` as the paths followed meet it: reversed for lines of sight. `None` without a wind.
    pub fn wind(&self, u: DVec3) -> Option<DVec3> {
        self.has_wind().then(|| self.medium(u).wind)
    }

    /// `b(u)` as the paths followed meet it, chart components of a covector.
    pub fn drift(&self, u: DVec3) -> DVec3 {
        self.medium(u).drift
    }

    /// The direction `n = v − W` in which a path with tangent `v` is seen at `u`, chart components.
    pub fn sight(&self, u: DVec3, v: DVec3) -> DVec3 {
        match self.wind(u) {
            Some(wind) => v - wind,
            None => v,
        }
    }

    /// `1 + ⟨W, n⟩` for a path seen in the direction `n` (chart components): what a path gains on the
    /// clock of the spacetime for each unit that the normal observer sees it go.
    pub fn share(&self, u: DVec3, n: DVec3) -> f64 {
        match self.wind(u) {
            Some(wind) => 1.0 + n.dot(self.metric(u) * wind),
            None => 1.0,
        }
    }

    /// The frequency that the normal observer at `u` measures of light seen in the direction `n` (chart
    /// components, unit), for light of energy 1: `1/(N (1 + ⟨W, n⟩))`.
    pub fn normal_frequency(&self, u: DVec3, n: DVec3) -> f64 {
        match &self.tapes.medium {
            Some(_) => 1.0 / (self.medium(u).lapse * self.share(u, n)),
            None => 1.0,
        }
    }

    /// Computes the frequency seen over the frequency sent, by normal observers at two places `(u, v)` of one
    /// path: at its start and farther along. `None` where light keeps its frequency.
    pub fn redshift(&self, start: (DVec3, DVec3), place: (DVec3, DVec3)) -> Option<f64> {
        let frequency = |(u, v)| self.normal_frequency(u, self.sight(u, v));
        let g = self
            .has_redshift()
            .then(|| frequency(start) / frequency(place))?;
        Some(match self.follows() {
            Follows::Light => 1.0 / g,
            _ => g,
        })
    }

    /// The same for an observer who moves with `dx/dt = velocity` (chart components); not a number if
    /// that is faster than light.
    pub fn frequency(&self, u: DVec3, n: DVec3, velocity: DVec3) -> f64 {
        let g = self.metric(u);
        let Medium {
            wind, lapse, drift, ..
        } = self.medium(u);
        // Into the past everything moves the other way.
        let velocity = match self.follows {
            Follows::Sight => -velocity,
            _ => velocity,
        };
        let velocity = velocity / (1.0 - drift.dot(velocity));
        let share = 1.0 + n.dot(g * wind);
        let past = velocity - wind;
        let slowed = (1.0 - past.dot(g * past)).sqrt();
        (1.0 - n.dot(g * velocity) / share) / (lapse * slowed)
    }

    /// The rate at which time runs along a path with tangent `v`: `1 + b(v)`.
    pub fn time_rate(&self, u: DVec3, v: DVec3) -> f64 {
        1.0 + self.medium(u).drift.dot(v)
    }

    /// By how much the direction of sight `n` changes, as a covariant derivative, from a path through `u`
    /// with tangent `v` to a neighbour whose point and tangent differ by `du` and `dv` (chart components).
    pub fn sight_change(&self, (u, v): (DVec3, DVec3), (du, dv): (DVec3, DVec3)) -> DVec3 {
        if !self.has_wind() {
            return dv - self.parallel_rate(u, v, du);
        }
        let Medium { wind, slopes, .. } = self.medium(u);
        dv - slopes * du - self.parallel_rate(u, du, v - wind)
    }

    /// N at `u`, not a number where there is none.
    pub(super) fn lapse(&self, u: DVec3) -> f64 {
        self.medium(u).lapse
    }

    /// Whether wind and drift at `u` are finite.
    pub(super) fn is_medium_finite(&self, u: DVec3) -> bool {
        let medium = self.medium(u);
        medium.wind.is_finite() && medium.drift.is_finite()
    }

    /// Wind and the exterior derivative of the drift at `u`, by which symmetries are judged.
    pub(super) fn currents(&self, u: DVec3) -> (DVec3, DVec3) {
        let medium = self.medium(u);
        (medium.wind, medium.exterior)
    }

    fn medium(&self, u: DVec3) -> Medium {
        let Some(tape) = &self.tapes.medium else {
            return Medium {
                wind: DVec3::ZERO,
                lapse: 1.0,
                drift: DVec3::ZERO,
                exterior: DVec3::ZERO,
                slopes: DMat3::ZERO,
            };
        };
        let o = self.at_point(tape, u);
        Medium {
            wind: DVec3::from_slice(&o[..3]),
            lapse: o[3],
            drift: DVec3::from_slice(&o[4..7]),
            exterior: DVec3::from_slice(&o[7..10]),
            slopes: DMat3::from_cols_slice(&o[10..19]),
        }
    }
}
