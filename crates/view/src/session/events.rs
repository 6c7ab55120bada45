//! What the events of a user interface do to a session.
//!
//! In: a [`ViewerEvent`] and its time. Out: another state of the [`Session`]: its display, its camera, what it shows and
//! how. What an event asks for is kept between limits, or refused with a hint.

use super::{NO_TABLE_YET, RayUse, Session};
use crate::{
    frame_plan::{Block, Capture, FramePlan, Purpose},
    protocol::{PictureKind, Pose, ViewerEvent},
    spaces::{on_plane, zoomed},
    steering::{Held, Recording, Travel},
};
use geofan_core::geodesic::check_start;
use geofan_render::Camera;

/// Speeds, as shares of the length of paths a second.
const SPEEDS: [f64; 2] = [1e-5, 10.0];

/// Sides of a display, and of a captured picture.
const SIDES: [usize; 2] = [16, 8192];

/// Most pixels of a captured picture: a fifth of a gigabyte of linear light.
const MOST_CAPTURED: usize = 1 << 24;

impl Session {
    /// Takes note of an event at the time `now`.
    pub fn handle(&mut self, now: f64, event: ViewerEvent) {
        self.advance(now);
        match event {
            ViewerEvent::Resize { width, height } => self.resize(now, [width, height]),
            ViewerEvent::Hold {
                go,
                turn,
                roll,
                fast,
            } => self.held = Held::new(go, turn, roll, fast),
            ViewerEvent::Look { right, down } => self.look(now, right, down),
            ViewerEvent::Speed { factor } => self.speed_up(factor),
            ViewerEvent::Zoom { factor } => self.zoom(now, factor),
            ViewerEvent::Home => self.go_to_camera(now, 0),
            ViewerEvent::View { name } => self.go_to_view(now, &name),
            ViewerEvent::Place(pose) => self.place(now, &pose),
            ViewerEvent::Show { kind, split } => self.show(now, kind, split),
            ViewerEvent::Exposure { stops } => self.expose(stops),
            ViewerEvent::Sky { sky } => {
                if sky != self.sky {
                    self.set_sky(sky);
                    self.changed_at(now);
                }
            }
            ViewerEvent::Beyond { allowed } => self.beyond = allowed,
            ViewerEvent::Still { samples } => self.still_samples = samples.clamp(1, 256),
            ViewerEvent::Resolution { share } => self.set_moving_share(share),
            ViewerEvent::Paths { passes } => self.trace_paths(now, passes),
            ViewerEvent::Hover { x, y } => self.point([x, y]),
            ViewerEvent::Pick { x, y } => self.pointer = Some((RayUse::Pick, [x, y])),
            ViewerEvent::Follow => self.follow(),
            ViewerEvent::Halt => self.halt(),
            ViewerEvent::Record { on } => self.record(now, on),
            ViewerEvent::Replay { text } => self.replay(now, &text),
            ViewerEvent::Capture {
                width,
                height,
                samples,
                light,
            } => self.begin_capture((width as usize, height as usize), samples, light),
            ViewerEvent::Shown { frame } => self.on_their_way.retain(|number| *number > frame),
            // Only an engine can load a space again.
            ViewerEvent::Parameter { .. } => {}
        }
    }

    /// Stops what goes on; where nothing does, forgets the picked path.
    fn halt(&mut self) {
        let goes_on = !matches!(self.travel, Travel::None) || self.capture.is_some();
        self.travel = Travel::None;
        self.give_capture_up("");
        if !goes_on {
            (self.picked, self.asked) = (None, None);
        }
    }

    /// Takes another size of the display.
    fn resize(&mut self, now: f64, sides: [u32; 2]) {
        let [width, height] = sides.map(|x| (x as usize).clamp(SIDES[0], SIDES[1]));
        self.display = (width, height);
        self.changed_at(now);
    }

    /// Takes note of where the pointer is.
    fn point(&mut self, place: [f64; 2]) {
        let on_picture = place.iter().all(|share| (0.0..=1.0).contains(share));
        self.under = Some(place).filter(|_| on_picture);
        if !on_picture {
            self.leave();
        }
        self.ask_below();
    }

    /// Multiplies the speed.
    fn speed_up(&mut self, factor: f64) {
        if is_factor(factor) {
            let [slowest, fastest] = SPEEDS.map(|share| share * self.space.length);
            self.speed = (self.speed * factor).clamp(slowest, fastest);
        }
    }

    /// Multiplies the angle of view.
    fn zoom(&mut self, now: f64, factor: f64) {
        if is_factor(factor) {
            self.fov = zoomed(self.fov, factor);
            self.changed_at(now);
        }
    }

