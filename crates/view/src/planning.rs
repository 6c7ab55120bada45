//! What a session draws next, at what size, and what is made ready for that.
//!
//! In: the state of a session, the pixels and the seconds of each picture drawn while the camera moved, and places where
//! its camera is or may soon be, the most urgent first. Out: pictures to be drawn: hasty ones while something moves, then
//! the same refined, then samples of traced light; and meanwhile sections of the table to be decoded, one after another,
//! each once, and whether the paths from a place can be looked up without waiting for that. A section that nobody has
//! decoded takes as long as many pictures. Where it is decoded, and when that is done, is the engine's matter.
//!
//! A moving picture has the size with which it takes about [`WANTED`]. It takes a time that its size does not change
//! (the table is fixed to the camera), and one for each pixel; both are read from the times of pictures of different
//! sizes. Sizes come in steps, and a larger one is taken only with room to spare, so that the picture does not flicker
//! between two.

use crate::{
    frame_plan::{FrameContent, FramePlan, Purpose},
    protocol::PictureKind,
    session::Session,
};
use geofan_bundle::{CodedTree, Table};
use geofan_render::View;
use glam::DVec3;

/// Pixels of an error picture, moving and still: every pixel takes an exact path with its deviation.
const ERROR_PIXELS: [usize; 2] = [2_500, 25_000];

/// Pixels of the very first picture, of which neither the speed nor the size of the display is known: fewer show nothing
/// that can be recognised; ten times as many took 24 seconds in the figure-eight knot's complement.
const FIRST_PIXELS: usize = 6_000;

/// Most samples of a pixel by path tracing: noise falls with the root of their number.
const MOST_PASSES: u32 = 4096;

/// Least share of the display's sides that a moving picture may have.
const LEAST_SHARE: f64 = 0.05;

/// With more whole moving pictures than this on their way to the display, no other is begun.
pub(crate) const AHEAD: usize = 2;

/// What a picture is for, its size, the samples of a pixel, and the number of its sample of traced light.
type WantedPicture = (Purpose, (usize, usize), u16, Option<u64>);

impl Session {
    /// Plans the next picture, if the display lacks one.
    pub(crate) fn next_plan(&mut self, now: f64, workers: usize) -> Option<FramePlan> {
        if self.failed == Some(self.revision) {
            return None;
        }
        let stands_in = self.stands_in();
        if std::mem::replace(&mut self.stood_in, stands_in) && !stands_in {
            self.changed();
        }
        let (purpose, size, samples, pass) = self.next_picture(now)?;
        let content = FrameContent {
            pass,
            ..self.content()
        };
        self.number += 1;
        if self.shown_kind() == PictureKind::Error {
            (self.errors, self.given_up) = (Vec::new(), 0);
        }
        let numbers = (self.number, self.revision);
        Some(FramePlan::new(
            numbers,
            purpose,
            content,
            (size, samples),
            workers,
        ))
    }

    /// Finds what the next picture is.
    fn next_picture(&mut self, now: f64) -> Option<WantedPicture> {
        let known = self
            .drawn
            .filter(|(revision, ..)| *revision == self.revision);
        if self.is_hasty(now) {
            let wanted = known.is_none() && self.on_their_way.len() <= AHEAD;
            return wanted.then(|| (Purpose::Moving, self.moving_size(), 1, None));
        }
        let size = self.still_size();
        let best = self.best_samples();
        let whole = known.filter(|(_, drawn, ..)| *drawn == size);
        let have = whole.map_or(0, |(_, _, samples, _)| samples);
        let mut levels = [1, 4.min(best), best].into_iter();
        match levels.find(|samples| *samples > have) {
            Some(next) => Some((Purpose::Still, size, next, None)),
            None => {
                let pass = self.next_pass()?;
                Some((Purpose::Pass, size, 1, Some(pass)))
            }
        }
    }

    /// Tells whether a picture is wanted at once rather than refined: also the very first.
    pub(crate) fn is_hasty(&self, now: f64) -> bool {
        self.is_moving(now) || self.stood_in || self.drawn.is_none()
    }

