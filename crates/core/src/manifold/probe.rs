//! The numerical checks that a manifold must pass before it is used.
//!
//! In: a [`Manifold`] as read. Out: nothing, or a complaint with the point at which a check failed:
//! a camera region outside the domain, a metric that is not positive definite or differs where limits
//! are glued, a false symmetry claim. Claims are checked once more where paths go, of which only those know who
//! follow some ([`Manifold::check_symmetry`]).

use super::{EventKind, Form, Isometry, Manifold};
use crate::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    random::Stream,
};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

/// Number of points probed: enough that a metric that fails on a few per cent of the region is
/// refused almost surely, and still below a millisecond.
const PROBES: usize = 64;

/// The largest relative discrepancy of the metric under a claimed symmetry. Honest claims measure
/// 1e-15 to 1e-11 on the shipped files; claims wrong by one part in a million measure 1e-6.
pub(super) const WORST_DISCREPANCY: f64 = 1e-8;

/// Distance inside its limits, as a share of the period, at which a glued coordinate is looked at.
const SEAM: f64 = 1e-9;

/// The largest relative difference of the metric at glued limits: limits written with seven digits
/// of π pass, a period that is wrong does not.
const WORST_SEAM: f64 = 1e-6;

/// Checks regions, metric and symmetry claims.
pub(super) fn check(manifold: &Manifold) -> Result<()> {
    let points = probe_points(manifold);
    for (u, camera) in &points {
        check_lapse(manifold, *u)?;
        if *camera {
            check_inside(manifold, *u)?;
            check_not_left(manifold, *u)?;
            check_pullback(manifold, *u)?;
        }
        check_metric(manifold, *u)?;
        check_wind(manifold, *u)?;
        check_glued(manifold, *u)?;
        check_identity(manifold, *u)?;
    }
    for u in seam_points(manifold) {
        check_glued(manifold, u)?;
    }
    let points: Vec<_> = points.into_iter().map(|(u, _)| u).collect();
    check_symmetry(manifold, claimed(manifold, &points), WORST_DISCREPANCY)
}

/// The largest discrepancy under a claimed symmetry far from cameras, where rounding may be larger.
const WORST_ALONG_PATHS: f64 = 1e-6;

impl Manifold {
    /// Checks the claimed symmetries at `points` that paths go through, at each a symmetry of its own: cameras alone
    /// may not stand near what breaks them.
    ///
    /// # Errors
    /// A claim that is false, with the point.
    pub fn check_symmetry(&self, points: &[DVec3]) -> Result<()> {
        let mut claims = claimed(self, points);
        claims.retain(|(_, isometry, u)| {
            let is_seen = |u: DVec3| self.domain.exit_beyond(u).is_none();
            is_seen(*u) && is_seen(isometry.apply(*u).0)
        });
        check_symmetry(self, claims, WORST_ALONG_PATHS)
    }
}

/// Returns the `i`-th point of the Halton sequence in [0, 1]³.
pub(super) fn halton(i: usize) -> [f64; 3] {
    [2, 3, 5].map(|base| {
        let (mut value, mut scale, mut left) = (0.0, 1.0, i + 1);
        while left > 0 {
            scale /= base as f64;
            value += scale * (left % base) as f64;
            left /= base;
        }
        value
    })
}

/// Points to probe, and whether each is a camera position: the camera region, else (in the
/// absence of one, or for its group) a box about the origin as far as paths come there. Where the file names one place for
/// cameras, space may end anywhere else: of the box only points at which it does not are taken.
fn probe_points(manifold: &Manifold) -> Vec<(DVec3, bool)> {
    let mut points = Vec::new();
    if let Some(region) = &manifold.cameras {
        let count = if region.dimension() == 0 { 1 } else { PROBES };
        points.extend((0..count).map(|i| (region.at(&region.lerp(&halton(i))), true)));
        // Where a file says how far cameras go, it is likeliest to say too far.
        let corners = match region.written {
            true => 0..1 << region.dimension(),
            false => 0..0,
        };
        let corner = |i: usize| [0, 1, 2].map(|k| (i >> k & 1) as f64);
        points.extend(corners.map(|i| (region.at(&region.lerp(&corner(i))), true)));
    }
    if points.len() < PROBES {
        let one_place = !points.is_empty() && manifold.symmetry.group.is_none();
        let about = points_about(manifold, 1.0, PROBES).into_iter();
        let inside = about.filter(|u| !one_place || is_space(manifold, *u));
        points.extend(inside.map(|u| (u, false)));
    }
    points
}

