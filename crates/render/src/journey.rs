//! A camera that lives in the space: it moves along geodesics, takes its axes with it, and journeys through key poses.
//!
//! In: a camera (chart point `u`, rotation `R`), and a move or a turn in its own axes. Out: the
//! camera afterwards. Its axes in the chart are the columns of `S(u) R`: x to the right, y up, z
//! backwards, so that it looks along −z. Moves are lengths in the metric.
//!
//! `R` obeys `Ṙ = −Ω R` and is a unit quaternion, so it never stops being a rotation. A closed way
//! brings the camera back turned by the holonomy of the loop.
//!
//! In: a [`PoseFile`] and its manifold. Out: a [`Journey`], the [`Camera`] at any time. Neighbouring
//! poses are joined by a geodesic, all at once or as time goes by; the camera is carried along it by
//! parallel transport, and what is then missing to the next pose is turned evenly on the way. Speed (arc length plus
//! angle turned) is a monotone cubic of time through all poses (F. N. Fritsch and R. E. Carlson, *Monotone
//! piecewise cubic interpolation*, 1980), at rest at both ends.

use super::{
    camera_place::{camera_velocity, given_point},
    scene::{CameraMotion, KeyPose, PoseFile},
};
use geofan_bundle::Table;
use geofan_core::{
    diagnostic::Diagnostic,
    error::Result,
    geodesic::{End, Path, Ray, Settings, Sink, Step, ends, follow, paths, perpendiculars},
    manifold::{DeckTransformation, Manifold},
};
use glam::{DMat3, DQuat, DVec3};

/// Where a camera is and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Chart point.
    pub u: DVec3,
    /// Its axes in the standard frame, as a unit quaternion.
    pub rotation: DQuat,
}

/// A camera after a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The camera where it is now.
    pub camera: Camera,
    /// Arc length that it came: less than asked for if the space ended, or right and left would change places.
    pub length: f64,
}

/// Local tolerance of the geodesics along which a camera moves. Errors of single moves add up: at
/// this one, 100,000 of them stay below 1e-7 of the way; a coarser one saves nothing that can be
/// noticed beside drawing a picture.
const MOVE_TOLERANCE: f64 = 1e-12;

/// The ray of a move is longer than the move by this factor and given up when the move is done: the
/// integrator's steps are limited to a share (1/16) of the ray, and a small move should be one step.
const ROOM: f64 = 32.0;

/// Keeps the step on which the wanted length is reached, or the last before right and left change places.
struct Way {
    wanted: f64,
    last: Option<Step>,
    reversed: bool,
}

impl Sink for Way {
    fn step(&mut self, _: usize, step: &Step) {
        match step.reversed {
            true => self.reversed = true,
            false => self.last = Some(step.clone()),
        }
    }

    fn wants_more(&self, _: usize) -> bool {
        !self.reversed && self.last.as_ref().is_none_or(|step| step.end < self.wanted)
    }

    fn end(&mut self, _: usize, _: End, _: f64, _: usize) {}
}

impl Camera {
    /// A camera at `u` that looks along `look` with `up` upwards: unit and perpendicular, or at
    /// least not parallel, in the standard frame.
    pub fn looking(u: DVec3, look: DVec3, up: DVec3) -> Self {
        let back = -look.normalize();
        let right = up.cross(back).normalize();
        let axes = DMat3::from_cols(right, back.cross(right), back);
        Self {
            u,
            rotation: DQuat::from_mat3(&axes).normalize(),
        }
    }

    /// Its axes in the chart: the columns of `S(u) R`.
    pub fn axes(&self, manifold: &Manifold) -> DMat3 {
        manifold.standard_frame(self.u) * DMat3::from_quat(self.rotation)
    }

    /// The camera turned by `turn`, which is given in its own axes.
    #[must_use]
    pub fn turned(&self, turn: DQuat) -> Self {
        Self {
            u: self.u,
            rotation: (self.rotation * turn).normalize(),
        }
    }

