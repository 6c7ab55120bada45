//! A viewer's session: what it shows and how, what happens next, and what must be drawn for that.
//!
//! In: events and answers, each with the time in seconds by any clock. Out: work, patches, the panel. What
//! events do is in `events`, movement in `steering`. A change that makes the picture another one counts up the
//! revision; what is drawn of an older revision is given up. A change that does not (exposure, hints, the pointer)
//! keeps all that is drawn.

mod events;

use crate::{
    frame_plan::{Block, Capture, FramePlan, Purpose},
    panel::PanelData,
    planning::{CellsAhead, ResolutionControl},
    protocol::{
        Answer, DrawRequest, Patch, PictureKind, Pose, RayQuery, RayReport, SkyChoice, Work,
    },
    shown_picture::{LightPasses, ShownPicture},
    spaces::SessionSpace,
    steering::{Held, PICK_AGAIN, PICK_FIRST, Recording, Travel},
};
use geofan_bundle::Table;
use geofan_core::{geodesic::check_start, quantiles::Quantiles};
use geofan_render::{Camera, View};
use glam::DVec3;
use std::collections::VecDeque;

/// Seconds after the last event in which the picture still counts as moving: between two events of a mouse
/// there are less.
const SETTLE: f64 = 0.15;

/// The share of the length of paths that a camera moves in a second at first.
const FIRST_SPEED: f64 = 1.0 / 12.0;

/// Samples of a pixel by path tracing before they are shown: fewer are noise over a picture without any.
const FIRST_SHOWN: u32 = 4;

/// The hint where an error picture gives way to an exact one.
const NO_ERRORS_HERE: &str =
    "the table knows no paths from here: exact paths are shown in place of its errors";

/// The hint where what is asked for has to wait.
const NO_TABLE_YET: &str = "there is no table yet: it is shown if there will be one";

/// The hint where a new home of the camera does not move it.
const NEW_HOME: &str = "the scene's camera is another one now: Home goes there";

/// The hint of a picture that is dark for the most part.
const DARK: &str = "more than half is black: its paths end by their length, or where no sky is; the pointer tells which";

/// Reasons for which a ray is followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RayUse {
    Hover,
    Pick,
}

/// A viewer's session.
pub struct Session {
    pub(crate) space: SessionSpace,
    pub(crate) camera: Camera,
    pub(crate) fov: f64,
    pub(crate) held: Held,
    pub(crate) travel: Travel,
    pub(crate) speed: f64,
    pub(crate) hint: Option<String>,
    pub(crate) recording: Option<Recording>,
    pub(crate) revision: u64,
    /// The time of the last step of movement.
    pub(crate) stepped: Option<f64>,
    /// Until then the picture counts as moving.
    pub(crate) active_until: f64,
    pub(crate) kind: PictureKind,
    pub(crate) split: Option<PictureKind>,
    /// The kinds that the user has chosen in place of those that were shown: they are shown again when there is a table
    /// again.
    wanted: Option<(PictureKind, Option<PictureKind>)>,
    sky: SkyChoice,
    beyond: bool,
    pub(crate) still_samples: u16,
    /// Samples of a pixel by path tracing that are wanted, and those that there are.
    pub(crate) wanted_passes: u32,
    pub(crate) passes: LightPasses,
    /// Chunks of the table that are decoded, or have been asked for.
    pub(crate) cells: CellsAhead,
    /// Exact paths have stood in for the table, whose cell here was not decoded.
    pub(crate) stood_in: bool,
    pub(crate) display: (usize, usize),
    pub(crate) control: ResolutionControl,
    /// Share of the display's sides that moving pictures have, if the user says.
    pub(crate) moving_share: Option<f64>,
    pub(crate) number: u32,
    pub(crate) plan: Option<FramePlan>,
    pub(crate) capture: Option<Capture>,
    /// The revision, the size and the samples of the last whole picture, and the seconds that it took.
    pub(crate) drawn: Option<(u64, (usize, usize), u16, f64)>,
    /// A revision of which a picture failed: it is not tried again.
    pub(crate) failed: Option<u64>,
    pub(crate) shown: ShownPicture,
    pub(crate) patches: Vec<Patch>,
    /// Whole frames that the user interface has not shown yet.
    pub(crate) on_their_way: VecDeque<u32>,
    finished: VecDeque<f64>,
    ray_number: u32,
    rays: Vec<(u32, RayUse)>,
    pointer: Option<(RayUse, [f64; 2])>,
    /// Where the pointer is, if it is on the picture.
    under: Option<[f64; 2]>,
    /// The last ray from where the pointer or the camera is no more.
    stale: u32,
    hover: Option<(String, f64)>,
    pub(crate) picked: Option<(RayQuery, RayReport)>,
    asked: Option<RayQuery>,
    pub(crate) errors: Vec<f64>,
    pub(crate) given_up: usize,
    error_report: Option<(Quantiles, f64)>,
    recorded: String,
    trouble: Option<String>,
    background: Option<String>,
    /// Parameters whose values viewers of the same space chose.
    chosen: Vec<String>,
    /// Another space is to come.
    loading: bool,
    curvature: Option<(DVec3, Option<f64>)>,
    /// The last whole picture is black for the most part.
    dark: bool,
}

