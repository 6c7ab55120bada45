//! Table against exact: errors in mrad; how well a table keeps its promises, and the rays that it gets far more wrong.
//!
//! The error of a point is its transverse distance, in the metric at the exact point, over the arc
//! length; its screen error is what it looks like from the camera, `|δ|` with `J δ = e`. The sky error
//! of a tangent is its angle from the exact one, or, where neighbouring tangents part faster than in
//! flat space, what that looks like from the camera: how far a star seen along it is off.
//!
//! In: rays and arc lengths. Out: [`Probe`]s (what is exactly there) and the [`Deviation`] of any
//! other answer from them.
//!
//! In: comparisons of a table with exact paths on fresh random rays. Out: a [`Certificate`], the quantiles
//! of the errors as published (a quantile of a sample is not a bound: it comes with the number of rays), and
//! [`Outlier`]s: a ray, its errors, and the box of the table that answered.
//!
//! What is promised of tangents ([`TangentPromise`]) is the 99th percentile of their sky error, in mrad. In a
//! plan's bytes its first byte is that of the plain flag
//! (0 or 1) that a plan without a promise of its own has; a promise of its own follows a 2.

use crate::{
    LookupError, Table,
    rays::{Located, Place, RaySpace},
    tree::{Tree, divided_at_edge, half},
};
use geofan_core::{
    geodesic::{End, JacobiField, Ray, Settings, Step, UnfinishedPaths, paths},
    manifold::{Carried, Manifold, PathNeighbours},
    quantiles::Quantiles,
};
use glam::{DMat3, DQuat, DVec3};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, SeqAccess, Visitor},
};
use std::{f64::consts::PI, fmt, num::NonZeroU32};

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

    /// Computes the magnification: how far neighbouring rays part, as a share of what they do in flat space, in the
    /// direction in which they part least. It is the smaller singular value of `J/s`.
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
    let mut probed: Vec<Probed> = paths
        .iter()
        .map(|path| Probed {
            end: path.end,
            length: path.length,
            probes: Vec::new(),
            edges: path.edges().collect(),
            exits_exist: manifold.domain.ends_rays(),
        })
        .collect();
    // The states of all at once: a tape takes little longer for sixteen points than for one.
    let places = paths.iter().enumerate().flat_map(|(i, path)| {
        let lengths = lengths(i, path.length).into_iter();
        lengths.filter_map(move |s| {
            let step = path.step_at(s)?;
            Some((i, (step, s, neighbours(step, s)?)))
        })
    });
    let (owners, places): (Vec<usize>, Vec<_>) = places.unzip();
    for (i, probe) in owners.into_iter().zip(states(manifold, &places)) {
        probed[i].probes.push(probe);
    }
    probed
}

/// Returns what a step carries of the paths beside it at arc length `s`; `None` if it does not carry the deviation.
fn neighbours(step: &Step, s: f64) -> Option<PathNeighbours> {
    let ([a, b], rates) = (step.deviation(s)?, step.deviation_rate(s)?);
    Some(PathNeighbours {
        u: step.position(s),
        v: step.tangent(s),
        neighbours: [(a, rates[0]), (b, rates[1])],
    })
}

/// Computes the exact states at arc lengths on steps, with what these carry there.
fn states(manifold: &Manifold, places: &[(&Step, f64, PathNeighbours)]) -> Vec<Probe> {
    let near: Vec<PathNeighbours> = places.iter().map(|(_, _, near)| *near).collect();
    let points: Vec<DVec3> = near.iter().map(|near| near.u).collect();
    let frames = manifold.local_frames(&points);
    let changes = manifold.sight_changes(&near, &frames);
    let mut probes = Vec::with_capacity(places.len());
    for (((step, s, near), local), changes) in places.iter().zip(&frames).zip(changes) {
        let frame_inverse = local.frame.inverse();
        let deviation = near.neighbours.map(|(du, _)| du);
        probes.push(Probe {
            s: *s,
            u: near.u,
            v: near.v,
            frame_inverse,
            spread: JacobiField::seen_by(local, near.v, deviation),
            turning: JacobiField::new(frame_inverse, local.sight(near.v), changes),
            rotation: step.rotation(*s),
        });
    }
    probes
}

/// Says what a table promises of tangents, and with them of transported frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TangentPromise {
    /// Nothing.
    None,
    /// As much as of points.
    AsPoints,
    /// Its own 99th percentile of the sky error, mrad.
    Own(f64),
}

impl TangentPromise {
    /// Returns the promise in mrad where `points` is that of points.
    pub fn mrad(self, points: f64) -> Option<f64> {
        match self {
            Self::None => None,
            Self::AsPoints => Some(points),
            Self::Own(own) => Some(own),
        }
    }
}