    /// The camera moved by `by` (in its own axes, length in the metric): along the geodesic in that
    /// direction, its axes transported in parallel, also through portals. It stops where the geodesic leaves the
    /// domain, meets an exit or a mirror; glued coordinates are brought back between their limits.
    pub fn moved(&self, manifold: &Manifold, by: DVec3) -> Moved {
        let stay = Moved {
            camera: *self,
            length: 0.0,
        };
        let Some(direction) = (self.rotation * by).try_normalize() else {
            return stay;
        };
        let settings = Settings::bare(MOVE_TOLERANCE).with_frame().with_events();
        let wanted = by.length();
        // A wind blows light, and no camera.
        let developed = manifold.developed();
        let still = developed.still();
        let ray = Ray::new(&still, self.u, direction, ROOM * wanted);
        let mut way = Way {
            wanted,
            last: None,
            reversed: false,
        };
        follow(&still, settings, [ray], &mut way);
        let Some(step) = way.last else { return stay };
        let length = wanted.min(step.end);
        let turn = step.rotation(length).unwrap_or(DQuat::IDENTITY);
        let camera = Self {
            u: manifold.domain.wrap(step.position(length)),
            rotation: (turn * self.rotation).normalize(),
        };
        Moved {
            camera: camera.brought_in(manifold),
            length,
        }
    }

    /// Brings the camera into the domain of a glued space, turned by the maps of the faces between. A camera cannot
    /// be mirrored: where an odd number of faces turns right into left, it stays before the last of these.
    #[must_use]
    pub fn brought_in(&self, manifold: &Manifold) -> Self {
        let Some(gluing) = manifold.gluing() else {
            return *self;
        };
        let word = gluing.locate(self.u).map_or(Vec::new(), |(_, word)| word);
        let proper = |n: &usize| !gluing.reverses(&word[..*n]);
        let word = &word[..(0..=word.len()).rev().find(proper).unwrap_or(0)];
        if word.is_empty() {
            return *self;
        }
        let axes = gluing.carried(word, self.u, self.axes(manifold));
        let carry = |u: DVec3, k: &usize| gluing.faces()[*k].carry(u).map_or(u, |(u, _)| u);
        let u = word.iter().fold(self.u, carry);
        let own = manifold.standard_frame(u).inverse() * axes;
        Self {
            u,
            rotation: DQuat::from_mat3(&own).normalize(),
        }
    }

    /// Returns the camera as a deck transformation carries it, turned by its differential.
    #[must_use]
    pub fn carried_by(&self, manifold: &Manifold, deck: &DeckTransformation) -> Self {
        let (u, d) = deck.apply(self.u);
        let own = manifold.standard_frame(u).inverse() * (d * self.axes(manifold));
        Self {
            u,
            rotation: DQuat::from_mat3(&own).normalize(),
        }
    }

    /// Moves it by table: point and transported rotation are read from the path that starts at the
    /// camera, as exact as the table's certificate says, and nothing is integrated but the turning
    /// along that path. Where the table gives up before the end of the move, does not promise
    /// tangents, has paths of light in a wind, or knows nothing of portals and mirrors, it is [`Camera::moved`].
    ///
    /// # Errors
    /// The camera is not in the table's region, or the table is damaged there.
    pub fn moved_by(&self, table: &Table, by: DVec3) -> Result<Moved> {
        let glued = table.space.manifold().glued();
        let manifold = &*glued;
        if manifold.has_wind() || !manifold.follows_cover() {
            return Ok(self.moved(manifold, by));
        }
        let fan = table.fan(self.u)?;
        let Some(direction) = (self.rotation * by).try_normalize() else {
            return Ok(self.moved(manifold, by));
        };
        let path = fan.path(direction);
        let wanted = by.length();
        let event = path.first_event(wanted.min(table.length));
        let length = event.map_or(wanted, |(_, s)| s);
        let turn = path.rotation(length).filter(|_| length <= table.length);
        let Some((turn, (u, _))) = turn.zip(path.at(length)) else {
            return Ok(self.moved(manifold, by));
        };
        let camera = Self {
            u: manifold.domain.wrap(u),
            rotation: (turn * self.rotation).normalize(),
        };
        Ok(Moved {
            camera: camera.brought_in(manifold),
            length,
        })
    }
}

/// Local tolerance of the geodesics: an animation shows no finer error.
const TOLERANCE: f64 = 1e-9;

/// Distance to the next pose at which the geodesic has reached it, as a share of the whole distance.
const CLOSE: f64 = 1e-7;

/// Distance of two places, as a share of that from the chart's origin, within which rounding along a geodesic hides
/// which of them it has reached: less is never come to, more would be seen as a stop of a slow camera.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Distance from the next pose at which a path through faces has reached it, as a share of the size of the domain: far
/// above the error of the path, far below what lies between two poses.
const ARRIVED: f64 = 1e-6;