impl Session {
    /// Begins in `space` at its scene's camera.
    pub fn new(space: SessionSpace) -> Self {
        let (camera, fov) = space.home();
        let kind = match space.table {
            Some(_) => PictureKind::Table,
            None => PictureKind::Exact,
        };
        Self {
            speed: FIRST_SPEED * space.length,
            hint: space.cameras[0].unshown.clone(),
            space,
            camera,
            fov,
            held: Held::default(),
            travel: Travel::None,
            recording: None,
            revision: 1,
            stepped: None,
            active_until: SETTLE,
            kind,
            split: None,
            wanted: None,
            sky: SkyChoice::Scene,
            beyond: false,
            still_samples: 16,
            wanted_passes: 0,
            passes: LightPasses::default(),
            cells: CellsAhead::default(),
            stood_in: false,
            display: (640, 360),
            control: ResolutionControl::default(),
            moving_share: None,
            number: 0,
            plan: None,
            capture: None,
            drawn: None,
            failed: None,
            shown: ShownPicture::default(),
            patches: Vec::new(),
            on_their_way: VecDeque::new(),
            finished: VecDeque::new(),
            ray_number: 0,
            rays: Vec::new(),
            pointer: None,
            under: None,
            stale: 0,
            hover: None,
            picked: None,
            asked: None,
            errors: Vec::new(),
            given_up: 0,
            error_report: None,
            recorded: String::new(),
            trouble: None,
            background: None,
            chosen: Vec::new(),
            loading: false,
            curvature: None,
            dark: false,
        }
    }

    /// Takes another space in place of the present one, after a change of its files: the camera stays where it
    /// is if it can. Of the same geometry (its table has come), the path that was picked holds, and so does the way that
    /// the camera goes.
    pub fn replace_space(&mut self, space: SessionSpace) {
        let stays = check_start(&space.manifold, "the camera", self.camera.u).is_ok();
        let same = self.space.manifold.differences(&space.manifold).is_empty();
        let at_home = (self.camera, self.fov) == self.space.home();
        let moved = space.home() != self.space.home();
        self.space = space;
        if !stays || moved && at_home {
            (self.camera, self.fov) = self.space.home();
            self.hint = self.space.cameras[0].unshown.clone();
        } else if moved && same {
            self.hint = Some(NEW_HOME.into());
        }
        let kinds = self.kinds_here();
        if kinds != (self.kind, self.split) {
            (self.kind, self.split) = kinds;
            self.hint = None;
        }
        if !(stays && same) {
            self.travel = Travel::None;
            (self.picked, self.asked, self.curvature) = (None, None, None);
        }
        self.cells = CellsAhead::default();
        self.control.forget();
        self.changed();
        self.begin_capture_anew();
    }

    /// Returns the kinds to be shown in the present space: those that the user has chosen, if they do not lack a table.
    fn kinds_here(&self) -> (PictureKind, Option<PictureKind>) {
        let usual = match self.space.table {
            Some(_) => PictureKind::Table,
            None => PictureKind::Exact,
        };
        let wanted = self.wanted.filter(|kinds| !self.lacks_table(*kinds));
        wanted.unwrap_or((usual, None))
    }

