//! Directions and frequencies as an observer at a point sees them.
//!
//! In: a chart point. Out: the normal observer's [`LocalFrame`], which turns directions in the standard
//! frame into tangents and back, and frequencies of light there.
//!
//! Light keeps `|v − W| = 1`: where there is a wind, the tangent `v` of its path is not the direction
//! `n = v − W` in which the normal observer sees it. Lines of sight run into the past, and along them
//! `n` points to where the light comes from and `W` is the wind reversed.

use super::{Follows, Manifold};
use glam::{DMat3, DVec3};

/// Holds the standard frame at a point, and the wind there if there is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFrame {
    /// `S(u)`: columns are the standard frame.
    pub frame: DMat3,
    /// `W(u)` as the paths followed meet it, chart components.
    pub wind: Option<DVec3>,
}

impl LocalFrame {
    /// Returns the tangent of a path that is seen in the direction `d` (standard frame, unit).
    #[inline(always)]
    pub fn tangent(&self, d: DVec3) -> DVec3 {
        let n = self.frame * d;
        match self.wind {
            Some(wind) => n + wind,
            None => n,
        }
    }

    /// Returns the direction, chart components, in which a path with tangent `v` is seen.
    #[inline(always)]
    pub fn sight(&self, v: DVec3) -> DVec3 {
        match self.wind {
            Some(wind) => v - wind,
            None => v,
        }
    }

    /// Inverts [`Self::tangent`]: returns a direction in the standard frame, of unit length for the
    /// tangent of a path.
    pub fn direction(&self, v: DVec3) -> DVec3 {
        self.frame.inverse() * self.sight(v)
    }

    /// Returns the frame of an observer at rest in the chart, where the metric is `g`: that of things that do not
    /// move. To them space is `G + W♭W♭/(1 − |W|²)`. Where nothing can be at rest, and without a wind, it
    /// is the standard frame.
    pub fn rest_frame(&self, g: DMat3) -> DMat3 {
        let Some(wind) = self.wind else {
            return self.frame;
        };
        let lowered = g * wind;
        let slow = 1.0 - wind.dot(lowered);
        if !(slow > 0.0) {
            return self.frame;
        }
        let across = DMat3::from_cols(
            lowered * lowered.x,
            lowered * lowered.y,
            lowered * lowered.z,
        );
        gram_schmidt(g + across * (1.0 / slow))
    }

    /// Describes the same point in coordinates that move by `pace` (chart components) for each unit of arc length of the
    /// paths followed: tangents there are less by `pace`, and what moves so is at rest.
    pub fn moving(self, pace: DVec3) -> Self {
        Self {
            wind: Some(self.wind.unwrap_or(DVec3::ZERO) - pace),
            ..self
        }
    }

    /// Returns the tangent of the path that runs along `x` (chart components, any length but zero).
    pub fn along(&self, g: DMat3, x: DVec3) -> DVec3 {
        let Some(wind) = self.wind else {
            return x / x.dot(g * x).sqrt();
        };
        // |κx − W| = 1
        let (square, beside) = (x.dot(g * x), x.dot(g * wind));
        let slow = 1.0 - wind.dot(g * wind);
        x * ((beside + (beside * beside + square * slow).sqrt()) / square)
    }

    /// Tells how much larger a solid angle of light along the tangent `v` is to this observer than to one at rest
    /// in the chart; 1 where nothing can be at rest.
    pub fn spread_against_rest(&self, g: DMat3, v: DVec3) -> f64 {
        let Some(wind) = self.wind else { return 1.0 };
        let slow = 1.0 - wind.dot(g * wind);
        // Solid angles are as the squares of wavelengths.
        let share = (v - wind).dot(g * v);
        if slow > 0.0 {
            share * share / slow
        } else {
            1.0
        }
    }

    /// Returns the direction (chart components) in which a point at `way` from here is seen to first
    /// order, times how long a path takes from it; not a number if none does.
    pub fn toward(&self, g: DMat3, way: DVec3) -> DVec3 {
        let Some(wind) = self.wind else { return way };
        // |way − W s| = s
        let (square, beside) = (way.dot(g * way), way.dot(g * wind));
        let slow = 1.0 - wind.dot(g * wind);
        let s = square / (beside + (beside * beside + square * slow).sqrt());
        if square > 0.0 { way - wind * s } else { way }
    }