    /// Returns the samples of a pixel of the best picture.
    pub(crate) fn best_samples(&self) -> u16 {
        match self.shown_kind() {
            PictureKind::Error => 1,
            _ => self.still_samples,
        }
    }

    /// Tells whether the display shows the best picture.
    pub(crate) fn is_refined(&self) -> bool {
        self.drawn.is_some_and(|(revision, size, samples, _)| {
            let whole = revision == self.revision && size == self.still_size();
            whole && samples >= self.best_samples()
        })
    }

    /// Returns the kind of the picture: where the table knows no paths, the exact picture stands for its errors.
    pub(crate) fn shown_kind(&self) -> PictureKind {
        match self.kind {
            PictureKind::Error if !self.space.knows(self.camera.u) => PictureKind::Exact,
            kind => kind,
        }
    }

    pub(crate) fn moving_size(&mut self) -> (usize, usize) {
        match self.shown_kind() {
            PictureKind::Error => within(self.display, ERROR_PIXELS[0]),
            _ => match self.moving_share {
                Some(share) => scaled(self.display, share),
                None if self.drawn.is_none() => within(self.display, FIRST_PIXELS),
                None => self.control.size(self.display),
            },
        }
    }

    pub(crate) fn still_size(&self) -> (usize, usize) {
        match self.shown_kind() {
            PictureKind::Error => within(self.display, ERROR_PIXELS[1]),
            _ => self.display,
        }
    }

    pub(crate) fn content(&self) -> FrameContent {
        let stands_in = self.stands_in();
        let kind = |kind| match kind {
            PictureKind::Table if stands_in => PictureKind::Exact,
            kind => kind,
        };
        FrameContent {
            camera: self.camera,
            fov: self.fov,
            kind: kind(self.shown_kind()),
            split: self.split.map(kind),
            pass: None,
            slow: self.control.is_slow(),
        }
    }

    /// Draws moving pictures at this share of the display's sides; as large as the machine can if it is none.
    pub(crate) fn set_moving_share(&mut self, share: f64) {
        // Written so that what is not a number becomes nothing.
        self.moving_share = (share > 0.0).then(|| share.clamp(LEAST_SHARE, 1.0));
    }

    /// Asks for so many samples by path tracing. Those that there are already stay; if none are wanted the one being drawn
    /// is given up, and the picture that they have been put over is drawn again.
    pub(crate) fn trace_paths(&mut self, now: f64, passes: u32) {
        self.wanted_passes = passes.min(MOST_PASSES);
        if self.wanted_passes > 0 && !self.shows_light() {
            self.hint = Some("light is traced where the table or exact paths are shown, undivided: choose one of them".into());
        }
        if self.wanted_passes == 0 {
            self.plan.take_if(|plan| plan.purpose == Purpose::Pass);
            if self.passes.are_shown(self.revision) {
                self.changed_at(now);
            }
            self.passes.forget();
        }
    }

    /// Returns the samples of a pixel by path tracing that the picture has.
    pub(crate) fn passes_done(&self) -> u32 {
        self.passes.count(self.revision, self.still_size())
    }

    /// Returns the number of the next sample by path tracing, if one is wanted.
    pub(crate) fn next_pass(&self) -> Option<u64> {
        let done = self.passes_done();
        let wanted = self.shows_light() && done < self.wanted_passes;
        wanted.then_some(done.into())
    }

    /// Tells whether the picture is one of which light can be traced.
    fn shows_light(&self) -> bool {
        matches!(self.kind, PictureKind::Table | PictureKind::Exact) && self.split.is_none()
    }

    /// Returns a section of the table ([`Table::sections`]) that is to be decoded while pictures are drawn; an engine asks
    /// when it has decoded the last one. Those of the cells that the camera is in or will come into are the first.
    pub fn next_section(&mut self, now: f64) -> Option<usize> {
        // Engines ask again and again, and to move the camera each time would take a twentieth of a page's own thread.
        let table = self.space.table.as_ref()?.table.clone();
        if !self.cells.is_left(&table) {
            return None;
        }
        self.advance(now);
        let places = self.places_ahead(now);
        let directions = self.seen_directions();
        self.cells.next(&table, places, &directions)
    }

