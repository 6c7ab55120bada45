//! Points of a glued domain, spread over all of it.
//!
//! In: the faces of a manifold file as read, and its chart. Out: points inside, on which sizes, forms and the numerical
//! checks of faces rest ([`points_inside`]); or a complaint that there are none.

use super::{Gluing, gluing_checks::complain};
use crate::{
    diagnostic::Diagnostic,
    error::Result,
    manifold::{
        Manifold,
        probe::{halton, is_positive, point},
    },
    random::Stream,
};
use glam::DVec3;

/// Points of the domain that are looked at, and the fewest that tell anything.
const POINTS: usize = 48;
const FEWEST_POINTS: usize = 8;

/// Sizes of boxes from which points are brought in.
const SIZES: [f64; 6] = [1.0, 0.3, 0.1, 3.0, 0.03, 10.0];

/// Lines along which it is looked how far faces are, and doublings of a length until one must be met.
const SIGHT_LINES: usize = 64;
const DOUBLINGS: i32 = 40;

/// Share of the distance of faces within which points are too close together to stand for the domain.
const CLOSE: f64 = 0.25;

/// Places on the line between two points that must lie inside.
const SIGHTS: u32 = 24;

/// Returns whether the space is regular at `u`.
pub(super) fn is_regular(manifold: &Manifold, u: DVec3) -> bool {
    let (g, s) = manifold.metric_and_frame(u);
    u.is_finite() && is_positive(g, s) && manifold.domain.violation(u).is_none()
}

/// Finds points inside the domain: a camera or the middle of the chart, and points of boxes of several sizes,
/// brought in: about the origin, and where these are too few, about the first point, as large as faces are far. Where
/// faces are much farther than points about the origin, about the first point too, over all of the domain.
pub(super) fn points_inside(manifold: &Manifold, gluing: &mut Gluing) -> Result<Vec<DVec3>> {
    let first = first_point(manifold, gluing);
    // One slope for all until each is measured: in small units values are small, and rounding must be smaller.
    let steepest = first
        .map(|u| gluing.steepest(u))
        .filter(|slope| slope.is_normal());
    if let Some(slope) = steepest {
        gluing.faces.iter_mut().for_each(|face| face.slope = slope);
    }
    let mut lost = None;
    let distance = first.and_then(|u| gluing.distance(u));
    // Of what is small, less is rounding.
    gluing.size = distance.map_or(gluing.size, |distance| gluing.size.min(distance));
    let about = |scale: f64| first.map(|u| (u, SIZES.map(|size| size * scale)));
    let boxes = [
        Some((DVec3::ZERO, SIZES)),
        distance.and_then(about),
        first.and_then(|u| about(gluing.least_distance(u))),
    ];
    let mut most = Vec::new();
    for boxes in boxes.into_iter().flatten() {
        let points = points_of_boxes(manifold, gluing, (first, &mut lost), boxes);
        let spread = first.map_or(0.0, |u| farthest(u, &points));
        if points.len() >= POINTS / 2 && distance.is_none_or(|distance| spread > CLOSE * distance) {
            return Ok(points);
        }
        if points.len() > most.len() {
            most = points;
        }
    }
    match most.len() >= FEWEST_POINTS {
        true => Ok(most),
        false => Err(no_points(manifold, gluing, lost).into()),
    }
}

/// Returns how far the farthest of the points is from `u`.
fn farthest(u: DVec3, points: &[DVec3]) -> f64 {
    points.iter().map(|p| (*p - u).length()).fold(0.0, f64::max)
}

/// Brings in points of boxes about a middle, until there are enough. A chart may hold the space twice, so only those count
/// that see the first one along a line of the chart.
fn points_of_boxes(
    manifold: &Manifold,
    gluing: &Gluing,
    (first, lost): (Option<DVec3>, &mut Option<(usize, DVec3)>),
    (middle, sizes): (DVec3, [f64; SIZES.len()]),
) -> Vec<DVec3> {
    let mut points: Vec<DVec3> = first.into_iter().collect();
    for size in sizes {
        for u in regular_points(manifold, (middle, size)) {
            match gluing.locate(u) {
                Some((u, _)) => {
                    let sees_first = |first: &DVec3| gluing.holds_between(*first, u);
                    if is_regular(manifold, u) && points.first().is_none_or(sees_first) {
                        points.push(u);
                    }
                }
                None => *lost = lost.or(gluing.violated(u).map(|k| (k, u))),
            }
        }
        if points.len() >= POINTS / 2 {
            break;
        }
    }
    points
}