    /// Returns the tangent `v` with what is left of it against the wind at unit length in the metric `g` here:
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

/// Computes the upper triangular matrix of an orthonormal frame of the metric `g`, in coordinate order.
fn gram_schmidt(g: DMat3) -> DMat3 {
    let mut frame = DMat3::IDENTITY;
    for k in 0..3 {
        let mut w = frame.col(k);
        for j in 0..k {
            w -= frame.col(j) * frame.col(j).dot(g * w);
        }
        *frame.col_mut(k) = w / w.dot(g * w).sqrt();
    }
    frame
}

/// Wind, lapse and drift at a point, as the paths followed meet them.
#[derive(Debug, Clone, Copy)]
struct LocalMedium {
    wind: DVec3,
    lapse: f64,
    drift: DVec3,
}

impl LocalMedium {
    /// Without wind, drift and lapse.
    const NONE: Self = Self {
        wind: DVec3::ZERO,
        lapse: 1.0,
        drift: DVec3::ZERO,
    };

    /// Reads the outputs of its tape.
    fn of(outputs: &[f64]) -> Self {
        Self {
            wind: DVec3::from_slice(&outputs[..3]),
            lapse: outputs[3],
            drift: DVec3::from_slice(&outputs[4..7]),
        }
    }
}

/// Frequencies of light at a point, as observers there measure them.
#[derive(Debug, Clone, Copy)]
pub struct Frequencies {
    metric: DMat3,
    medium: LocalMedium,
    follows: Follows,
}

impl Frequencies {
    /// Returns the metric.
    pub fn metric(&self) -> DMat3 {
        self.metric
    }

    /// Returns the lapse `N`.
    pub fn lapse(&self) -> f64 {
        self.medium.lapse
    }

    /// Returns the drift `b`, chart components of a covector, as the paths followed meet it.
    pub fn drift(&self) -> DVec3 {
        self.medium.drift
    }

    /// Returns the direction `n = v − W` in which a path with tangent `v` of any length is seen, chart components, of
    /// unit length.
    pub fn sight(&self, v: DVec3) -> DVec3 {
        let n = v - self.medium.wind;
        n / n.dot(self.metric * n).sqrt()
    }

    /// Returns the frequency that the normal observer measures of light seen in the direction `n` (chart components,
    /// unit), for light of energy 1: `1/(N (1 + ⟨W, n⟩))`.
    pub fn normal(&self, n: DVec3) -> f64 {
        1.0 / (self.medium.lapse * self.share(n))
    }

    /// Returns the same for an observer who moves with `dx/dt = velocity` (chart components); not a number if that is
    /// faster than light.
    pub fn moving(&self, n: DVec3, velocity: DVec3) -> f64 {
        let (g, past) = (self.metric, self.past_normal(velocity));
        let slowed = (1.0 - past.dot(g * past)).sqrt();
        let seen = 1.0 - n.dot(g * (past + self.medium.wind)) / self.share(n);
        seen / (self.medium.lapse * slowed)
    }

    /// Tells whether something with `dx/dt = velocity` (chart components) is slower than light.
    pub fn is_slower_than_light(&self, velocity: DVec3) -> bool {
        let past = self.past_normal(velocity);
        past.dot(self.metric * past) < 1.0
    }

    /// Returns `1 + ⟨W, n⟩`: what a path gains on the clock of the spacetime for each unit that the normal observer sees it
    /// go.
    pub fn share(&self, n: DVec3) -> f64 {
        1.0 + n.dot(self.metric * self.medium.wind)
    }

    /// Returns how far (chart components) what moves with `dx/dt = velocity` gets for each unit of arc length of the
    /// paths followed.
    pub fn along_paths(&self, velocity: DVec3) -> DVec3 {
        // Into the past everything moves the other way.
        let velocity = match self.follows {
            Follows::Sight => -velocity,
            _ => velocity,
        };
        velocity / (1.0 - self.medium.drift.dot(velocity))
    }

    /// Returns the velocity (chart components) at which what has `dx/dt = velocity` moves past the normal observer, along
    /// the paths followed.
    fn past_normal(&self, velocity: DVec3) -> DVec3 {
        self.along_paths(velocity) - self.medium.wind
    }
}

/// A place on a path, and two paths beside it.
#[derive(Debug, Clone, Copy)]
pub struct PathNeighbours {
    /// Chart point.
    pub u: DVec3,
    /// Tangent, chart components.
    pub v: DVec3,
    /// By how much point and tangent of each of them differ, chart components.
    pub neighbours: [(DVec3, DVec3); 2],
}

/// Reads the exterior derivative of the drift and the slopes of the wind from the outputs of their tape.
fn slopes_of(row: &[f64]) -> (DVec3, DMat3) {
    (
        DVec3::from_slice(&row[..3]),
        DMat3::from_cols_slice(&row[3..12]),
    )
}

impl Manifold {
    /// Returns whether light has unit speed against a wind, or drifts: paths then are no geodesics.
    pub fn has_wind(&self) -> bool {
        self.tapes.parts.moves()
    }