/// Settings of the geodesics along which a camera is carried.
const WITH_FRAME: Settings = Settings::bare(TOLERANCE).with_frame();

/// Places on the way between two poses at which cameras are checked that are to be at rest.
const MOTION_CHECKS: usize = 256;

/// The geodesic between two poses, and the turn along it.
struct Leg {
    /// The geodesic; `None` if the camera stays where it is.
    path: Option<Path>,
    length: f64,
    u: DVec3,
    /// The rotation at its start, and the turn besides transport.
    from: DQuat,
    turn: DQuat,
    fov: [f64; 2],
    motion: [CameraMotion; 2],
}

/// The journey through all poses.
pub struct Journey {
    /// The space with its wind, past which cameras move.
    space: Manifold,
    /// The same without wind: the chart in which geodesics between poses are looked for, and the space in which they
    /// go on through portals.
    cover: Manifold,
    developed: Manifold,
    file: PoseFile,
    points: Vec<DVec3>,
    times: Vec<f64>,
    /// The ways from pose to pose, as far as they are joined.
    legs: Vec<Leg>,
    /// Arc length plus angle up to each pose.
    progress: Vec<f64>,
    /// Speeds there.
    speed: Vec<f64>,
}

impl Journey {
    /// Joins the poses of `file`.
    ///
    /// # Errors
    /// A pose outside the domain, two that no geodesic was found between, or a camera that is to be at rest
    /// where nothing can be.
    pub fn new(space: &Manifold, file: &PoseFile) -> Result<Self> {
        let mut journey = Self::begin(space, file)?;
        journey.reach(f64::INFINITY)?;
        Ok(journey)
    }

    /// Checks the places of all poses of `file` and joins the first of them; [`Journey::reach`] joins the others.
    ///
    /// # Errors
    /// As [`Journey::new`], of the poses that are joined.
    pub fn begin(space: &Manifold, file: &PoseFile) -> Result<Self> {
        // Past the faces of a glued domain on a straight way through the cover.
        let cover = space.cover().still().into_owned();
        let points = file
            .poses
            .iter()
            .map(|pose| given_point(&cover, &file.source, &pose.camera));
        let mut journey = Self {
            space: space.clone(),
            points: points.collect::<Result<_>>()?,
            cover,
            developed: space.developed().still().into_owned(),
            file: file.clone(),
            times: file.poses.iter().map(|pose| pose.time).collect(),
            legs: Vec::new(),
            progress: vec![0.0],
            speed: Vec::new(),
        };
        journey.reach(f64::NEG_INFINITY)?;
        Ok(journey)
    }

    /// Joins the poses that decide where the camera is up to `time`, seconds.
    ///
    /// # Errors
    /// As [`Journey::new`], of those poses.
    pub fn reach(&mut self, time: f64) -> Result<()> {
        // The speed at a pose depends on the ways to it and from it.
        let wanted = (self.leg_at(time) + 2).min(self.points.len() - 1);
        if self.legs.len() >= wanted {
            return Ok(());
        }
        while self.legs.len() < wanted {
            let leg = self.join(self.legs.len())?;
            self.progress
                .push(self.progress[self.legs.len()] + leg.measure());
            self.legs.push(leg);
        }
        self.speed = monotone_slopes(&self.times[..self.progress.len()], &self.progress);
        Ok(())
    }

    /// Joins pose `i` with the next.
    fn join(&self, i: usize) -> Result<Leg> {
        let (source, pair) = (&self.file.source, &self.file.poses[i..i + 2]);
        let way = self.way(self.points[i], self.points[i + 1]);
        let leg = way.map(|path| Leg::new(path, [&pair[0], &pair[1]], self.points[i]));
        let leg = leg.ok_or_else(|| {
            Diagnostic::new(
                source,
                pair[1].span.clone(),
                "no geodesic was found from the pose before to this one",
            )
            .with_hint(match self.developed.gluing() {
                None => "put another pose between them",
                Some(_) => "put other poses between them, so that no two have more than one face between them",
            })
        })?;
        for k in 0..=MOTION_CHECKS {
            let (u, _) = leg.carried(k as f64 / MOTION_CHECKS as f64);
            for pose in pair {
                camera_velocity(&self.space, source, &pose.camera, u)?;
            }
        }
        Ok(leg)
    }

