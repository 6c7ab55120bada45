//! The movement of a session's camera as time goes by, and the way that it takes, recorded as key poses.
//!
//! In: what is held down, a way to be followed or replayed, and the time. Out: the camera; and of a recording the text
//! of a camera path, as `geofan render --camera-path` takes it. The camera moves by the time that has gone by since the
//! last step, along geodesics, with axes transported in parallel: what lies straight ahead stays straight ahead. Turning
//! changes the axes alone.

use crate::{
    motion::{StopReason, moved},
    protocol::{PictureKind, Pose},
    session::Session,
    spaces::{MOVING, not_shown, on_plane},
};
use geofan_core::{
    diagnostic::SourceText,
    manifold::{DeckTransformation, Manifold},
};
use geofan_render::{
    Camera, Journey,
    scene::{CameraMotion, KeyPose, PoseFile},
};
use glam::{DQuat, DVec3};
use std::fmt::Write;

/// The keys that are held down, as directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Held {
    /// Right, up, backwards: the camera's axes.
    go: DVec3,
    turn: [f64; 2],
    roll: f64,
    fast: bool,
}

impl Held {
    /// Takes it from an event's numbers, whatever they are.
    pub fn new(go: [f64; 3], turn: [f64; 2], roll: f64, fast: bool) -> Self {
        // Written so that what is not a number becomes nothing.
        let share = |x: f64| if x.is_nan() { 0.0 } else { x.clamp(-1.0, 1.0) };
        let [right, up, forwards] = go.map(share);
        Self {
            go: DVec3::new(right, up, -forwards),
            turn: turn.map(share),
            roll: share(roll),
            fast,
        }
    }

    fn is_nothing(&self) -> bool {
        self.go == DVec3::ZERO && self.turn == [0.0; 2] && self.roll == 0.0
    }
}

/// Ways in which the camera moves by itself.
#[derive(Default)]
pub enum Travel {
    /// Nothing.
    #[default]
    None,
    /// A geodesic in this direction of the camera's axes, with so much left of it.
    Follow(DVec3, f64),
    /// A way through key poses that began at this time.
    Replay(Box<Journey>, f64),
}

/// The longest step of time: after a pause of the machine the camera does not jump.
const LONGEST: f64 = 0.1;

/// Turning and rolling by keys, radians a second.
const TURNING: f64 = 1.2;

/// Times as fast with the key for fast.
const FAST: f64 = 4.0;

/// Seconds ahead for which the camera's cells are looked up: the last is what a large cell takes to be decoded.
const AHEAD: [f64; 6] = [0.25, 0.5, 1.0, 1.5, 2.0, 3.0];

/// Seconds in any direction for which they are.
const AROUND: f64 = 1.0;

/// Hints of what has to be picked before it can be followed.
pub(crate) const PICK_FIRST: &str = "pick a point first: click on it";
pub(crate) const PICK_AGAIN: &str = "the camera has moved since the point was picked: pick again";

/// Share of a picked path that is followed: its very end is on a surface or in an exit.
const FOLLOWED: f64 = 0.9;

impl Session {
    /// Tells whether the picture is moving.
    pub(crate) fn is_moving(&self, now: f64) -> bool {
        now < self.active_until || !self.held.is_nothing() || !matches!(self.travel, Travel::None)
    }

    /// Moves the camera to where it is at the time `now`.
    pub(crate) fn advance(&mut self, now: f64) {
        let before = self.stepped.replace(now).unwrap_or(now);
        let dt = (now - before).clamp(0.0, LONGEST);
        if !(dt > 0.0) {
            return;
        }
        let (camera, fov) = (self.camera, self.fov);
        self.turn_by_keys(dt);
        if self.held.go != DVec3::ZERO {
            self.travel = Travel::None;
            let fast = if self.held.fast { FAST } else { 1.0 };
            self.go(self.held.go * (self.speed * fast * dt));
        }
        match std::mem::take(&mut self.travel) {
            Travel::None => {}
            Travel::Follow(direction, left) => self.follow_on(direction, left, dt),
            Travel::Replay(journey, began) => self.replay_on(journey, began, now),
        }
        if self.camera != camera || self.fov != fov {
            self.changed_at(now);
        }
        self.note_way(now, false);
    }