impl Serialize for TangentPromise {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::None => 0_u8.serialize(serializer),
            Self::AsPoints => 1_u8.serialize(serializer),
            Self::Own(own) => (2_u8, own).serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for TangentPromise {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(2, TangentPromiseVisitor)
    }
}

/// Reads the byte, and the number behind a 2.
struct TangentPromiseVisitor;

impl<'de> Visitor<'de> for TangentPromiseVisitor {
    type Value = TangentPromise;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("0, 1, or 2 and a number")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<TangentPromise, A::Error> {
        let missing = |place| A::Error::invalid_length(place, &self);
        match seq.next_element::<u8>()?.ok_or_else(|| missing(0))? {
            0 => Ok(TangentPromise::None),
            1 => Ok(TangentPromise::AsPoints),
            2 => {
                let own = seq.next_element()?.ok_or_else(|| missing(1))?;
                Ok(TangentPromise::Own(own))
            }
            other => Err(A::Error::custom(format!(
                "{other} is no promise of tangents"
            ))),
        }
    }
}

/// The result of a comparison of a table with exact paths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Transverse distance over arc length.
    pub mrad: Quantiles,
    /// This distance divided by the ray's magnification.
    pub screen_mrad: Quantiles,
    /// Sky error of the tangent at the exit, or, in a manifold where nothing ends rays, where the other
    /// errors are; none if the table does not promise it.
    pub sky_mrad: Option<Quantiles>,
    /// Angle between the transported rotations; none if the table does not promise them.
    pub rotation_mrad: Option<Quantiles>,
    /// The fraction of rays of which the table gives up a part.
    pub flagged: f64,
    /// The number of rays.
    pub rays: u64,
    /// Their seed.
    pub seed: u64,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// Rays that the bake integrated; 0 in a check.
    pub exact_rays_baked: u64,
}

impl Certificate {
    /// Tells whether the table is as good as promised: 99 % of the screen errors within `promise` mrad.
    pub fn keeps(&self, promise: f64) -> bool {
        self.screen_mrad.p99 <= promise
    }

    /// Tells whether all numbers are such as a comparison finds: errors from zero up, in order (infinite where one
    /// could not be computed), a share, a tolerance.
    pub(crate) fn is_valid(&self) -> bool {
        let ordered = |q: &Quantiles| {
            let all = [0.0, q.p50, q.p95, q.p99, q.max];
            all.is_sorted() && all.iter().all(|x| !x.is_nan())
        };
        let some = [Some(self.mrad), Some(self.screen_mrad)];
        let others = [self.sky_mrad, self.rotation_mrad];
        let errors = some.iter().chain(&others).flatten().all(ordered);
        let tolerance = self.tolerance > 0.0 && self.tolerance.is_finite();
        errors && (0.0..=1.0).contains(&self.flagged) && tolerance
    }

    /// Writes the errors as lines of a table for people.
    pub fn lines(&self) -> String {
        let mut text = format!(
            "{:<10} {:>10} {:>10} {:>10} {:>10}\n",
            "mrad", "p50", "p95", "p99", "max"
        );
        let rows = [
            ("screen", Some(self.screen_mrad)),
            ("position", Some(self.mrad)),
            ("sky", self.sky_mrad),
            ("rotation", self.rotation_mrad),
        ];
        for (name, q) in rows {
            let Some(q) = q else { continue };
            let cells = [q.p50, q.p95, q.p99, q.max].map(|x| format!("{x:>10.4}"));
            text += &format!("{name:<10} {}\n", cells.join(" "));
        }
        let (flagged, rays) = (100.0 * self.flagged, self.rays);
        text + &format!("flagged    {flagged:.3} % of {rays} rays (integrated exactly)\n")
    }
}

/// A certificate, the rays that quantiles cannot tell of, and how paths end.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// The certificate.
    pub certificate: Certificate,
    /// The number of rays whose error is more than [`FAR`] times the promise.
    pub far: usize,
    /// The worst of them, worst first.
    pub worst: Vec<Outlier>,
    /// The exact paths of all rays that ended by their length or where the metric ends.
    pub unfinished: UnfinishedPaths,
}

/// Error in mrad where a table shows no direction at all: as wrong as one can be.
pub const NOTHING_SEEN: f64 = 1e3 * PI;

/// Factor by which an error must exceed the promise to be told apart.
pub const FAR: f64 = 20.0;

/// The most outliers listed: the worst.
pub const MOST: usize = 20;

/// A box of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BoxPlace {
    /// The chunk.
    pub chunk: usize,
    /// Its face of directions; `None` if it has all of them.
    pub face: Option<usize>,
    /// Its intervals within the chunk, which is [−1, 1] along camera…, direction…, arc length.
    pub intervals: Vec<[f64; 2]>,
    /// The table gives it up.
    pub flagged: bool,
}