    /// Returns whether there is a wind, beside which there may be a drift.
    pub fn blows(&self) -> bool {
        self.tapes.parts.wind.is_some()
    }

    /// Tells whether clocks of normal observers run at rates of their own.
    pub fn has_lapse(&self) -> bool {
        self.tapes.parts.lapse.is_some()
    }

    /// Returns whether time is not what paths of light are measured by.
    pub fn has_drift(&self) -> bool {
        self.tapes.parts.drift.is_some()
    }

    /// Returns whether light may change its frequency: there is a wind, a drift or a lapse.
    pub fn has_redshift(&self) -> bool {
        self.kin.is_some() || self.tapes.medium.is_some()
    }

    /// Returns the frame of the normal observer at `u`.
    pub fn local_frame(&self, u: DVec3) -> LocalFrame {
        LocalFrame {
            frame: self.standard_frame(u),
            wind: self.wind(u),
        }
    }

    /// Returns [`Self::local_frame`] at many points.
    pub fn local_frames(&self, points: &[DVec3]) -> Vec<LocalFrame> {
        let frames = self.standard_frames(points).into_iter();
        let local = |(frame, medium): (DMat3, LocalMedium)| LocalFrame {
            frame,
            wind: self.has_wind().then_some(medium.wind),
        };
        frames.zip(self.media(points)).map(local).collect()
    }

    /// Returns [`LocalFrame::rest_frame`] at many points.
    pub fn rest_frames(&self, points: &[DVec3]) -> Vec<DMat3> {
        if !self.has_wind() {
            return self.standard_frames(points);
        }
        let known = self.metrics_and_frames(points).into_iter();
        let rest = |((metric, frame), medium): ((DMat3, DMat3), LocalMedium)| {
            let wind = Some(medium.wind);
            LocalFrame { frame, wind }.rest_frame(metric)
        };
        known.zip(self.media(points)).map(rest).collect()
    }

    /// Returns `W(u)` as the paths followed meet it: reversed for lines of sight. `None` without a wind.
    pub fn wind(&self, u: DVec3) -> Option<DVec3> {
        self.has_wind().then(|| self.medium(u).wind)
    }

    /// Computes the length of the tangent `v` at `u`, against the wind: 1 on the paths followed.
    pub fn speed(&self, u: DVec3, v: DVec3) -> f64 {
        let n = v - self.wind(u).unwrap_or(DVec3::ZERO);
        n.dot(self.metric(u) * n).sqrt()
    }

    /// Returns `b(u)` as the paths followed meet it, chart components of a covector.
    pub fn drift(&self, u: DVec3) -> DVec3 {
        self.medium(u).drift
    }

    /// Returns the direction `n = v − W` in which a path with tangent `v` is seen at `u`, chart components.
    pub fn sight(&self, u: DVec3, v: DVec3) -> DVec3 {
        match self.wind(u) {
            Some(wind) => v - wind,
            None => v,
        }
    }

    /// Returns what frequencies light has at `u`.
    pub fn frequencies(&self, u: DVec3) -> Frequencies {
        Frequencies {
            metric: self.metric(u),
            medium: self.medium(u),
            follows: self.follows,
        }
    }

    /// Returns [`Self::frequencies`] at many points.
    pub fn frequencies_at(&self, points: &[DVec3]) -> Vec<Frequencies> {
        let known = self.metrics_and_frames(points).into_iter();
        let both = known.zip(self.media(points));
        let both = both.map(|((metric, _), medium)| Frequencies {
            metric,
            medium,
            follows: self.follows,
        });
        both.collect()
    }

    /// Returns [`Frequencies::share`] at `u`.
    pub fn share(&self, u: DVec3, n: DVec3) -> f64 {
        match self.has_wind() {
            true => self.frequencies(u).share(n),
            false => 1.0,
        }
    }