    /// Lists where the camera is and will soon be as it moves now, then where it could be in any direction.
    pub(crate) fn places_ahead(&self, now: f64) -> Vec<DVec3> {
        let fast = if self.held.fast { FAST } else { 1.0 };
        let moves = |by: DVec3| {
            let manifold = &self.space.manifold;
            let by = by.clamp_length_max(self.space.length);
            moved(manifold, self.holding_table(), &self.camera, by)
                .camera
                .u
        };
        let mut places = vec![self.camera.u];
        let later = AHEAD.iter();
        match &self.travel {
            Travel::Replay(journey, began) => {
                let [from, to] = journey.interval();
                let at = |s: &f64| journey.pose((from + now - began + s).min(to)).0.u;
                places.extend(later.map(at).map(|u| self.space.manifold.domain.wrap(u)));
            }
            Travel::Follow(direction, left) => {
                places.extend(later.map(|s| moves(*direction * (self.speed * s).min(*left))));
            }
            Travel::None if self.held.go != DVec3::ZERO => {
                places.extend(later.map(|s| moves(self.held.go * (self.speed * fast * s))));
            }
            Travel::None => {}
        }
        for axis in [DVec3::NEG_Z, DVec3::X, DVec3::Y] {
            places.extend([1.0, -1.0].map(|sign| moves(axis * (sign * self.speed * AROUND))));
        }
        places
    }

    /// Takes note of the way, if it is recorded.
    pub(crate) fn note_way(&mut self, now: f64, end: bool) {
        if let Some(recording) = &mut self.recording {
            let manifold = &self.space.manifold;
            recording.note(manifold, now, (&self.camera, self.fov), end);
        }
    }

    /// Moves by `by` in the camera's axes; says what stopped it.
    fn go(&mut self, by: DVec3) {
        let manifold = &self.space.manifold;
        let went = moved(manifold, self.holding_table(), &self.camera, by);
        self.hint = match went.stop {
            None => None,
            Some(StopReason::Exit(exit)) => Some(match manifold.exits[exit].name.as_str() {
                "limit" => "the chart ends here".into(),
                "inside" => "the space ends here".into(),
                name => format!("this is the exit `{name}`: the space ends here"),
            }),
            Some(StopReason::Metric) => Some("the metric allows no way on".into()),
            Some(StopReason::Mirror) => {
                Some("a mirror stands here: a camera cannot be turned from right to left".into())
            }
            Some(StopReason::Region) => Some(
                "the table knows no paths from further on; allow the camera beyond to go on with exact paths"
                    .into(),
            ),
        };
        self.camera = went.camera;
    }

    fn turn_by_keys(&mut self, dt: f64) {
        let Held { turn, roll, .. } = self.held;
        if turn != [0.0; 2] || roll != 0.0 {
            self.turn([turn[0], turn[1], roll].map(|x| x * TURNING * dt));
        }
    }

    /// Turns to the right, down and clockwise by these angles.
    fn turn(&mut self, [right, down, roll]: [f64; 3]) {
        let turn = DQuat::from_rotation_y(-right)
            * DQuat::from_rotation_x(-down)
            * DQuat::from_rotation_z(-roll);
        self.camera = self.camera.turned(turn);
        // The path that is followed stays where it is.
        if let Travel::Follow(direction, _) = &mut self.travel {
            *direction = turn.inverse() * *direction;
        }
    }

    /// Turns the head by shares of the picture's width.
    pub(crate) fn look(&mut self, now: f64, right: f64, down: f64) {
        if !(right.is_finite() && down.is_finite()) {
            return;
        }
        let angle = |share: f64| share.clamp(-1.0, 1.0) * self.fov.to_radians();
        self.turn([angle(right), angle(down), 0.0]);
        self.changed_at(now);
    }

    /// Begins to follow the picked path.
    pub(crate) fn follow(&mut self) {
        let Some((query, report)) = &self.picked else {
            self.hint = Some(PICK_FIRST.into());
            return;
        };
        if DVec3::from_array(query.u) != self.camera.u {
            self.hint = Some(PICK_AGAIN.into());
            return;
        }
        if query.kind == PictureKind::Flat {
            self.hint = Some(
                "this line is straight in the chart only: pick where paths are curved to follow one"
                    .into(),
            );
            return;
        }
        let direction = self.camera.rotation.inverse() * DVec3::from_array(query.direction);
        self.travel = Travel::Follow(direction, FOLLOWED * report.length);
    }

    /// Goes on along a geodesic. Its direction stays the same in axes that are transported along it.
    fn follow_on(&mut self, direction: DVec3, left: f64, dt: f64) {
        let step = (self.speed * dt).min(left);
        let before = self.camera.u;
        self.go(direction * step);
        let on = left - step > 0.0 && self.hint.is_none() && self.camera.u != before;
        if on {
            self.travel = Travel::Follow(direction, left - step);
        }
    }