    /// Takes note that a section is decoded wherever pictures are drawn. An engine that decodes the session's own table
    /// need not say so.
    pub fn section_decoded(&mut self, section: usize) {
        self.cells.note(section);
    }

    /// Returns directions that the camera sees, spread over the display.
    fn seen_directions(&self) -> Vec<DVec3> {
        View::of_camera(&self.camera, self.fov, self.display).spread()
    }

    /// Tells whether exact paths stand in for the table, because its cell here is not decoded yet.
    pub(crate) fn stands_in(&self) -> bool {
        let by_table = [Some(self.kind), self.split].contains(&Some(PictureKind::Table));
        let table = self.space.table.as_ref().filter(|_| by_table);
        table.is_some_and(|promise| !{
            let directions = self.seen_directions();
            self.cells
                .is_ready(&promise.table, self.camera.u, &directions)
        })
    }
}

/// Returns the size of a picture of at most so many pixels with about the sides of `display`.
fn within((width, height): (usize, usize), pixels: usize) -> (usize, usize) {
    let share = (pixels as f64 / (width * height) as f64).sqrt().min(1.0);
    let side = |length: usize| ((length as f64 * share) as usize).max(1);
    (side(width), side(height))
}

/// Returns a size with this share of the sides of `display`.
fn scaled((width, height): (usize, usize), share: f64) -> (usize, usize) {
    let side = |length: usize| ((length as f64 * share).round() as usize).max(1);
    (side(width), side(height))
}

/// Coded bytes that are decoded while a picture waits, if a place needs no more: a microsecond each, about.
const WAITED_FOR: usize = 24 << 10;

/// Sections of the table ([`Table::sections`]) that have been asked for, and those of which the engine has said that they
/// are decoded.
#[derive(Debug, Clone, Default)]
pub struct CellsAhead {
    asked: Marks,
    decoded: Marks,
}

/// Numbers of sections that are marked.
#[derive(Debug, Clone, Default)]
struct Marks(Vec<bool>);

impl Marks {
    /// Marks a number, and tells whether it was not before.
    fn insert(&mut self, number: usize) -> bool {
        if self.0.len() <= number {
            self.0.resize(number + 1, false);
        }
        !std::mem::replace(&mut self.0[number], true)
    }

    fn contains(&self, number: usize) -> bool {
        self.0.get(number) == Some(&true)
    }
}

impl CellsAhead {
    /// Returns the next section to be decoded: of the first of `places` that needs one for these directions (standard frame),
    /// then of the whole table.
    pub fn next(
        &mut self,
        table: &Table,
        places: impl IntoIterator<Item = DVec3>,
        directions: &[DVec3],
    ) -> Option<usize> {
        let urgent = places
            .into_iter()
            .flat_map(|u| table.sections_at(u, directions).unwrap_or_default());
        urgent
            .chain(table.sections())
            .find(|&section| self.asked.insert(section) && !self.has(table, section))
    }

    /// Tells whether any section is left to be asked for.
    pub fn is_left(&self, table: &Table) -> bool {
        let mut all = table.sections().into_iter();
        !all.all(|section| self.asked.contains(section))
    }

    /// Takes note that a section is decoded wherever pictures are drawn.
    pub fn note(&mut self, section: usize) {
        self.decoded.insert(section);
    }

    fn has(&self, table: &Table, section: usize) -> bool {
        let coded = table.section(section);
        coded.is_none_or(CodedTree::is_decoded) || self.decoded.contains(section)
    }

    /// Tells whether the paths from `u` in these directions can be looked up at once, or are not in the table at all.
    pub fn is_ready(&self, table: &Table, u: DVec3, directions: &[DVec3]) -> bool {
        let needed = table.sections_at(u, directions).unwrap_or_default();
        let missing = needed
            .into_iter()
            .filter(|section| !self.has(table, *section));
        let coded = missing.filter_map(|section| table.section(section));
        // The bytes of a chunk are those of its sections, too.
        coded.map(|coded| coded.bytes().len()).sum::<usize>() <= WAITED_FOR
    }
}