/// Number of points at which the limits of glued coordinates are compared besides: what differs on a thousandth of them is found
/// nearly surely, in some milliseconds.
const SEAM_PROBES: usize = 4096;

/// Points about the origin as far as paths come, if a coordinate is glued: wherever space is there, not only beside cameras.
fn seam_points(manifold: &Manifold) -> Vec<DVec3> {
    if !manifold.domain.periodic.contains(&true) {
        return Vec::new();
    }
    let reach = manifold.length.unwrap_or(FARTHEST_SEAM).min(FARTHEST_SEAM);
    let mut points = points_about(manifold, reach, SEAM_PROBES);
    points.retain(|u| is_space(manifold, *u));
    points
}

/// Points within the limits, of coordinates without those within `reach` of the origin, to which paths come: of so many those
/// that neither the domain leaves out nor an exit.
fn points_about(manifold: &Manifold, reach: f64, count: usize) -> Vec<DVec3> {
    let domain = &manifold.domain;
    let limits = domain.limits.map(|l| l.unwrap_or([-reach, reach]));
    let point = |i: usize| {
        let t = halton(i);
        DVec3::from_array([0, 1, 2].map(|k| limits[k][0] + (limits[k][1] - limits[k][0]) * t[k]))
    };
    let is_seen = |u: &DVec3| domain.violation(*u).is_none() && domain.exit_beyond(*u).is_none();
    (0..count).map(point).filter(is_seen).collect()
}

/// Distance from the origin to which they are looked for, at most, along coordinates without limits.
const FARTHEST_SEAM: f64 = 10.0;

/// Returns whether metric, wind and lapse are good at `u`.
fn is_space(manifold: &Manifold, u: DVec3) -> bool {
    let checks = [check_lapse, check_metric, check_wind];
    checks.iter().all(|check| check(manifold, u).is_ok())
}

/// A complaint at the first of `keys` that the file has, in that order: at its line, or inside an inline table.
fn complain(manifold: &Manifold, keys: &[&str], message: String) -> Diagnostic {
    let text = &manifold.source.text;
    let place = keys.iter().find_map(|key| {
        let mut start = 0;
        let mut lines = text.split_inclusive('\n').map(|line| {
            start += line.len();
            (start - line.len(), line.trim_end())
        });
        lines.find_map(|(start, line)| {
            let (at, end) = place_of_key(line, key)?;
            Some(start + at..start + end)
        })
    });
    Diagnostic::new(&manifold.source, place.unwrap_or(0..0), message)
}

/// Finds where `key`, a key or the head of a table, begins and what belongs to it ends in a line: at its start, or in an
/// inline table.
fn place_of_key(line: &str, key: &str) -> Option<(usize, usize)> {
    let indent = line.len() - line.trim_start().len();
    if line[indent..].starts_with(key) {
        return Some((indent, line.len()));
    }
    let name = key.trim_matches(['[', ']']);
    let code = line.split('#').next().unwrap_or_default();
    let mut found = code.match_indices(name).map(|(at, _)| at);
    let at = found.find(|at| {
        let before = code[..*at].chars().next_back();
        let after = code[at + name.len()..].trim_start();
        before.is_none_or(|c| " {,\t".contains(c)) && after.starts_with('=')
    })?;
    Some((at, line.trim_end_matches([' ', '}']).len().max(at)))
}

/// Writes a point for people.
pub(super) fn point(manifold: &Manifold, u: DVec3) -> String {
    let [x, y, z] = &manifold.coordinates;
    let [u, v, w] = u.to_array().map(|value| digits(value, u.length()));
    format!("{x} = {u}, {y} = {v}, {z} = {w}")
}

/// Writes a coordinate of a point at this distance from the origin: with six digits behind the point, where these show it.
fn digits(value: f64, distance: f64) -> String {
    match (1e-3..1e9).contains(&distance) || distance == 0.0 || !distance.is_finite() {
        true => format!("{value:.6}"),
        false => format!("{value:.6e}"),
    }
}