    /// Begins to replay a way.
    pub(crate) fn replay(&mut self, now: f64, text: &str) {
        let text = if text.is_empty() {
            self.recorded()
        } else {
            text
        };
        if text.is_empty() {
            self.hint = Some("nothing has been recorded yet".into());
            return;
        }
        // Poses without an angle of view have the scene's, as for `geofan render`.
        let poses = PoseFile::parse(SourceText::new("camera path", text), self.space.home().1);
        let begun = poses.and_then(|poses| {
            let journey = Journey::begin(&self.space.manifold, &poses)?;
            Ok((journey, self.not_replayed(&poses)))
        });
        match begun {
            Ok((journey, hint)) => {
                self.hint = hint;
                self.travel = Travel::Replay(Box::new(journey), now);
            }
            Err(error) => self.hint = Some(error.to_string()),
        }
    }

    /// Says what `geofan render` shows of a way and a viewer does not.
    fn not_replayed(&self, poses: &PoseFile) -> Option<String> {
        let moves = |pose: &KeyPose| !matches!(pose.camera.motion, CameraMotion::Normal);
        match poses.poses.iter().any(moves) {
            true => Some(not_shown("poses of this way have `rest` or `velocity`")),
            false => self.space.objects_move.then(|| not_shown(MOVING)),
        }
    }

    /// Goes on along a way.
    fn replay_on(&mut self, mut journey: Box<Journey>, began: f64, now: f64) {
        let [from, to] = journey.interval();
        let time = (from + now - began).min(to);
        if let Err(error) = journey.reach(time + AHEAD[AHEAD.len() - 1]) {
            self.hint = Some(error.to_string());
            return;
        }
        let (mut camera, fov) = journey.pose(time);
        camera.u = self.space.manifold.domain.wrap(camera.u);
        let manifold = &self.space.manifold;
        if geofan_core::geodesic::check_start(manifold, "the camera", camera.u).is_err() {
            self.hint = Some("the way leaves the space".into());
            return;
        }
        self.fov = on_plane(fov);
        self.camera = camera;
        if time < to {
            self.travel = Travel::Replay(journey, began);
        }
    }
}

/// Seconds between key poses: between them the way is a geodesic and the turn is even, which follows a hand
/// closely.
const BETWEEN_POSES: f64 = 0.25;

/// Most key poses: an hour.
const MOST_POSES: usize = 14_400;

/// A recording of the camera's way.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    poses: Vec<(f64, Pose)>,
    began: f64,
    /// The faces of a glued domain that the camera has gone through.
    word: Vec<usize>,
}

impl Recording {
    /// Begins at the time `now`.
    pub fn begin(now: f64) -> Self {
        Self {
            began: now,
            ..Self::default()
        }
    }

    /// Takes note of the camera, if it is time for that or the recording is at its `end`.
    pub fn note(
        &mut self,
        manifold: &Manifold,
        now: f64,
        (camera, fov): (&Camera, f64),
        end: bool,
    ) {
        let time = now - self.began;
        let last = self.poses.last();
        let due = last.is_none_or(|(before, _)| time >= before + BETWEEN_POSES);
        let later = last.is_none_or(|(before, _)| time > *before);
        if self.poses.len() >= MOST_POSES || !(due || end && later) {
            return;
        }
        let before = last.map(|(_, before)| DVec3::from(before.at));
        // Where the camera has gone through faces, the way goes on in the cover, so that it does not lead back across the
        // chart; so does a glued coordinate past its limit.
        let camera = self.in_cover(manifold, camera, before);
        let mut pose = Pose::of(&camera, fov);
        if let Some(before) = before {
            for k in 0..3 {
                if let Some(period) = manifold.domain.period(k) {
                    pose.at[k] += period * ((before[k] - pose.at[k]) / period).round();
                }
            }
        }
        self.poses.push((time, pose));
    }

    /// Returns the camera where the way through the cover has led it: through the faces so far, and those behind which it is
    /// nearer to the pose `before`; near an edge of the domain that may be two.
    fn in_cover(&mut self, manifold: &Manifold, camera: &Camera, before: Option<DVec3>) -> Camera {
        let gluing = manifold.gluing().filter(|gluing| gluing.follows_cover());
        let Some((gluing, before)) = gluing.zip(before) else {
            return *camera;
        };
        let Some(mut deck) = gluing.way_back(&self.word) else {
            return *camera;
        };
        let distance = |deck: &DeckTransformation| (deck.point(camera.u) - before).length();
        for _ in 0..2 {
            let mut nearest = distance(&deck);
            let mut found = None;
            for k in 0..gluing.faces().len() {
                let through = gluing.way_back(&[k]).map(|undone| undone.then(&deck));
                // A camera cannot be mirrored.
                if let Some(through) = through.filter(|through| !through.reverses())
                    && distance(&through) < nearest
                {
                    nearest = distance(&through);
                    found = Some((k, through));
                }
            }
            let Some((k, through)) = found else { break };
            self.word.push(k);
            deck = through;
        }
        camera.carried_by(manifold, &deck)
    }