/// Seconds that a moving picture should take: thirty a second.
const WANTED: f64 = 0.033;

/// Where the time that no size changes is more than a share of that, a picture may take so many times as long:
/// a smaller one would look worse and hardly be sooner.
const OVER_FIXED: f64 = 2.0;

/// Shares of the display's sides that are drawn. Finer steps would change more often and show no more.
const STEPS: [f64; 8] = [1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125, 0.09375];

/// A larger size is taken when it is expected to take at most this share of the wanted time, a smaller one
/// when the present takes more than the other: with room to 1.2 a picture of 640 × 360 took 41 ms, and one that shows an
/// input came after 78 (two cores, a browser beside it).
const ROOM: [f64; 2] = [0.85, 1.05];

/// Weight of the newest time in the means: a single slow picture (another program's work) moves them little.
const NEWEST: f64 = 0.3;

/// Sizes tell the two times apart when their deviation is at least this share of their mean.
const APART: f64 = 0.1;

/// Seconds a pixel from which on a large block of a still picture, 31,000 pixels, takes longer than an event may wait;
/// below it small blocks would cost their margins for nothing. Usual spaces take a hundredth, the figure-eight knot's
/// complement forty times as long (on two cores, without a table).
const SLOW_PIXEL: f64 = 1e-5;

/// Pixels of the first picture of a kind, of which nothing is known: it appears at once on usual machines.
const FIRST_OF_KIND: f64 = 320.0 * 180.0;

/// Most steps up from one picture to the next: the second or third of a kind, of whose times little is known yet, would be
/// seconds late if it were whole at once; with one step a fast machine is sharp after four pictures in place of two.
const MOST_UP: usize = 2;

/// Chooses the size of moving pictures.
#[derive(Debug, Clone, Default)]
pub struct ResolutionControl {
    /// Pictures whose times are known.
    count: u32,
    /// Running means of pixels `x`, seconds `y`, `x²` and `xy`.
    means: Option<[f64; 4]>,
    /// Seconds that no size changes.
    fixed: f64,
    step: Option<usize>,
}

impl ResolutionControl {
    /// Takes note that a picture of `pixels` took `seconds`.
    pub fn observe(&mut self, pixels: usize, seconds: f64) {
        if pixels == 0 || !seconds.is_finite() || seconds < 0.0 {
            return;
        }
        let (x, y) = (pixels as f64, seconds);
        let now = [x, y, x * x, x * y];
        self.count = self.count.saturating_add(1);
        // The first picture of a kind takes a time for what is made ready once: with the second, which says what pictures
        // take, it is left out.
        let known = self.means.filter(|_| self.count > 2).unwrap_or(now);
        let means = std::array::from_fn(|k| known[k] + NEWEST * (now[k] - known[k]));
        self.means = Some(means);
        let [x, y, xx, xy] = means;
        let variance = xx - x * x;
        if variance > (APART * x).powi(2) {
            let slope = (xy - x * y) / variance;
            self.fixed = y - slope.clamp(0.0, y / x) * x;
        }
        self.fixed = self.fixed.min(y);
    }

    /// Forgets what is known: another way of drawing costs something else.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Tells whether a pixel takes so long that still pictures must be drawn in small blocks.
    pub fn is_slow(&self) -> bool {
        self.means
            .is_some_and(|[x, y, ..]| y > SLOW_PIXEL * x + self.fixed)
    }

    /// Returns the seconds that a picture of `pixels` is expected to take.
    fn expected(&self, pixels: f64) -> Option<f64> {
        let [x, y, ..] = self.means?;
        Some(self.fixed + (y - self.fixed) * pixels / x)
    }