fn check_inside(manifold: &Manifold, u: DVec3) -> Result<()> {
    if !u.is_finite() {
        let message = format!("`at` gives no point of the chart: {}", point(manifold, u));
        return Err(complain(manifold, &["at", "[cameras]"], message)
            .with_label("for some of the camera parameters")
            .with_hint(
                "narrow their intervals to where `at` has values, also for these [parameters]",
            )
            .into());
    }
    let gluing = manifold.gluing();
    let what = match manifold.domain.violation(u) {
        Some(EventKind::Limit) => "is outside a coordinate limit",
        Some(_) => "violates a condition of `inside`",
        None if gluing.is_some_and(|g| g.behind_mirror(u).is_some()) => "is behind a mirror",
        None => return Ok(()),
    };
    let message = format!(
        "the camera region leaves the domain: {} {what}",
        point(manifold, u)
    );
    Err(
        complain(manifold, &["at", "[cameras]", "[domain]"], message)
            .with_label("camera positions")
            .with_hint("make the camera region smaller, or the domain larger")
            .into(),
    )
}

/// Cameras where the file puts them must not lie beyond an exit. Where it only gives limits of coordinates,
/// those may reach farther than the exits.
fn check_not_left(manifold: &Manifold, u: DVec3) -> Result<()> {
    let region = manifold.cameras.as_ref().filter(|region| region.written);
    let Some((exit, value)) = region.and_then(|_| manifold.domain.exit_beyond(u)) else {
        return Ok(());
    };
    let name = &manifold.exits[exit].name;
    let message = format!(
        "the camera region reaches beyond the exit `{name}`: its `when` is {value:.6} at {}",
        point(manifold, u)
    );
    Err(complain(manifold, &["at", "[cameras]"], message)
        .with_label("camera positions")
        .with_hint("paths end where `when` becomes positive: make the region smaller, or move the exit out")
        .into())
}

/// Observers must exist whose clocks tell frequencies.
fn check_lapse(manifold: &Manifold, u: DVec3) -> Result<()> {
    let lapse = manifold.lapse(u);
    let here = point(manifold, u);
    let (message, keys, hint) = match manifold.form {
        _ if lapse > 0.0 && lapse.is_finite() => return Ok(()),
        Form::Normal => (
            format!("the slice t = const is not spacelike at {here}"),
            ["[spacetime]", "spacetime"],
            "restrict the region with [domain] or [cameras]; where no slices are spacelike, give `metric` and `drift`",
        ),
        Form::Static => (
            format!("no observer is at rest at {here}: g_tt is not negative there"),
            ["observers", "[spacetime]"],
            "keep cameras out of the ergosphere, or take observers = \"normal\"",
        ),
        _ => (
            format!("the lapse is {lapse} at {here}"),
            ["lapse", "[metric]"],
            "it must be positive: mend the expression, or restrict the region with [domain] or [cameras]",
        ),
    };
    let complaint = complain(manifold, &keys, message).with_hint(hint);
    Err(complaint.into())
}

fn check_wind(manifold: &Manifold, u: DVec3) -> Result<()> {
    if !manifold.has_wind() || manifold.is_medium_finite(u) {
        return Ok(());
    }
    let message = format!("wind or drift is not finite at {}", point(manifold, u));
    let keys = ["wind", "shift", "drift", "[spacetime]", "spacetime"];
    let complaint = complain(manifold, &keys, message);
    Err(complaint
        .with_hint("restrict the region with [domain] or [cameras], or mend the expressions")
        .into())
}

/// Textbook coordinates may fail on an axis, not around it.
fn check_pullback(manifold: &Manifold, u: DVec3) -> Result<()> {
    if !manifold.is_pullback_singular(u) {
        return Ok(());
    }
    let message = format!(
        "the coordinates of [pullback] are singular at a camera: {}",
        point(manifold, u)
    );
    let complaint = complain(manifold, &["[pullback]", "pullback"], message);
    Err(complaint
        .with_label("their differentials are dependent there, or not finite")
        .with_hint("move the cameras, or take coordinates that are regular there")
        .into())
}