    /// Returns the seconds from its first pose to its last.
    pub fn seconds(&self) -> f64 {
        self.poses.last().map_or(0.0, |(time, _)| *time)
    }

    /// Returns the text; empty if it has fewer than the two poses that a way needs.
    pub fn text(&self) -> String {
        let mut text = String::new();
        if self.poses.len() < 2 {
            return text;
        }
        for (time, pose) in &self.poses {
            let Pose { at, look, up, fov } = pose;
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "[[pose]]\ntime = {time:?}\nat = {at:?}\nlook = {look:?}\nup = {up:?}\nfov = {fov:?}\n"
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::manifold;
    use geofan_core::diagnostic::SourceText;
    use geofan_render::{Journey, scene::PoseFile};
    use glam::DVec3;

    #[test]
    fn a_recording_is_a_camera_path_that_goes_where_the_camera_went() {
        let flat =
            manifold("metric = { conformal = '1' }\n[domain]\nx = [-1, 1]\nperiodic = ['x']");
        let mut recording = Recording::begin(10.0);
        let at = |t: f64| {
            let u = flat.domain.wrap(DVec3::new(0.8 + 0.3 * t, 0.1 * t, 0.0));
            Camera::looking(u, DVec3::new(1.0, 0.2 * t, 0.0).normalize(), DVec3::Z)
        };
        for k in 0..=100 {
            let t = f64::from(k) * 0.02;
            recording.note(&flat, 10.0 + t, (&at(t), 80.0), k == 100);
        }
        let text = recording.text();
        let file = PoseFile::parse(SourceText::new("path.toml", text), 80.0).unwrap();
        let journey = Journey::new(&flat, &file).unwrap();
        assert_eq!(journey.interval(), [0.0, recording.seconds()]);
        let (middle, _) = journey.pose(1.0);
        assert!(
            (flat.domain.wrap(middle.u) - at(1.0).u).length() < 1e-3,
            "{}",
            middle.u
        );
    }

    #[test]
    fn a_recording_goes_on_through_the_faces_of_a_glued_domain() {
        // Through the ceiling half a turn about z.
        let room = manifold(
            "metric = { conformal = '1' }\n[[glue]]\nface = '1 - z'\nmap = ['-x', '-y', 'z - 2']\n[[glue]]\nface = '1 + z'\nmap = ['-x', '-y', 'z + 2']",
        );
        let at = |t: f64| {
            let u = DVec3::new(0.6, 0.3 + 0.01 * t, 0.2 + 0.5 * t);
            Camera::looking(u, DVec3::new(1.0, 0.1 * t, 0.3).normalize(), DVec3::Z)
        };
        let mut recording = Recording::begin(0.0);
        for k in 0..=400 {
            let t = f64::from(k) * 0.02;
            recording.note(&room, t, (&at(t).brought_in(&room), 80.0), k == 400);
        }
        let text = recording.text();
        let file = PoseFile::parse(SourceText::new("path.toml", text), 80.0).unwrap();
        let journey = Journey::new(&room, &file).unwrap();
        for k in 10..70 {
            let t = 0.1 * f64::from(k) + 0.013;
            let (replayed, flown) = (journey.pose_in_cover(t).0, at(t));
            assert!(
                (replayed.u - flown.u).length() < 2e-2,
                "{t}: {}",
                replayed.u
            );
            assert!(
                replayed.rotation.angle_between(flown.rotation) < 1e-2,
                "{t}"
            );
        }
    }

    #[test]
    fn a_recording_of_a_run_into_an_exit_is_a_camera_path() {
        let flat =
            manifold("metric = { conformal = '1' }\nexit = [{ name = 'out', when = 'x - 2' }]");
        for step in [0.01, 0.3] {
            let mut camera = Camera::looking(DVec3::new(1.0, 0.1, 0.0), DVec3::X, DVec3::Z);
            let mut recording = Recording::begin(0.0);
            for k in 0..=400 {
                let now = f64::from(k) * BETWEEN_POSES;
                recording.note(&flat, now, (&camera, 80.0), k == 400);
                camera = moved(&flat, None, &camera, DVec3::NEG_Z * step).camera;
            }
            let text = recording.text();
            let file = PoseFile::parse(SourceText::new("path.toml", text), 80.0).unwrap();
            let journey = Journey::new(&flat, &file).unwrap();
            assert!((journey.pose(recording.seconds()).0.u - camera.u).length() < 1e-12);
        }
    }

    #[test]
    fn one_pose_is_no_way() {
        let flat = manifold("metric = { conformal = '1' }");
        let mut recording = Recording::begin(0.0);
        let camera = Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z);
        recording.note(&flat, 0.0, (&camera, 90.0), true);
        assert_eq!(recording.text(), "");
    }
}
