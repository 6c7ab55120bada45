//! The movement of a session's camera as time goes by.
//!
//! In: what is held down, a way to be followed or replayed, and the time. Out: the camera. It moves by the time
//! that has gone by since the last step, along geodesics, with axes transported in parallel: what lies straight
//! ahead stays straight ahead. Turning changes the axes alone.

use crate::{
    motion::{StopReason, moved},
    protocol::PictureKind,
    session::Session,
};
use geofan_core::diagnostic::SourceText;
use geofan_render::{Journey, scene::PoseFile};
use glam::{DQuat, DVec3};

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
            self.hint = Some("pick a point first: click on it".into());
            return;
        };
        if DVec3::from_array(query.u) != self.camera.u {
            self.hint = Some("the camera has moved since the point was picked: pick again".into());
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
        let poses = PoseFile::parse(SourceText::new("camera path", text), self.fov);
        match poses.and_then(|poses| Journey::begin(&self.space.manifold, &poses)) {
            Ok(journey) => {
                self.hint = None;
                self.travel = Travel::Replay(Box::new(journey), now);
            }
            Err(error) => self.hint = Some(error.to_string()),
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
        self.fov = fov;
        self.camera = camera;
        if time < to {
            self.travel = Travel::Replay(journey, began);
        }
    }
}
