//! What a session draws next, and what is made ready for that.
//!
//! In: the state of a session, and places where its camera is or may soon be, the most urgent first. Out: pictures to
//! be drawn: hasty ones while something moves, then the same refined, then samples of traced light; and meanwhile
//! chunks of the table to be decoded, one after another, each once, and whether the paths from a place can be looked up
//! without waiting for that. A chunk that nobody has decoded takes as long as many pictures. Where it is decoded, and
//! when that is done, is the engine's matter.

use crate::{
    frame_plan::{FrameContent, FramePlan, Purpose},
    protocol::PictureKind,
    session::Session,
};
use geofan_bundle::Table;
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

    /// Asks for so many samples by path tracing. Those that there are already stay; without any, the picture that
    /// they have been put over is drawn again.
    pub(crate) fn trace_paths(&mut self, now: f64, passes: u32) {
        self.wanted_passes = passes.min(MOST_PASSES);
        if self.wanted_passes > 0 && !self.shows_light() {
            self.hint = Some("light is traced where the table or exact paths are shown, undivided: choose one of them".into());
        }
        if self.wanted_passes == 0 && self.passes_done() > 0 {
            self.passes.forget();
            self.changed_at(now);
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

    /// Returns a chunk of the table that is to be decoded while pictures are drawn; an engine asks when it has
    /// decoded the last one. The chunks of the cells that the camera is in or will come into are the first.
    pub fn next_chunk(&mut self, now: f64) -> Option<usize> {
        self.advance(now);
        let table = self.space.table.as_ref()?.table.clone();
        if !self.cells.is_left(&table) {
            return None;
        }
        let places = self.places_ahead(now);
        self.cells.next(&table, places)
    }

    /// Takes note that a chunk is decoded wherever pictures are drawn. An engine that decodes the session's own table
    /// need not say so.
    pub fn chunk_decoded(&mut self, chunk: usize) {
        self.cells.note(chunk);
    }

    /// Tells whether exact paths stand in for the table, because its cell here is not decoded yet.
    pub(crate) fn stands_in(&self) -> bool {
        let by_table = [Some(self.kind), self.split].contains(&Some(PictureKind::Table));
        let table = self.space.table.as_ref().filter(|_| by_table);
        table.is_some_and(|promise| !self.cells.is_ready(&promise.table, self.camera.u))
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

/// Chunks that have been asked for, and those of which the engine has said that they are decoded.
#[derive(Debug, Clone, Default)]
pub struct CellsAhead {
    asked: Vec<bool>,
    decoded: Vec<bool>,
}

impl CellsAhead {
    /// Returns the next chunk to be decoded: of the first of `places` that needs one, then of the whole table.
    pub fn next(
        &mut self,
        table: &Table,
        places: impl IntoIterator<Item = DVec3>,
    ) -> Option<usize> {
        let count = table.chunks.len();
        self.asked.resize(count, false);
        let urgent = places
            .into_iter()
            .flat_map(|u| table.chunks_at(u).unwrap_or_default());
        urgent.chain(0..count).find(|&chunk| {
            let asked = std::mem::replace(&mut self.asked[chunk], true);
            !asked && !self.has(table, chunk)
        })
    }

    /// Tells whether any chunk is left to be asked for.
    pub fn is_left(&self, table: &Table) -> bool {
        let count = table.chunks.len();
        self.asked.len() < count || self.asked.contains(&false)
    }

    /// Takes note that a chunk is decoded wherever pictures are drawn.
    pub fn note(&mut self, chunk: usize) {
        if self.decoded.len() <= chunk {
            self.decoded.resize(chunk + 1, false);
        }
        self.decoded[chunk] = true;
    }

    fn has(&self, table: &Table, chunk: usize) -> bool {
        table.chunks[chunk].is_decoded() || self.decoded.get(chunk) == Some(&true)
    }

    /// Tells whether the paths from `u` can be looked up at once, or are not in the table at all.
    pub fn is_ready(&self, table: &Table, u: DVec3) -> bool {
        let needed = table.chunks_at(u).unwrap_or_default();
        let missing = needed.into_iter().filter(|chunk| !self.has(table, *chunk));
        let bytes: usize = missing.map(|chunk| table.chunks[chunk].bytes().len()).sum();
        bytes <= WAITED_FOR
    }
}