    /// Tells whether there is no table although one of these kinds needs it.
    fn lacks_table(&self, (kind, split): (PictureKind, Option<PictureKind>)) -> bool {
        self.space.table.is_none() && (needs_table(kind) || split.is_some_and(needs_table))
    }

    /// Says what is wrong with a file; `None` when all is well again.
    pub fn set_trouble(&mut self, trouble: Option<String>) {
        self.trouble = trouble;
    }

    /// Says whether another space is to come: until then nothing is settled.
    pub fn set_loading(&mut self, loading: bool) {
        self.loading = loading;
    }

    /// Says which skies are shown, to this viewer as to all others.
    pub fn set_sky(&mut self, sky: SkyChoice) {
        if sky != self.sky {
            self.sky = sky;
            self.changed();
            self.begin_capture_anew();
        }
    }

    /// Says what goes on behind, or is left out; `None` when nothing is.
    pub fn set_background(&mut self, background: Option<String>) {
        self.background = background;
    }

    /// Names the parameters whose values viewers of the same space chose, this one or others.
    pub fn set_chosen(&mut self, chosen: Vec<String>) {
        self.chosen = chosen;
    }

    /// Returns the space.
    pub fn space(&self) -> &SessionSpace {
        &self.space
    }

    /// Returns the camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Returns the text of the last recording.
    pub fn recorded(&self) -> &str {
        &self.recorded
    }

    /// Takes the patches that have not been taken yet.
    pub fn take_patches(&mut self) -> Vec<Patch> {
        std::mem::take(&mut self.patches)
    }

    /// Returns the table in whose region the camera is held, if it is.
    pub(crate) fn holding_table(&self) -> Option<&Table> {
        let held = !self.beyond && (needs_table(self.kind) || self.split.is_some_and(needs_table));
        let table = self.space.table.as_ref().filter(|_| held);
        table.map(|promise| &promise.table)
    }

    /// Makes the picture another one.
    pub(crate) fn changed(&mut self) {
        self.revision += 1;
        // Something else may be under the pointer.
        self.leave();
        self.ask_below();
    }

    /// Forgets what is under the pointer.
    fn leave(&mut self) {
        self.hover = None;
        self.stale = self.ray_number;
    }

    /// Asks what is under the pointer, unless a click waits for that.
    fn ask_below(&mut self) {
        if !matches!(self.pointer, Some((RayUse::Pick, _))) {
            self.pointer = self.under.map(|place| (RayUse::Hover, place));
        }
    }

    /// Makes the picture another one by an event.
    pub(crate) fn changed_at(&mut self, now: f64) {
        self.changed();
        self.active_until = now + SETTLE;
    }

    /// Returns the next work for one of `workers`, or nothing while there is none to give.
    pub fn next_work(&mut self, now: f64, workers: usize) -> Option<Work> {
        self.advance(now);
        if let Some(query) = self.next_ray(now) {
            return Some(Work::Ray(query));
        }
        let mut request = self.captured_in_turn(now);
        request = request.or_else(|| self.next_shown(now, workers));
        request.or_else(|| self.next_captured(now)).map(Work::Draw)
    }

    /// Returns the next block of the picture on the display.
    fn next_shown(&mut self, now: f64, workers: usize) -> Option<DrawRequest> {
        if let Some(plan) = &mut self.plan {
            if plan.purpose == Purpose::Moving || plan.revision == self.revision {
                // A picture that is waited for: blocks of the next one would come in between.
                return plan.next(now);
            }
            self.plan = None;
        }
        self.plan = self.next_plan(now, workers.max(1));
        self.plan.as_mut()?.next(now)
    }

    /// Returns a ray to be followed, if the pointer asks for one.
    fn next_ray(&mut self, now: f64) -> Option<RayQuery> {
        let (wanted, [x, y]) = self.pointer?;
        let busy = self.rays.iter().any(|(_, asked)| *asked == wanted);
        if busy || wanted == RayUse::Hover && self.is_moving(now) {
            return None;
        }
        self.pointer = None;
        if !(x.is_finite() && y.is_finite()) {
            return None;
        }
        let view = View::of_camera(&self.camera, self.fov, self.display);
        let (width, height) = (self.display.0 as f64, self.display.1 as f64);
        self.ray_number += 1;
        self.rays.push((self.ray_number, wanted));
        let query = RayQuery {
            number: self.ray_number,
            kind: match self.split {
                Some(second) if x >= 0.5 => second,
                _ => self.kind,
            },
            u: self.camera.u.to_array(),
            direction: view.direction(x * width, y * height).to_array(),
        };
        if wanted == RayUse::Pick {
            self.asked = Some(query);
        }
        Some(query)
    }

