//! A camera's journey through key poses.
//!
//! In: a [`PoseFile`] and its manifold. Out: a [`Journey`], the [`Camera`] at any time. Neighbouring
//! poses are joined by a geodesic, all at once or as time goes by; the camera is carried along it by
//! parallel transport, and what is then missing to the next pose is turned evenly on the way. Speed (arc length plus
//! angle turned) is a monotone cubic of time through all poses (F. N. Fritsch and R. E. Carlson, *Monotone
//! piecewise cubic interpolation*, 1980), at rest at both ends.

use super::{
    camera::Camera,
    scene::{CameraMotion, KeyPose, PoseFile},
    view::{camera_point, camera_velocity},
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::Result,
    geodesic::{Path, Ray, Settings, ends, paths, perpendiculars},
    manifold::Manifold,
};
use glam::{DMat3, DQuat, DVec3};

/// Local tolerance of the geodesics: an animation shows no finer error.
const TOLERANCE: f64 = 1e-9;

/// Distance to the next pose at which the geodesic has reached it, as a share of the whole distance.
const CLOSE: f64 = 1e-7;

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
            .map(|pose| camera_point(&cover, &file.source, &pose.camera));
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
    /// face or none. Returns it with its length; `Some(None)` if they are the same point, `None` if none is found.
    fn way(&self, a: DVec3, b: DVec3) -> Option<Option<(Path, f64)>> {
        if a == b {
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
    for aim in 1..=AIMS {
        let target = a + (b - a) * (aim as f64 / AIMS as f64);
        let mut off = f64::INFINITY;
        for _ in 0..ROUNDS {
            let (end, change) = shoot(manifold, a, w)?;
            off = (end - target).length();
            if off <= CLOSE * (target - a).length() {
                break;
            }
            w -= change.inverse() * (end - target);
            if !w.is_finite() {
                return None;
            }
        }
        if aim == AIMS {
            let close = off <= CLOSE * (b - a).length();
            let d = w.try_normalize()?;
            return close.then(|| Ray::new(manifold, a, d, w.length()));
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
mod tests {
    use super::*;
    use geofan_core::diagnostic::SourceText;

    const SPHERE: &str = r#"
name = "S3"
coordinates = ["x", "y", "z"]
metric = { conformal = "2/(1 + x^2 + y^2 + z^2)" }
"#;

    #[test]
    fn joined_points_are_as_far_apart_as_the_sphere_has_them() {
        let manifold = Manifold::from_source(SourceText::new("s3", SPHERE), &[]).unwrap();
        let lift = |u: DVec3| {
            (u * 2.0 / (1.0 + u.length_squared()))
                .extend((1.0 - u.length_squared()) / (1.0 + u.length_squared()))
        };
        let (a, b) = (DVec3::new(0.3, -0.2, 0.5), DVec3::new(-0.7, 0.9, 0.4));
        let ray = geodesic_between(&manifold, a, b).unwrap();
        let angle = lift(a).dot(lift(b)).acos();
        assert!((ray.length - angle).abs() < 1e-6, "{} {angle}", ray.length);
    }

    #[test]
    fn speed_is_zero_at_the_ends_and_never_turns_back() {
        let slopes = monotone_slopes(&[0.0, 1.0, 3.0, 4.0], &[0.0, 2.0, 2.5, 9.0]);
        assert_eq!((slopes[0], slopes[3]), (0.0, 0.0));
        // Three times the smaller chord is the limit of monotony.
        assert!(slopes[1] > 0.0 && slopes[1] <= 0.75 && slopes[2] <= 0.75);
    }
}
