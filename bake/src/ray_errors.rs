//! The errors of a path on one ray, by the rules of the certificate.
//!
//! In: a ray that was followed exactly, and the path that a table gives for it. Out: [`RayErrors`]. What is as wrong as it can
//! be counts as [`NOTHING_SEEN`], so that it does not look small by being left out.

use geofan_bundle::{
    Table, TablePath,
    measure::{Deviation, NOTHING_SEEN, Probed},
};
use geofan_core::{geodesic::End, manifold::Manifold};
use glam::{DQuat, DVec3};

/// Tells how far a path is from the exact one, mrad.
#[derive(Debug, Clone, Copy)]
pub struct RayErrors {
    /// At the first probe; `None` where there is nothing to compare or the table gives up.
    pub deviation: Option<Deviation>,
    /// Between the transported rotations there, where the table tells one.
    pub rotation_mrad: Option<f64>,
    /// Of the direction in which the ray ends, where the table tells it.
    pub sky_mrad: Option<f64>,
    /// Set if the table gives up a part of the ray.
    pub flagged: bool,
}

impl RayErrors {
    /// Compares a path of a table.
    pub fn of_table(table: &Table, path: &TablePath<'_>, exact: &Probed) -> Self {
        let from = path.flagged_from();
        let at = |s: f64| path.at(s);
        // Of one that the table gives up on exact paths tell.
        let known = table.space.ends_alike() && from > table.length;
        let leaves = || {
            !known
                || is_beyond_exit(table.space.manifold(), exact, table.length, at)
                || path.first_event(table.length).is_some()
        };
        let rotation = |s: f64| path.rotation(s);
        Self::of_path(exact, (at, rotation), (table.frames, from), leaves)
    }

    /// Compares any path: `at` tells chart point and tangent at an arc length, `rotation` the transported rotation. There are
    /// directions and rotations if there are `frames`; what comes behind the arc length `flagged_from` is given up. `leaves`
    /// tells whether the path meets an exit.
    pub fn of_path(
        exact: &Probed,
        (at, rotation): (
            impl Fn(f64) -> Option<(DVec3, DVec3)>,
            impl Fn(f64) -> Option<DQuat>,
        ),
        (frames, flagged_from): (bool, f64),
        leaves: impl FnOnce() -> bool,
    ) -> Self {
        let sky_mrad = frames.then(|| end_error(exact, &at, leaves)).flatten();
        let flagged = flagged_from < exact.length;
        let Some(probe) = exact.probes.first() else {
            // Nothing is known of a path that cannot even begin.
            let begins = exact.end == End::Singular && flagged_from > 0.0;
            return Self {
                deviation: begins.then_some(Deviation {
                    mrad: NOTHING_SEEN,
                    screen_mrad: NOTHING_SEEN,
                    rotation_mrad: None,
                }),
                rotation_mrad: None,
                sky_mrad,
                flagged,
            };
        };
        let deviation = at(probe.s).map(|(u, _)| probe.deviation(u, rotation(probe.s)));
        // A frame that cannot be carried is as wrong as one can be; those of flagged paths are integrated.
        let turned = deviation.filter(|_| frames && flagged_from >= probe.s);
        Self {
            deviation,
            rotation_mrad: turned.map(|found| found.rotation_mrad.unwrap_or(NOTHING_SEEN)),
            sky_mrad,
            flagged: flagged || deviation.is_none(),
        }
    }
}

/// Computes the error of the direction in which a ray ends, mrad; `None` where the exact ray tells no direction, or the path
/// has none there.
fn end_error(
    exact: &Probed,
    at: impl Fn(f64) -> Option<(DVec3, DVec3)>,
    leaves: impl FnOnce() -> bool,
) -> Option<f64> {
    let tangent = exact.tangent()?;
    let (_, v) = at(tangent.s)?;
    Some(match exact.exits() && !leaves() {
        true => NOTHING_SEEN,
        false => tangent.sky_mrad(v - tangent.v),
    })
}

/// Factor of the arc length of an exit behind which most paths are beyond it.
const BEHIND_EXIT: f64 = 1.02;

/// Tells whether a path of this `length`, whose chart point and tangent `at` tells, is beyond an exit a little behind the
/// end of the `exact` one, or at its own.
pub fn is_beyond_exit(
    manifold: &Manifold,
    exact: &Probed,
    length: f64,
    at: impl Fn(f64) -> Option<(DVec3, DVec3)>,
) -> bool {
    // Behind the table's end the path goes on straight: one that leaves just there is no worse than others.
    let is_beyond = |s: f64| {
        at(s.min(length)).is_some_and(|(u, v)| {
            let ahead = u + v * (s - length).max(0.0);
            let state = [ahead.to_array(), v.to_array()].concat();
            let events = manifold.domain.events().at(&state);
            events.iter().any(|value| *value > 0.0)
        })
    };
    let end = exact.tangent().map_or(exact.length, |tangent| tangent.s);
    is_beyond(BEHIND_EXIT * end) || is_beyond(length)
}
