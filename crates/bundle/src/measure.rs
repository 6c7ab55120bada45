//! Table against exact: errors in mrad.
//!
//! The error of a point is its transverse distance, in the metric at the exact point, over the arc
//! length; its screen error is what it looks like from the camera, `|δ|` with `J δ = e`. The sky error
//! of a tangent is its angle from the exact one, or, where neighbouring tangents part faster than in
//! flat space, what that looks like from the camera: how far a star seen along it is off.
//!
//! In: rays and arc lengths. Out: [`Probe`]s (what is exactly there) and the [`Deviation`] of any
//! other answer from them.

use crate::rays::RaySpace;
use geofan_core::{
    geodesic::{End, JacobiField, Ray, Settings, Step, paths},
    manifold::{Carried, Manifold},
};
use glam::{DMat3, DQuat, DVec3};
use std::num::NonZeroU32;

/// The exact state of a ray at an arc length.
#[derive(Debug, Clone, Copy)]
pub struct Probe {
    /// Arc length.
    pub s: f64,
    /// Chart point.
    pub u: DVec3,
    /// Tangent, chart components.
    pub v: DVec3,
    frame_inverse: DMat3,
    /// The Jacobi fields of points, and of tangents.
    spread: JacobiField,
    turning: JacobiField,
    /// The transported rotation, if it is carried.
    rotation: Option<DQuat>,
}

/// The distance of an answer from the exact one, in mrad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Transverse distance over arc length.
    pub mrad: f64,
    /// The screen error divided by the ray's magnification, mrad.
    pub screen_mrad: f64,
    /// Angle between the transported rotations; `None` if one of both has none.
    pub rotation_mrad: Option<f64>,
}

impl Probe {
    /// Measures how far the answer (`u`, `rotation`) is from this.
    pub fn deviation(&self, u: DVec3, rotation: Option<DQuat>) -> Deviation {
        let e = self.frame_inverse * (u - self.u);
        Deviation {
            mrad: 1e3 * self.spread.transverse(e) / self.s,
            screen_mrad: 1e3 * self.spread.screen_angle(e, self.s),
            rotation_mrad: self
                .rotation
                .zip(rotation)
                .map(|(exact, found)| 1e3 * exact.angle_between(found)),
        }
    }

    /// Computes how much farther neighbouring rays part than in flat space, the smaller way: the smaller
    /// singular value of `J/s`.
    pub fn magnification(&self) -> f64 {
        self.spread.least_magnification(self.s)
    }

    /// The screen error of an answer off by `change` in the chart.
    pub fn screen_mrad(&self, change: DVec3) -> f64 {
        1e3 * self
            .spread
            .screen_angle(self.frame_inverse * change, self.s)
    }

    /// The sky error of a tangent off by `change` in the chart.
    pub fn sky_mrad(&self, change: DVec3) -> f64 {
        1e3 * self.turning.sky_angle(self.frame_inverse * change)
    }
}

/// Exact knowledge of one ray, for comparison with a table.
#[derive(Debug, Clone)]
pub struct Probed {
    /// Where the ray ended.
    pub end: End,
    /// Its arc length.
    pub length: f64,
    /// The states asked for, as far as the ray went.
    pub probes: Vec<Probe>,
    /// The edges that it met: where, and their numbers (see [`Step::edge`]).
    pub edges: Vec<(f64, NonZeroU32)>,
    /// Set if the manifold has exits.
    exits_exist: bool,
}

impl Probed {
    /// Returns whether an exit ended the ray.
    pub fn exits(&self) -> bool {
        matches!(self.end, End::Exit(_))
    }

    /// Where the tangent of a ray probed with [`with_end`] is compared: at the exit, where it tells what
    /// is seen of the sky. In a manifold without exits, where the point is.
    pub fn tangent(&self) -> Option<&Probe> {
        match self.exits_exist {
            true => self.probes.last().filter(|_| self.exits()),
            false => self.probes.first(),
        }
    }
}

/// Returns whether tangents of the stored rays of `space` are compared at exits only.
pub fn tangents_at_exits(space: &RaySpace) -> bool {
    space.ends_alike() && space.manifold().domain.ends_rays()
}

/// The arc lengths at which a ray that ends at `end` is compared: at `share` of it, and there.
pub fn with_end(share: f64, end: f64) -> Vec<f64> {
    vec![end * share, end]
}

/// Everything carried, ending at exits, to the local `tolerance`.
pub fn settings(tolerance: f64) -> Settings {
    Settings::bare(tolerance)
        .with_frame()
        .with_deviation()
        .with_events()
}

/// Returns the settings for the stored rays of `space`, which end only where every ray does that they stand for. Their
/// rotations are not compared; in a wind they would take a third of the time, elsewhere next to nothing.
pub fn stored_settings(space: &RaySpace, tolerance: f64) -> Settings {
    Settings {
        tolerance,
        carried: Carried {
            frame: !space.manifold().has_wind(),
            deviation: true,
        },
        events: space.ends_alike(),
    }
}

/// Follows rays (chart point, direction in the standard frame) over `length` and probes each at the
/// arc lengths that `lengths` gives for its index and final length. The settings must carry the
/// deviation.
pub fn probe(
    manifold: &Manifold,
    settings: Settings,
    length: f64,
    rays: &[(DVec3, DVec3)],
    lengths: impl Fn(usize, f64) -> Vec<f64>,
) -> Vec<Probed> {
    let starts = rays.iter().map(|&(u, d)| Ray::new(manifold, u, d, length));
    let paths = paths(manifold, settings, starts);
    let mut probed = Vec::new();
    for (i, path) in paths.iter().enumerate() {
        let states = lengths(i, path.length)
            .into_iter()
            .filter_map(|s| state(manifold, path.step_at(s)?, s));
        probed.push(Probed {
            end: path.end,
            length: path.length,
            probes: states.collect(),
            edges: path.edges().collect(),
            exits_exist: manifold.domain.ends_rays(),
        });
    }
    probed
}

/// The exact state at `s` on `step`; `None` if it does not carry the deviation.
fn state(manifold: &Manifold, step: &Step, s: f64) -> Option<Probe> {
    let (u, v) = (step.position(s), step.tangent(s));
    let local = manifold.local_frame(u);
    let frame_inverse = local.frame.inverse();
    let deviation = step.deviation(s)?;
    let rates = step.deviation_rate(s)?;
    let covariant = [0, 1].map(|k| manifold.sight_change((u, v), (deviation[k], rates[k])));
    Some(Probe {
        s,
        u,
        v,
        frame_inverse,
        spread: JacobiField::seen_by(&local, v, deviation),
        turning: JacobiField::new(frame_inverse, local.sight(v), covariant),
        rotation: step.rotation(s),
    })
}