    /// Returns the size of the next moving picture on a display of `width` × `height`.
    pub fn size(&mut self, (width, height): (usize, usize)) -> (usize, usize) {
        let pixels = |step: usize| (width * height) as f64 * STEPS[step] * STEPS[step];
        let last = STEPS.len() - 1;
        let wanted = WANTED.max(OVER_FIXED * self.fixed);
        let takes = |step: usize| self.expected(pixels(step));
        let fits = |step: usize, room: f64| takes(step) <= Some(room * wanted);
        let first = || (0..last).find(|s| pixels(*s) <= FIRST_OF_KIND);
        let mut step = self.step.or_else(first).unwrap_or(last);
        if self.means.is_some() {
            let least = step.saturating_sub(MOST_UP);
            while step < last && !fits(step, ROOM[1]) {
                step += 1;
            }
            while step > least && fits(step - 1, ROOM[0]) {
                step -= 1;
            }
            self.step = Some(step);
        }
        let side = |length: usize| ((length as f64 * STEPS[step]).round() as usize).max(1);
        (side(width), side(height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws pictures on a machine of so many seconds a pixel; returns their sizes.
    fn run(control: &mut ResolutionControl, cost: impl Fn(usize) -> f64, n: usize) -> Vec<usize> {
        let mut widths = Vec::new();
        for k in 0..n {
            let (w, h) = control.size((1280, 720));
            control.observe(w * h, cost(k) * (w * h) as f64);
            widths.push(w);
        }
        widths
    }

    #[test]
    fn a_slow_machine_gets_small_pictures_and_a_fast_one_whole_ones() {
        let fast = run(&mut ResolutionControl::default(), |_| 2e-8, 10);
        assert_eq!(fast[9], 1280);
        let slow = run(&mut ResolutionControl::default(), |_| 1e-6, 10);
        assert_eq!(slow[9], 240);
        let middle = run(&mut ResolutionControl::default(), |_| 1e-7, 10);
        assert_eq!(middle[9], 640);
    }

    #[test]
    fn the_size_settles_though_times_vary_by_a_tenth() {
        let wobble =
            |k: usize| 1.15e-7 * (1.0 + 0.1 * if k.is_multiple_of(2) { 1.0 } else { -1.0 });
        let widths = run(&mut ResolutionControl::default(), wobble, 60);
        assert!(widths[5..].windows(2).all(|w| w[0] == w[1]), "{widths:?}");
    }

    #[test]
    fn a_machine_that_becomes_busy_and_free_again_is_followed() {
        let mut control = ResolutionControl::default();
        let free = run(&mut control, |_| 3e-8, 10)[9];
        let busy = run(&mut control, |_| 4e-7, 10)[9];
        let again = run(&mut control, |_| 3e-8, 20)[19];
        assert!(busy < free && again == free, "{free} {busy} {again}");
    }

    #[test]
    fn where_every_picture_takes_a_time_of_its_own_the_smallest_is_not_chosen_in_vain() {
        let mut control = ResolutionControl::default();
        let mut widths = Vec::new();
        for _ in 0..40 {
            let (w, h) = control.size((640, 360));
            control.observe(w * h, 0.06 + 1e-7 * (w * h) as f64);
            widths.push(w);
        }
        assert!(widths[10..].iter().all(|w| *w == 640), "{widths:?}");
    }

    #[test]
    fn what_the_first_picture_makes_ready_once_does_not_make_the_next_ones_late() {
        // The size of the very first is not chosen here.
        for first in [2_500, 6_000, 57_600] {
            let mut control = ResolutionControl::default();
            control.observe(first, 0.4);
            let mut longest = 0.0_f64;
            for _ in 0..40 {
                let (w, h) = control.size((1280, 720));
                let seconds = 3e-7 * (w * h) as f64;
                longest = longest.max(seconds);
                control.observe(w * h, seconds);
            }
            assert!(longest < 2.0 * WANTED, "{first}: {longest}");
        }
    }

    #[test]
    fn nonsense_is_not_taken_for_a_time() {
        let mut control = ResolutionControl::default();
        control.observe(0, 1.0);
        control.observe(10, f64::NAN);
        control.observe(10, -1.0);
        assert_eq!(control.size((320, 180)), (320, 180));
        assert_eq!(control.size((1, 1)), (1, 1));
    }
}