    /// Takes an answer at the time `now`.
    pub fn accept(&mut self, now: f64, answer: Answer) {
        match answer {
            Answer::Ray { number, report } => self.accept_ray(number, report),
            Answer::Failed {
                frame: None,
                message,
            } => {
                self.rays.clear();
                self.hint = Some(message);
            }
            Answer::Failed {
                frame: Some(frame),
                message,
            } => {
                self.hint = Some(message);
                if self.captures(frame) {
                    self.capture = None;
                }
                match self.plan.take_if(|plan| plan.number == frame) {
                    Some(plan) if plan.purpose == Purpose::Pass => self.wanted_passes = 0,
                    Some(plan) => self.failed = Some(plan.revision),
                    None => {}
                }
            }
            Answer::Drawn {
                frame,
                block,
                rgb,
                errors,
            } => {
                if self.captures(frame) {
                    self.accept_captured(block, &rgb);
                } else if let Some(plan) = self.plan.take_if(|plan| plan.number == frame) {
                    self.accept_shown(now, plan, block, (rgb, errors));
                }
            }
        }
    }

    /// Takes the light of a block of the picture `plan`, and the errors of its paths: not a number for those given up.
    fn accept_shown(
        &mut self,
        now: f64,
        mut plan: FramePlan,
        block: Block,
        (light, errors): (Vec<f32>, Vec<f32>),
    ) {
        self.given_up += errors.iter().filter(|e| e.is_nan()).count();
        let known = errors.into_iter().filter(|e| !e.is_nan());
        self.errors.extend(known.map(f64::from));
        let last = plan.returned();
        self.show_block(&plan, block, light, last);
        match last {
            true => self.finish(now, &plan),
            false => self.plan = Some(plan),
        }
    }

    /// Tells whether a frame is the picture that is saved.
    fn captures(&self, frame: u32) -> bool {
        let capture = self.capture.as_ref();
        capture.is_some_and(|capture| capture.number() == frame)
    }

    /// Puts a block on the display; of random samples the mean, once there are enough.
    fn show_block(&mut self, plan: &FramePlan, block: Block, light: Vec<f32>, last: bool) {
        let light = match plan.content.pass {
            None => light,
            Some(pass) => {
                let about = (plan.revision, plan.size);
                let mean = self.passes.add(about, block, &light);
                let shown = pass + 1 >= FIRST_SHOWN.min(self.wanted_passes).into();
                let Some(mean) = mean.filter(|_| shown) else {
                    return;
                };
                self.passes.show();
                mean
            }
        };
        let frame = (plan.number, plan.size);
        let about = (last, plan.content.kind == PictureKind::Error);
        self.patches
            .extend(self.shown.accept(frame, block, &light, about));
    }

    /// Takes note that a picture is whole.
    fn finish(&mut self, now: f64, plan: &FramePlan) {
        if plan.purpose == Purpose::Pass {
            self.passes.finish();
            return;
        }
        let seconds = (now - plan.started).max(0.0);
        let pixels = plan.size.0 * plan.size.1;
        // Its own kind: the user may have chosen another one since.
        let of_errors = plan.content.kind == PictureKind::Error;
        if plan.purpose == Purpose::Moving {
            self.on_their_way.push_back(plan.number);
            self.finished.push_back(now);
            if self.finished.len() > 16 {
                self.finished.pop_front();
            }
            if !of_errors {
                self.control.observe(pixels, seconds);
            }
        }
        self.drawn = Some((plan.revision, plan.size, plan.samples, seconds));
        // While the camera moves, nobody is told.
        self.dark = plan.purpose != Purpose::Moving && !of_errors && self.shown.is_dark();
        if of_errors {
            let all = self.errors.len() + self.given_up;
            let share = self.given_up as f64 / all.max(1) as f64;
            self.error_report = Some((Quantiles::of(&mut self.errors), share));
        }
    }