    /// Shows light `2^stops` times as bright.
    fn expose(&mut self, stops: f64) {
        if stops.is_finite() {
            let patches = self.shown.expose(stops.clamp(-20.0, 20.0));
            self.patches.extend(patches);
        }
    }

    /// Goes to a view that the scene gives.
    fn go_to_view(&mut self, now: f64, name: &str) {
        let mut views = self.space.cameras.iter().skip(1);
        match views.position(|camera| camera.name == name) {
            Some(k) => self.go_to_camera(now, 1 + k),
            None => self.hint = Some(format!("the scene has no view `{name}`")),
        }
    }

    /// Goes to the scene's camera `k`; says what it asks for that is not shown.
    fn go_to_camera(&mut self, now: f64, k: usize) {
        let camera = self.space.cameras[k].clone();
        self.place(now, &camera.pose);
        self.hint = self.hint.take().or(camera.unshown);
    }

    /// Goes to a pose, if a camera can be there.
    fn place(&mut self, now: f64, pose: &Pose) {
        let Some(camera) = pose.camera().filter(|_| pose.fov.is_finite()) else {
            self.hint = Some("this is no place for a camera: it looks nowhere".into());
            return;
        };
        let u = self.space.manifold.domain.wrap(camera.u);
        if let Err(error) = check_start(&self.space.manifold, "the camera", u) {
            self.hint = Some(error.to_string());
            return;
        }
        self.travel = Travel::None;
        self.hint = None;
        self.camera = Camera { u, ..camera };
        self.fov = on_plane(pose.fov);
        self.changed_at(now);
    }

    /// Shows another kind of picture, or two side by side; what needs a table waits for one.
    fn show(&mut self, now: f64, kind: PictureKind, split: Option<PictureKind>) {
        // Error pictures are of another size: they share no picture with others.
        let split = split.filter(|second| *second != kind && *second != PictureKind::Error);
        let kinds = (kind, split.filter(|_| kind != PictureKind::Error));
        if kinds == (self.kind, self.split) {
            // Nothing else is waited for any more; a table that comes by itself is still shown.
            self.wanted = self.wanted.map(|_| kinds);
            self.hint.take_if(|hint| *hint == NO_TABLE_YET);
            return;
        }
        self.wanted = Some(kinds);
        if self.lacks_table(kinds) {
            let reason = self.space.no_table.as_deref();
            self.hint = Some(reason.unwrap_or(NO_TABLE_YET).into());
            return;
        }
        (self.kind, self.split) = kinds;
        self.hint = None;
        self.control.forget();
        self.changed_at(now);
    }

    /// Begins or ends a recording.
    fn record(&mut self, now: f64, on: bool) {
        if on {
            self.recording = Some(Recording::begin(now));
        }
        self.note_way(now, !on);
        if !on && let Some(recording) = self.recording.take() {
            self.recorded = recording.text();
            if self.recorded.is_empty() {
                self.hint = Some("the recording is too short to be a way".into());
            }
        }
    }

    /// Begins to draw a picture that is saved. Traced light that is on the display is saved as it is, if that is the size.
    fn begin_capture(&mut self, size: (usize, usize), samples: u16, light: bool) {
        let fits = size.0 >= 1 && size.1 >= 1 && size.0 <= SIDES[1] && size.1 <= SIDES[1];
        if !fits || size.0 * size.1 > MOST_CAPTURED {
            self.hint = Some(format!("a picture has at most {MOST_CAPTURED} pixels"));
            return;
        }
        let samples = samples.clamp(1, 256);
        let content = self.content();
        self.number += 1;
        let numbers = (self.number, self.revision);
        let brighter = match content.kind {
            // The legend tells its colours.
            PictureKind::Error => 0.0,
            _ => self.shown.exposure(),
        };
        let stops = (!light).then_some(brighter);
        let plan = FramePlan::new(numbers, Purpose::Capture, content, (size, samples), 1);
        self.capture = Some(Capture::new(plan, stops));
        if self.next_pass().is_some() || self.passes_done() > 0 {
            self.capture_light(size);
        }
    }

    /// Saves the traced light that is on the display in place of the picture that is to be saved, if that has its size.
    fn capture_light(&mut self, size: (usize, usize)) {
        let passes = std::mem::take(&mut self.passes);
        match (passes.shown_mean(self.revision, size), &mut self.capture) {
            (Some(mean), Some(capture)) => {
                capture.skip();
                self.accept_captured(Block::whole(size), mean);
            }
            _ => self.hint = Some("the saved picture is without path tracing: it is saved at the display's size only, once it is shown".into()),
        }
        self.passes = passes;
    }
}

/// Tells whether something can be multiplied by this.
fn is_factor(factor: f64) -> bool {
    factor.is_finite() && factor > 0.0
}