/// Share of an entry of the metric below which a pivot is rounding: of a metric without a third direction some roundings of
/// the entry are left, and more would refuse spaces in which a direction is 1e-7 times as long as its coordinate's step.
const ROUNDED_PIVOT: f64 = 1e-14;

/// Returns whether a metric with this frame is finite and positive definite, by more than rounding. The pivots of the
/// metric are `1/S_kk²`; each is what is left of `G_kk`, so that units do not matter.
pub(super) fn is_positive(g: DMat3, s: DMat3) -> bool {
    let is_positive = |k: usize| {
        let e = s.col(k)[k];
        e > 0.0 && e * e * g.col(k)[k] < 1.0 / ROUNDED_PIVOT
    };
    g.is_finite() && s.is_finite() && (0..3).all(is_positive)
}

fn check_metric(manifold: &Manifold, u: DVec3) -> Result<()> {
    let (g, s) = manifold.metric_and_frame(u);
    let finite = |m: DMat3| m.to_cols_array().iter().all(|x| x.is_finite());
    if is_positive(g, s) {
        return Ok(());
    }
    let what = match (finite(g), manifold.ambient) {
        (false, _) => "the metric is not finite",
        (true, None) => "the metric is not positive definite",
        (true, Some(_)) => "the embedding flattens space, its metric is not positive definite",
    };
    let entries = [
        g.x_axis.x, g.y_axis.y, g.z_axis.z, g.y_axis.x, g.z_axis.x, g.z_axis.y,
    ];
    let [x, y, z] = &manifold.coordinates;
    let message = format!("{what} at {}", point(manifold, u));
    Err(complain(
        manifold,
        &["metric", "[metric]", "embedding", "[spacetime]"],
        message,
    )
    .with_label(format!(
        "{x}{x}, {y}{y}, {z}{z}, {x}{y}, {x}{z}, {y}{z} = {entries:.3?} there"
    ))
    .with_hint("restrict the region with [domain] or [cameras], or mend the expressions")
    .into())
}

/// Metric, wind, drift and lapse must be the same at both limits of a glued coordinate. Their slopes need not be: that
/// is a kink like any other.
fn check_glued(manifold: &Manifold, u: DVec3) -> Result<()> {
    for k in 0..3 {
        let (Some(period), Some([low, _])) = (manifold.domain.period(k), manifold.domain.limits[k])
        else {
            continue;
        };
        // Just inside either limit, as expressions see it.
        let at = |part: f64| {
            let mut near = u;
            near[k] = low + period * part;
            near
        };
        let (first, last) = (at(SEAM), at(1.0 - SEAM));
        let same = (last, DMat3::IDENTITY);
        let differing = [
            (
                "metric",
                "lengths",
                manifold.metric_discrepancy_by(same, first),
            ),
            (
                "wind or drift",
                "velocities",
                manifold.wind_discrepancy_by(same, first),
            ),
            ("drift", "clocks", manifold.drift_discrepancy(last, first)),
            ("lapse", "clocks", manifold.lapse_discrepancy(last, first)),
        ];
        if let Some((what, of, found)) = differing.into_iter().find(|(.., off)| *off > WORST_SEAM) {
            let name = &manifold.coordinates[k];
            let message = format!(
                "the {what} is not the same at both glued limits of `{name}`: at {} and {} {of} differ by {found:.2e}",
                point(manifold, first),
                point(manifold, last),
            );
            return Err(complain(manifold, &["periodic", "[domain]"], message)
                .with_label("glued here")
                .with_hint("choose limits that are a period of the expressions")
                .into());
        }
    }
    Ok(())
}