    /// Finds the geodesic from `a` to `b`; where the cover does not tell how paths go on, the shortest that crosses one
    /// face or none. Returns it with its length; `Some(None)` if they are the same point but for
    /// rounding, `None` if none is found.
    fn way(&self, a: DVec3, b: DVec3) -> Option<Option<(Path, f64)>> {
        if (b - a).length() <= ROUNDING * a.length() {
            return Some(None);
        }
        let follow = |target: DVec3| {
            let ray = geodesic_between(&self.cover, a, target)?;
            let path = paths(&self.developed, WITH_FRAME, [ray]).pop()?;
            Some((path, ray.length))
        };
        let Some(gluing) = self.developed.gluing() else {
            return follow(b).map(Some);
        };
        // Straight on behind a face, `b` is where the map of the way back takes it: which that is, the arrival tells.
        let faces = gluing.faces().iter();
        let images = faces.filter_map(|face| Some(face.carry(b)?.0));
        let arrives = |(path, length): &(Path, f64)| {
            path.steps.last().is_some_and(|step| {
                let off = (step.position(*length) - b).length();
                !step.reversed && off <= ARRIVED * gluing.size()
            })
        };
        let found = [b].into_iter().chain(images).filter_map(follow);
        let shortest = found
            .filter(arrives)
            .min_by(|one, other| one.1.total_cmp(&other.1));
        shortest.map(Some)
    }

    /// Returns the first and the last time, seconds.
    pub fn interval(&self) -> [f64; 2] {
        [self.times[0], self.times[self.times.len() - 1]]
    }

    /// Returns the camera at `time`, which must have been reached, in the domain of a glued space, and its angle of view
    /// in degrees.
    pub fn pose(&self, time: f64) -> (Camera, f64) {
        let (camera, fov) = self.pose_in_cover(time);
        (camera.brought_in(&self.space), fov)
    }

    /// Returns the camera at `time` where the way through the space that covers a glued one has led it, and its angle
    /// of view in degrees.
    pub fn pose_in_cover(&self, time: f64) -> (Camera, f64) {
        let (leg, share) = self.place(time);
        leg.pose(share)
    }

    /// Returns the velocity of the camera past the normal observer at `time`, in the standard frame where
    /// [`Journey::pose`] is: between poses with different motions, evenly from the one to the other.
    pub fn velocity(&self, time: f64) -> DVec3 {
        let (leg, share) = self.place(time);
        let (u, _) = leg.carried(share);
        let [from, to] = leg.motion.map(|motion| motion.velocity(&self.space, u));
        let velocity = from.unwrap_or_default().lerp(to.unwrap_or_default(), share);
        // The same in the camera's axes.
        let [there, here] = [self.pose_in_cover(time), self.pose(time)].map(|(c, _)| c.rotation);
        match there == here {
            true => velocity,
            false => here * (there.inverse() * velocity),
        }
    }

    /// Finds the leg at `time`, and the share of its way.
    fn place(&self, time: f64) -> (&Leg, f64) {
        let k = self.leg_at(time).min(self.legs.len() - 1);
        let h = self.times[k + 1] - self.times[k];
        let t = ((time - self.times[k]) / h).clamp(0.0, 1.0);
        let r = 1.0 - t;
        let whole = self.progress[k + 1] - self.progress[k];
        let done = whole * t * t * (3.0 - 2.0 * t)
            + h * t * r * (r * self.speed[k] - t * self.speed[k + 1]);
        let share = if whole > 0.0 {
            (done / whole).clamp(0.0, 1.0)
        } else {
            t
        };
        (&self.legs[k], share)
    }

    /// Returns the number of the way that leads past `time`.
    fn leg_at(&self, time: f64) -> usize {
        let next = self.times.partition_point(|t| *t <= time);
        next.clamp(1, self.times.len() - 1) - 1
    }
}

impl Leg {
    /// Leads from the first of two poses, at `u`, along a path of some length to the second; without one it stays.
    fn new(path: Option<(Path, f64)>, poses: [&KeyPose; 2], u: DVec3) -> Self {
        let [from, to] = poses.map(rotation);
        let (path, length) = path.unzip();
        let mut leg = Self {
            path,
            length: length.unwrap_or(0.0),
            u,
            from,
            turn: DQuat::IDENTITY,
            fov: poses.map(|pose| pose.camera.fov_degrees),
            motion: poses.map(|pose| pose.camera.motion),
        };
        let (_, carried) = leg.carried(1.0);
        leg.turn = (carried.inverse() * to).normalize();
        if leg.turn.w < 0.0 {
            // The shorter way round.
            leg.turn = -leg.turn;
        }
        leg
    }