    /// Returns [`Frequencies::normal`] at `u`.
    pub fn normal_frequency(&self, u: DVec3, n: DVec3) -> f64 {
        match &self.tapes.medium {
            Some(_) => self.frequencies(u).normal(n),
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

    /// Returns [`Frequencies::moving`] at `u`.
    pub fn frequency(&self, u: DVec3, n: DVec3, velocity: DVec3) -> f64 {
        self.frequencies(u).moving(n, velocity)
    }

    /// Returns the velocity at which something at rest in the chart moves by the normal observer at `u`,
    /// standard frame; light has 1. Where nothing can be at rest it is faster.
    pub fn rest_velocity(&self, u: DVec3) -> DVec3 {
        let LocalFrame { frame, wind } = self.local_frame(u);
        // The wind blows forward in time; lines of sight meet it reversed.
        match (wind, self.follows) {
            (None, _) => DVec3::ZERO,
            (Some(wind), Follows::Sight) => frame.inverse() * wind,
            (Some(wind), _) => frame.inverse() * -wind,
        }
    }

    /// Returns [`Frequencies::is_slower_than_light`] at `u`.
    pub fn is_slower_than_light(&self, u: DVec3, velocity: DVec3) -> bool {
        self.frequencies(u).is_slower_than_light(velocity)
    }

    /// Returns the rate at which time runs along a path with tangent `v`: `1 + b(v)`.
    pub fn time_rate(&self, u: DVec3, v: DVec3) -> f64 {
        1.0 + self.medium(u).drift.dot(v)
    }

    /// Returns the changes, as covariant derivatives, of the direction of sight `n` from a path through `u` with tangent
    /// `v` to two neighbours, at many places with these local frames.
    pub fn sight_changes(
        &self,
        places: &[PathNeighbours],
        frames: &[LocalFrame],
    ) -> Vec<[DVec3; 2]> {
        // The vectors that are transported, along the direction of sight.
        let along = places.iter().zip(frames).map(|(place, local)| {
            let [(a, _), (b, _)] = place.neighbours;
            (place.u, local.sight(place.v), [a, b])
        });
        let rates = self.parallel_rates(&along.collect::<Vec<_>>());
        let points: Vec<DVec3> = places.iter().map(|place| place.u).collect();
        let changes = places.iter().zip(self.wind_slopes(&points)).zip(rates);
        changes
            .map(|((place, slopes), rates)| {
                let [a, b] = place.neighbours;
                let change = |(du, dv): (DVec3, DVec3), rate: DVec3| dv - slopes * du - rate;
                [change(a, rates[0]), change(b, rates[1])]
            })
            .collect()
    }

    /// Returns N at `u`, not a number where there is none.
    pub(super) fn lapse(&self, u: DVec3) -> f64 {
        self.medium(u).lapse
    }

    /// Tells whether wind and drift at `u` are finite.
    pub(super) fn is_medium_finite(&self, u: DVec3) -> bool {
        let medium = self.medium(u);
        medium.wind.is_finite() && medium.drift.is_finite()
    }

    /// Returns wind and the exterior derivative of the drift at `u`, by which symmetries are judged.
    pub(super) fn currents(&self, u: DVec3) -> (DVec3, DVec3) {
        (self.medium(u).wind, self.medium_slopes(u).0)
    }

    fn medium(&self, u: DVec3) -> LocalMedium {
        match &self.tapes.medium {
            Some(tape) => LocalMedium::of(&self.at_point(tape, u)),
            None => LocalMedium::NONE,
        }
    }

    /// [`Self::medium`] at many points.
    fn media(&self, points: &[DVec3]) -> Vec<LocalMedium> {
        let Some(tape) = &self.tapes.medium else {
            return vec![LocalMedium::NONE; points.len()];
        };
        let rows = self.at_points(tape, points);
        rows.chunks_exact(tape.outputs())
            .map(LocalMedium::of)
            .collect()
    }

    /// Returns the exterior derivative of the drift at `u` (entries 12, 13, 23), and the derivatives `∂_k W` of the wind
    /// as columns.
    fn medium_slopes(&self, u: DVec3) -> (DVec3, DMat3) {
        let Some(tape) = &self.tapes.medium_slopes else {
            return (DVec3::ZERO, DMat3::ZERO);
        };
        slopes_of(&self.at_point(tape, u))
    }

    /// Returns the slopes of the wind at many points.
    fn wind_slopes(&self, points: &[DVec3]) -> Vec<DMat3> {
        let Some(tape) = &self.tapes.medium_slopes else {
            return vec![DMat3::ZERO; points.len()];
        };
        let rows = self.at_points(tape, points);
        let slopes = rows.chunks_exact(tape.outputs());
        slopes.map(|row| slopes_of(row).1).collect()
    }
}