/// A ray that the table gets far more wrong than it promises.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outlier {
    /// Chart point of the camera.
    pub at: [f64; 3],
    /// Direction in the standard frame.
    pub dir: [f64; 3],
    /// Arc length of the comparison.
    pub s: f64,
    /// Length of the exact path.
    pub length: f64,
    /// Screen error, mrad.
    pub screen_mrad: f64,
    /// Position error, mrad.
    pub mrad: f64,
    /// Distance of a neighbouring ray relative to flat space, in the direction where it is smaller.
    pub magnification: f64,
    /// The box that answered.
    pub patch: BoxPlace,
}

impl Outlier {
    /// Says in words what sets the ray apart.
    pub fn why(&self) -> String {
        let size = |[a, b]: &[f64; 2]| 0.5 * (b - a);
        let smallest = self.patch.intervals.iter().map(size).fold(1.0, f64::min);
        let magnified = self.mrad / self.screen_mrad.max(f64::MIN_POSITIVE);
        if magnified > FAR {
            format!("paths part by {magnified:.0} times here")
        } else if self.magnification < 0.3 {
            "near a conjugate point, where position hardly depends on direction".into()
        } else if smallest < 0.05 {
            "in a small box, beside a place that no polynomial resolves".into()
        } else {
            "a narrow failure that the held-out rays of the box did not meet".into()
        }
    }
}

impl Table {
    /// Finds the box that answers for the ray `located` from `place` at arc length `s`.
    ///
    /// # Errors
    /// The chunk is damaged.
    pub fn box_at(
        &self,
        place: &Place,
        located: &Located,
        s: f64,
    ) -> Result<BoxPlace, LookupError> {
        // The ray in the parameters of its chunk.
        let stored = self.stored_face(place, located.face);
        let (chunk, mut point) = (stored.chunk, stored.camera);
        let carried = located.clone().carried(stored.image.as_ref());
        point.extend(&carried.direction[..self.space.directions()]);
        point.push(2.0 * s / self.length - 1.0);
        // Down the tree, with the box that is left; arc lengths may be divided anywhere.
        let arc = point.len() - 1;
        let mut lengths = [0.0, self.length];
        let mut intervals = vec![[-1.0, 1.0]; point.len()];
        let mut tree = self.tree(chunk)?;
        let mut face = (self.division.blocks == self.space.faces()).then_some(carried.face);
        loop {
            match tree {
                Tree::Split { axis, halves } if *axis == arc => {
                    let middle = 0.5 * (lengths[0] + lengths[1]);
                    let side = usize::from(s >= middle);
                    lengths[1 - side] = middle;
                    tree = &halves[side];
                }
                Tree::Edge { place, parts } => {
                    let at = place.at_many(&[&point[..arc]])[0][0];
                    let divided = divided_at_edge(lengths, at);
                    let side = usize::from(s >= divided[1][0]);
                    lengths = divided[side];
                    tree = &parts[side];
                }
                Tree::Split { axis, halves } => {
                    let (side, inner) = half(point[*axis]);
                    point[*axis] = inner;
                    let [a, b] = intervals[*axis];
                    intervals[*axis][1 - side] = 0.5 * (a + b);
                    tree = &halves[side];
                }
                // The interval of rays beside this one.
                Tree::Separatrix {
                    place,
                    reach,
                    sides,
                } => {
                    let at = place.at_many(&[&point[..arc]])[0][0];
                    let side = reach.enter(&mut point, at);
                    let [a, b] = intervals[reach.axis];
                    let outer = |end: f64| reach.outer((side, end), at);
                    intervals[reach.axis] =
                        [-1.0, 1.0].map(|end| 0.5 * (a + b + (b - a) * outer(end)));
                    tree = &sides[side];
                }
                Tree::Faces(faces) => {
                    face = Some(carried.face);
                    tree = &faces[carried.face];
                }
                Tree::Section(section) => {
                    let inner = section.tree();
                    tree = inner.map_err(|damage| LookupError::Damaged { chunk, damage })?;
                }
                Tree::Leaf(_) | Tree::Flagged => break,
            }
        }
        intervals[arc] = lengths.map(|s| 2.0 * s / self.length - 1.0);
        Ok(BoxPlace {
            chunk,
            face,
            intervals,
            flagged: matches!(tree, Tree::Flagged),
        })
    }

    /// Describes the outlier of a comparison.
    ///
    /// # Errors
    /// The chunk is damaged.
    pub fn outlier(
        &self,
        place: &Place,
        d: DVec3,
        (s, length): (f64, f64),
        found: Deviation,
        magnification: f64,
    ) -> Result<Outlier, LookupError> {
        let located = self.space.locate(place, d);
        Ok(Outlier {
            at: place.u.to_array(),
            dir: d.to_array(),
            s,
            length,
            screen_mrad: found.screen_mrad,
            mrad: found.mrad,
            magnification,
            patch: self.box_at(place, &located, s)?,
        })
    }
}