/// Brings in a camera, or else the middle of the chart.
fn first_point(manifold: &Manifold, gluing: &Gluing) -> Option<DVec3> {
    let cameras = manifold.cameras.as_ref();
    let camera = cameras.map(|region| region.at(&region.lerp(&[0.5; 3])));
    let limits = manifold.domain.limits;
    let middle = limits.map(|l| l.map_or(0.0, |[low, high]| 0.5 * (low + high)));
    [camera, Some(DVec3::from_array(middle))]
        .into_iter()
        .flatten()
        .filter(|u| is_regular(manifold, *u))
        .find_map(|u| gluing.locate(u))
        .map(|(u, _)| u)
}

/// Lists regular points spread over the chart's limits, or as far as `size` from the middle where it has none.
fn regular_points(
    manifold: &Manifold,
    (middle, size): (DVec3, f64),
) -> impl Iterator<Item = DVec3> {
    let around = |k: usize| [middle[k] - size, middle[k] + size];
    let limits = [0, 1, 2].map(|k| manifold.domain.limits[k].unwrap_or(around(k)));
    let at = move |i| {
        let t = halton(i);
        DVec3::from_array([0, 1, 2].map(|k| limits[k][0] + (limits[k][1] - limits[k][0]) * t[k]))
    };
    (0..POINTS)
        .map(at)
        .filter(move |u| is_regular(manifold, *u))
}

/// Says why too few points were found: `lost` is one that is not brought in, with the face that it is beyond.
fn no_points(manifold: &Manifold, gluing: &Gluing, lost: Option<(usize, DVec3)>) -> Diagnostic {
    match lost {
        Some((k, u)) if !gluing.faces[k].is_mirror() => {
            let message = format!(
                "points beyond it are not brought back into the domain: {}",
                point(manifold, u)
            );
            complain(manifold, gluing, k, message)
                .with_label("its map is applied where this is negative")
                .with_hint("a map must lead from beyond its face back inside")
        }
        _ => {
            let message = "no points were found where all faces are positive".to_string();
            complain(manifold, gluing, 0, message).with_hint(
                "faces must be positive inside the domain; it should surround the origin of the chart, or lie in the limits of [domain]",
            )
        }
    }
}

impl Gluing {
    /// Measures how far bounding faces are from `u` along lines of the chart in all directions, up to a factor of two: the
    /// distance that half of those that meet one stay below. `None` where hardly any does.
    fn distance(&self, u: DVec3) -> Option<f64> {
        let least = self.least_distance(u);
        let mut random = Stream::new(&[0x0065_7874_656e_7400]);
        let mut distances: Vec<f64> = (0..SIGHT_LINES)
            .map(|_| random.direction())
            .filter_map(|d| {
                let mut lengths = (0..DOUBLINGS).map(|i| least * 2.0_f64.powi(i));
                lengths.find(|length| self.violated(u + d * *length).is_some())
            })
            .collect();
        distances.sort_by(f64::total_cmp);
        let enough = distances.len() >= SIGHT_LINES / 8;
        enough.then(|| distances[distances.len() / 2])
    }

    /// Estimates how far the nearest bounding face is from `u`, by its value and its gradient.
    fn least_distance(&self, u: DVec3) -> f64 {
        let values = self.values.at(&u.to_array());
        let bounding = (0..self.faces.len()).filter(|k| !self.faces[*k].is_portal());
        let distances = bounding.map(|k| values[k].abs() / self.gradient(k, u).length());
        distances.filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min)
    }

    /// Returns the length of the longest gradient of a bounding face at `u`.
    fn steepest(&self, u: DVec3) -> f64 {
        let bounding = (0..self.faces.len()).filter(|k| !self.faces[*k].is_portal());
        bounding
            .map(|k| self.gradient(k, u).length())
            .fold(0.0, f64::max)
    }

    /// Returns whether the chart's line between two points stays inside all bounding faces.
    fn holds_between(&self, a: DVec3, b: DVec3) -> bool {
        let inside = |t: f64| {
            let values = self.values.at(&a.lerp(b, t).to_array());
            let faces = self.faces.iter().zip(values);
            faces
                .filter(|(face, _)| !face.is_portal())
                .all(|(_, value)| value > 0.0)
        };
        (1..SIGHTS).all(|i| inside(f64::from(i) / f64::from(SIGHTS)))
    }
}