/// Left translation by p = 0 must leave everything, and bring u = 0 to p.
fn check_identity(manifold: &Manifold, u: DVec3) -> Result<()> {
    let Some(law) = &manifold.symmetry.group else {
        return Ok(());
    };
    let by = |p: DVec3, u: DVec3| Isometry::left(p, law.clone()).apply(u).0;
    let (same, moved) = (by(DVec3::ZERO, u), by(u, DVec3::ZERO));
    let is_off = |image: DVec3| {
        let off = (image - u).length();
        !(off <= WORST_DISCREPANCY * (1.0 + u.length()))
    };
    let there = point(manifold, u);
    let message = match (is_off(same), is_off(moved)) {
        (false, false) => return Ok(()),
        (true, _) => format!("p = 0 brings {there} to {}", point(manifold, same)),
        (false, true) => format!("p = ({there}) brings 0 to {}", point(manifold, moved)),
    };
    let message = format!("the identity of this group is not 0: {message}");
    Err(complain(manifold, &["group", "[symmetry]"], message)
        .with_label("claimed here")
        .with_hint("p = 0 must leave every point, and x = y = z = 0 must go to p")
        .into())
}

/// Refuses the first of these claims under which something differs by more than `worst`.
fn check_symmetry(manifold: &Manifold, claims: Vec<TriedClaim>, worst: f64) -> Result<()> {
    for (key, isometry, u) in claims {
        let complaint = |of: &str, what: &str, found: f64| {
            let (image, _) = isometry.apply(u);
            let message = format!(
                "this symmetry is not one of the {of}: at {} and its image {} {what} differ by {found:.2e}",
                point(manifold, u),
                point(manifold, image),
            );
            Error::from(
                complain(manifold, &[key, "[symmetry]"], message)
                    .with_label("claimed here")
                    .with_hint(format!("remove the claim, or mend the {of}")),
            )
        };
        let found = manifold.metric_discrepancy(&isometry, u);
        if found > worst {
            return Err(complaint("metric", "lengths", found));
        }
        if manifold.has_wind() {
            let found = manifold.wind_discrepancy(&isometry, u);
            if found > worst {
                let of = ["wind", "wind or drift"][usize::from(manifold.has_drift())];
                return Err(complaint(of, "velocities", found));
            }
        }
    }
    Ok(())
}

/// A symmetry to try, with its claim's key and a point.
type TriedClaim = (&'static str, Isometry, DVec3);

/// Returns symmetries to try, each at a point whose image is in the domain.
fn claimed(manifold: &Manifold, points: &[DVec3]) -> Vec<TriedClaim> {
    let mut claims = Vec::new();
    let all = || points.iter().copied();
    let (low, high) = (all().reduce(DVec3::min), all().reduce(DVec3::max));
    let spread = low
        .zip(high)
        .map_or(1.0, |(low, high)| (high - low).length());
    for (i, &u) in points.iter().enumerate() {
        // No sequence that could go in step with the points, which may lie along paths.
        let mut random = Stream::new(&[i as u64]);
        let t = [(); 3].map(|()| random.uniform());
        if manifold.symmetry.rotation {
            let q = random.rotation();
            claims.push(("rotation", Isometry::rotation(DMat3::from_quat(q)), u));
        }
        if let Some(axis) = manifold.symmetry.axis {
            let q = DQuat::from_axis_angle(DVec3::AXES[axis], TAU * t[0]);
            claims.push(("rotation", Isometry::rotation(DMat3::from_quat(q)), u));
        }
        for k in 0..3 {
            if manifold.symmetry.translation[k] {
                let shift = |[low, high]: [f64; 2]| {
                    let mut shift = DVec3::ZERO;
                    shift[k] = low + (high - low) * t[k] - u[k];
                    ("translation", Isometry::shift(shift), u)
                };
                let limits = manifold.domain.limits[k];
                claims.push(shift(limits.unwrap_or([u[k] - 2.0, u[k] + 3.0])));
                // Of a space that is much larger, or smaller, as far as its cameras go.
                let farther = shift([u[k] - 2.0 * spread, u[k] + 3.0 * spread]);
                let is_seen = |u| manifold.domain.exit_beyond(u).is_none();
                if limits.is_none() && is_seen(farther.1.apply(u).0) {
                    claims.push(farther);
                }
            }
        }
        if let Some(law) = &manifold.symmetry.group {
            let p = points[(i + points.len() / 2) % points.len()];
            claims.push(("group", Isometry::left(p, law.clone()), u));
        }
    }
    claims.retain(|(_, isometry, u)| {
        let image = isometry.apply(*u).0;
        image.is_finite() && manifold.domain.violation(image).is_none()
    });
    claims
}