    fn accept_ray(&mut self, number: u32, report: RayReport) {
        let Some(at) = self.rays.iter().position(|(known, _)| *known == number) else {
            return;
        };
        match self.rays.swap_remove(at).1 {
            RayUse::Hover if number <= self.stale => {}
            RayUse::Hover => self.hover = Some((report.end, report.length)),
            RayUse::Pick => {
                let query = self.asked.take().filter(|query| query.number == number);
                self.picked = query.map(|query| (query, report));
                self.hint
                    .take_if(|hint| [PICK_FIRST, PICK_AGAIN].contains(&hint.as_str()));
            }
        }
    }

    /// Returns all that the panel shows.
    pub fn panel(&mut self, now: f64) -> PanelData {
        let manifold = self.space.manifold.clone();
        let moving = self.is_moving(now);
        if self.curvature.is_none_or(|(u, _)| u != self.camera.u) {
            let scalar = manifold.curvature(self.camera.u).map(|c| c.scalar);
            self.curvature = Some((self.camera.u, scalar.ok().filter(|x| x.is_finite())));
        }
        let drawn = self.drawn;
        let table = self.space.table.as_ref();
        let views = self.space.cameras.iter().skip(1);
        let behind = self.capture.as_ref().map(Capture::progress);
        let behind: Vec<String> = behind.into_iter().chain(self.background.clone()).collect();
        let shown = self.shown_kind();
        let told = match (shown != self.kind, self.dark && !moving) {
            (true, _) => Some(NO_ERRORS_HERE.to_string()),
            (false, true) => Some(DARK.to_string()),
            (false, false) => None,
        };
        PanelData {
            manifold: manifold.name.clone(),
            coordinates: manifold.coordinates.clone(),
            parameters: manifold.parameters.clone(),
            chosen: self.chosen.clone(),
            views: views.map(|camera| camera.name.clone()).collect(),
            pose: Pose::of(&self.camera, self.fov),
            curvature: self
                .curvature
                .filter(|(u, _)| *u == self.camera.u)
                .and_then(|(_, scalar)| scalar),
            kind: self.kind,
            split: self.split,
            promise: table.map(|promise| promise.mrad),
            no_table: self.space.no_table.clone(),
            certificate: table.and_then(|promise| promise.certificate.clone()),
            sky: self.sky,
            beyond: self.beyond,
            within_table: self.space.knows(self.camera.u),
            speed: self.speed,
            moving_share: self.moving_share.unwrap_or(0.0),
            exposure: self.shown.exposure(),
            size: drawn.map_or((0, 0), |(_, size, ..)| size),
            samples: drawn.map_or(0, |(_, _, samples, _)| samples),
            passes: (self.passes_done(), self.wanted_passes),
            decoding: self.stood_in,
            settled: !self.loading
                && !moving
                && !self.stood_in
                && self.is_refined()
                && self.next_pass().is_none(),
            display: self.display,
            seconds: drawn.map(|(.., seconds)| seconds),
            rate: self.rate(now),
            hint: self.hint.clone().or(told),
            trouble: self.trouble.clone(),
            background: (!behind.is_empty()).then(|| behind.join("; ")),
            errors: self.error_report.filter(|_| shown == PictureKind::Error),
            legend: PanelData::legend(),
            hover: self.hover.clone(),
            picked: self.picked.as_ref().map(|(_, report)| report.clone()),
            recording: self.recording.as_ref().map(Recording::seconds),
            recorded: !self.recorded.is_empty(),
            travelling: !matches!(self.travel, Travel::None),
        }
    }

    /// Returns the moving pictures of the last second or so, each second.
    fn rate(&self, now: f64) -> Option<f64> {
        let recent = self.finished.iter().filter(|t| now - **t < 1.5);
        let (count, first) = (recent.clone().count(), recent.copied().reduce(f64::min)?);
        let last = self.finished.back()?;
        (count >= 3 && *last > first).then(|| (count - 1) as f64 / (last - first))
    }
}

/// Tells whether pictures of this kind are made by a table.
fn needs_table(kind: PictureKind) -> bool {
    matches!(kind, PictureKind::Table | PictureKind::Error)
}

#[cfg(test)]
#[path = "session_tests.rs"]
pub(crate) mod tests;