    /// Returns arc length plus angle turned.
    fn measure(&self) -> f64 {
        self.length + self.turn.angle_between(DQuat::IDENTITY)
    }

    /// Returns the chart point and the transported rotation at a share of the way.
    fn carried(&self, share: f64) -> (DVec3, DQuat) {
        let s = share * self.length;
        let step = self.path.as_ref().and_then(|path| path.step_at(s));
        match step {
            None => (self.u, self.from),
            Some(step) => {
                let turned = step.rotation(s).unwrap_or(DQuat::IDENTITY);
                (step.position(s), turned * self.from)
            }
        }
    }

    /// Returns the camera at a share of the way, and its angle of view in degrees.
    fn pose(&self, share: f64) -> (Camera, f64) {
        let (u, carried) = self.carried(share);
        let rotation = carried * DQuat::IDENTITY.slerp(self.turn, share);
        let fov_degrees = self.fov[0] + (self.fov[1] - self.fov[0]) * share;
        (Camera { u, rotation }, fov_degrees)
    }
}

/// Returns the rotation of a pose.
fn rotation(pose: &KeyPose) -> DQuat {
    Camera::looking(DVec3::ZERO, pose.camera.look, pose.camera.up).rotation
}

/// Steps by which the aim is moved from the start to the end, and rounds of Newton's method at each.
const AIMS: usize = 16;
const ROUNDS: usize = 8;

/// Finds a geodesic from `a` to `b`: Newton's method on its initial direction times its length, while the
/// aim moves along the chart's straight line. `None` if it does not converge.
fn geodesic_between(manifold: &Manifold, a: DVec3, b: DVec3) -> Option<Ray> {
    let inverse = manifold.standard_frame(a).inverse();
    let mut w = inverse * (b - a) / AIMS as f64;
    let close =
        |off: f64, target: DVec3| off <= CLOSE * (target - a).length() + ROUNDING * a.length();
    for aim in 1..=AIMS {
        let target = a + (b - a) * (aim as f64 / AIMS as f64);
        let mut off = f64::INFINITY;
        for _ in 0..ROUNDS {
            let (end, change) = shoot(manifold, a, w)?;
            off = (end - target).length();
            if close(off, target) {
                break;
            }
            w -= change.inverse() * (end - target);
            if !w.is_finite() {
                return None;
            }
        }
        if aim == AIMS {
            let d = w.try_normalize()?;
            return close(off, b).then(|| Ray::new(manifold, a, d, w.length()));
        }
        w *= (aim + 1) as f64 / aim as f64;
    }
    None
}

/// Follows the geodesic with initial direction times length `w` (standard frame). Returns its end, and the
/// derivative of that point by `w`.
fn shoot(manifold: &Manifold, a: DVec3, w: DVec3) -> Option<(DVec3, DMat3)> {
    let settings = Settings::bare(TOLERANCE).with_deviation();
    let length = w.length();
    let d = w.try_normalize()?;
    let end = ends(manifold, settings, [Ray::new(manifold, a, d, length)]).pop()??;
    if end.1 < length {
        return None;
    }
    let [j1, j2] = end.0.deviation(length)?;
    let [e1, e2] = perpendiculars(d);
    let to = DMat3::from_cols(end.0.tangent(length), j1 / length, j2 / length);
    let from = DMat3::from_cols(d, e1, e2);
    Some((end.0.position(length), to * from.transpose()))
}

/// Computes the slopes of the monotone cubic through the points (`t`, `x`), zero at both ends: the weighted
/// harmonic mean of the chords beside each point.
fn monotone_slopes(t: &[f64], x: &[f64]) -> Vec<f64> {
    let chord = |k: usize| (x[k + 1] - x[k]) / (t[k + 1] - t[k]);
    (0..t.len())
        .map(|k| {
            if k == 0 || k + 1 == t.len() || chord(k - 1) <= 0.0 || chord(k) <= 0.0 {
                return 0.0;
            }
            let (h0, h1) = (t[k] - t[k - 1], t[k + 1] - t[k]);
            let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
            (w0 + w1) / (w0 / chord(k - 1) + w1 / chord(k))
        })
        .collect()
}

#[cfg(test)]
#[path = "journey_tests.rs"]
mod tests;
