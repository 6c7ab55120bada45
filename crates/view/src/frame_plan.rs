//! Dividing a picture into blocks to be drawn, and a picture that is saved while it is drawn.
//!
//! In: the size of a picture, how many workers there are, and what it is for. Out: a [`FramePlan`]: blocks
//! handed out one after another, and what has come back. A moving picture is one band of whole rows for each
//! worker; a still one has blocks of a fixed size, whatever the workers, so that it is the same everywhere and
//! an event does not wait for more than a block.
//!
//! A saved picture ([`Capture`]) has the camera, kind and exposure of the moment of asking. Its blocks are drawn in turns
//! with those of the display, and it tells how far it is. It shows one state only: when the scene changes it is given
//! up, with a hint.

use crate::{
    protocol::{DrawRequest, PictureKind},
    session::Session,
};
use geofan_core::geodesic::check_start;
use geofan_render::{Camera, lattice::LARGEST_TILE};
use serde::{Deserialize, Serialize};
use std::{collections::VecDeque, ops::Range};

/// A part of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Block {
    /// Its first column.
    pub x: usize,
    /// Its first row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Block {
    /// Returns the whole of a picture of this size.
    pub fn whole((width, height): (usize, usize)) -> Self {
        Self {
            x: 0,
            y: 0,
            width,
            height,
        }
    }

    /// Tells whether it lies within a picture of this size.
    pub fn is_within(&self, (width, height): (usize, usize)) -> bool {
        self.x + self.width <= width && self.y + self.height <= height
    }

    /// Returns its columns in the picture.
    pub fn columns(&self) -> Range<usize> {
        self.x..self.x + self.width
    }

    /// Returns its rows in the picture.
    pub fn rows(&self) -> Range<usize> {
        self.y..self.y + self.height
    }
}

/// Purposes of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// To be seen for a moment.
    Moving,
    /// To be looked at.
    Still,
    /// One random sample of each pixel, to be added to those before.
    Pass,
    /// To be kept.
    Capture,
}

/// Pixels around a block of a still picture that are drawn with it: the pixel filter reaches one and a half.
const MARGIN: usize = 2;

/// Sides of the blocks of a still picture: with their margins whole tiles of the lattice.
const STILL_BLOCK: (usize, usize) = (4 * LARGEST_TILE - 2 * MARGIN, 2 * LARGEST_TILE - 2 * MARGIN);

/// The same with more than [`FEW_SAMPLES`] for each pixel, so that 16 samples take the memory that 4 do in a large block,
/// because a worker of a page keeps what it has once needed: an eighth of a megabyte a thousand samples.
const FINE_BLOCK: (usize, usize) = (STILL_BLOCK.1, LARGEST_TILE - 2 * MARGIN);

/// Samples of a pixel that are drawn in large blocks.
const FEW_SAMPLES: u16 = 4;

/// The same where exact paths take long, with few samples and with more: an event waits for seconds at most. Smaller
/// ones would be margin for the most part: these have a fifth, and a half, more pixels with it. Exact paths, each
/// integrated, show the same in blocks of any size.
const SLOW_BLOCKS: [(usize, usize); 2] = [(60, 28), (28, 12)];

/// The same for random samples, where several workers have a block each: one takes a fifth of a second.
const PASS_BLOCK: (usize, usize) = (64, 32);

/// A picture being drawn.
#[derive(Debug, Clone)]
pub struct FramePlan {
    /// Its number.
    pub number: u32,
    /// The state of the session that it shows.
    pub revision: u64,
    /// Its purpose.
    pub purpose: Purpose,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Samples of a pixel.
    pub samples: u16,
    /// When the first block was handed out.
    pub started: f64,
    /// Its content and the way in which it is drawn.
    pub content: FrameContent,
    waiting: VecDeque<(Block, PictureKind)>,
    /// Blocks that are being drawn.
    outstanding: usize,
}

/// The content of a picture and the way in which it is drawn.
#[derive(Debug, Clone, Copy)]
pub struct FrameContent {
    /// The camera.
    pub camera: Camera,
    /// Horizontal angle of view, degrees.
    pub fov: f64,
    /// The way in which it is drawn.
    pub kind: PictureKind,
    /// The way of the right half, if it has its own.
    pub split: Option<PictureKind>,
    /// The number of the random sample of each pixel, if it is one.
    pub pass: Option<u64>,
    /// Its pixels take long.
    pub slow: bool,
}

impl FramePlan {
    /// Plans a picture of `size` with `samples` for each pixel, to be drawn by `workers`.
    pub fn new(
        (number, revision): (u32, u64),
        purpose: Purpose,
        content: FrameContent,
        (size, samples): ((usize, usize), u16),
        workers: usize,
    ) -> Self {
        let halves = match content.split {
            None => vec![(0..size.0, content.kind)],
            Some(second) => vec![(0..size.0 / 2, content.kind), (size.0 / 2..size.0, second)],
        };
        let mut waiting = VecDeque::new();
        for (columns, kind) in halves
            .into_iter()
            .filter(|(columns, _)| !columns.is_empty())
        {
            let area = Block {
                x: columns.start,
                y: 0,
                width: columns.len(),
                height: size.1,
            };
            let slow = content.slow && kind == PictureKind::Exact;
            let parts = match still_block(purpose, slow, samples, workers) {
                None => bands(area, workers),
                Some(sides) => blocks(area, sides),
            };
            waiting.extend(parts.into_iter().map(|block| (block, kind)));
        }
        if matches!(purpose, Purpose::Still | Purpose::Pass) {
            // What is looked at most first.
            let middle = (size.0 / 2, size.1 / 2);
            waiting.make_contiguous().sort_by_key(|(b, _)| {
                let away = |at: usize, length: usize, middle: usize| {
                    (at + length / 2).abs_diff(middle).pow(2)
                };
                away(b.x, b.width, middle.0) + away(b.y, b.height, middle.1)
            });
        }
        Self {
            number,
            revision,
            purpose,
            size,
            samples,
            started: f64::NAN,
            content,
            waiting,
            outstanding: 0,
        }
    }

    /// Hands out the next block.
    pub fn next(&mut self, now: f64) -> Option<DrawRequest> {
        let (block, kind) = self.waiting.pop_front()?;
        self.outstanding += 1;
        if self.started.is_nan() {
            self.started = now;
        }
        Some(DrawRequest {
            frame: self.number,
            u: self.content.camera.u.to_array(),
            rotation: self.content.camera.rotation.to_array(),
            fov: self.content.fov,
            size: self.size,
            block,
            margin: match self.purpose {
                Purpose::Moving | Purpose::Pass => 0,
                Purpose::Still | Purpose::Capture => MARGIN,
            },
            samples: self.samples,
            kind,
            each: self.purpose != Purpose::Moving,
            pass: self.content.pass,
        })
    }

    /// Returns the number of blocks that have not come back yet.
    pub fn left(&self) -> usize {
        self.waiting.len() + self.outstanding
    }

    /// Takes note that a block has come back; tells whether it was the last.
    pub fn returned(&mut self) -> bool {
        self.outstanding = self.outstanding.saturating_sub(1);
        self.outstanding == 0 && self.waiting.is_empty()
    }
}

/// Returns the sides of the blocks of a picture for this purpose, with so many samples of pixels that may take long; `None`
/// for one that is divided into bands.
fn still_block(
    purpose: Purpose,
    slow: bool,
    samples: u16,
    workers: usize,
) -> Option<(usize, usize)> {
    let fine = samples > FEW_SAMPLES;
    match purpose {
        Purpose::Moving => None,
        Purpose::Still | Purpose::Capture if slow => Some(SLOW_BLOCKS[usize::from(fine)]),
        Purpose::Still | Purpose::Capture if fine => Some(FINE_BLOCK),
        Purpose::Still | Purpose::Capture => Some(STILL_BLOCK),
        // One worker with all threads takes blocks that are worth dividing.
        Purpose::Pass if workers == 1 => Some(STILL_BLOCK),
        Purpose::Pass => Some(PASS_BLOCK),
    }
}

/// Divides `area` into bands of whole tiles, one for each worker as far as there are tiles.
fn bands(area: Block, workers: usize) -> Vec<Block> {
    let tiles = area.height.div_ceil(LARGEST_TILE);
    let workers = workers.clamp(1, tiles.max(1));
    let row = |k: usize| (k * tiles / workers * LARGEST_TILE).min(area.height);
    (0..workers)
        .map(|k| Block {
            y: area.y + row(k),
            height: row(k + 1) - row(k),
            ..area
        })
        .filter(|band| band.height > 0)
        .collect()
}

/// Divides `area` into blocks of these sides.
fn blocks(area: Block, (width, height): (usize, usize)) -> Vec<Block> {
    let mut blocks = Vec::new();
    for y in (0..area.height).step_by(height) {
        for x in (0..area.width).step_by(width) {
            blocks.push(Block {
                x: area.x + x,
                y: area.y + y,
                width: width.min(area.width - x),
                height: height.min(area.height - y),
            });
        }
    }
    blocks
}

/// A picture that is saved.
#[derive(Debug)]
pub(crate) struct Capture {
    plan: FramePlan,
    /// Its exposure in stops; `None` of linear light.
    stops: Option<f64>,
    blocks: usize,
    /// The last block that was handed out was its own.
    had_turn: bool,
}

impl Capture {
    /// Saves the picture of `plan` at this exposure in stops, or its linear light.
    pub fn new(plan: FramePlan, stops: Option<f64>) -> Self {
        Self {
            blocks: plan.left(),
            plan,
            stops,
            had_turn: false,
        }
    }

    /// Plans the same picture again, under these numbers of a frame and of a state.
    pub fn anew(&self, numbers: (u32, u64)) -> Self {
        let FramePlan {
            purpose,
            content,
            size,
            samples,
            ..
        } = self.plan;
        let plan = FramePlan::new(numbers, purpose, content, (size, samples), 1);
        Self::new(plan, self.stops)
    }

    /// Has none of its blocks drawn.
    pub fn skip(&mut self) {
        self.plan.waiting.clear();
    }

    /// Returns the number of its frame.
    pub fn number(&self) -> u32 {
        self.plan.number
    }

    /// Returns its camera.
    pub fn camera(&self) -> &Camera {
        &self.plan.content.camera
    }

    /// Tells in words how far it is.
    pub fn progress(&self) -> String {
        let done = self.blocks - self.plan.left();
        format!("saving a picture: {done} of {} parts", self.blocks)
    }

    /// Tells whether its next block comes before one of the display.
    fn takes_turn(&mut self) -> bool {
        self.had_turn = !self.had_turn;
        self.had_turn
    }
}

impl Session {
    /// Returns the next block of the saved picture, where it is its turn.
    pub(crate) fn captured_in_turn(&mut self, now: f64) -> Option<DrawRequest> {
        let capture = self.capture.as_mut()?;
        capture.takes_turn().then(|| capture.plan.next(now))?
    }

    /// Returns the next block of the saved picture.
    pub(crate) fn next_captured(&mut self, now: f64) -> Option<DrawRequest> {
        self.capture.as_mut()?.plan.next(now)
    }

    /// Hands a block of the saved picture on.
    pub(crate) fn accept_captured(&mut self, block: Block, rgb: &[f32]) {
        let Some(mut capture) = self.capture.take() else {
            return;
        };
        let last = capture.plan.returned();
        let frame = (capture.plan.number, capture.plan.size);
        let form = (last, capture.stops);
        let patch = self.shown.captured(frame, block, rgb, form);
        self.patches.push(patch);
        self.capture = Some(capture).filter(|_| !last);
    }

    /// Gives the saved picture up, if there is one, for a reason in words.
    pub(crate) fn give_capture_up(&mut self, reason: &str) {
        if self.capture.take().is_some() {
            self.hint = Some(format!("the saved picture was given up{reason}"));
        }
    }

    /// Begins the saved picture anew, if there is one, because the scene has changed: it would be of two states. Its
    /// camera may be nowhere in the present space; then it is given up.
    pub(crate) fn begin_capture_anew(&mut self) {
        let Some(capture) = &self.capture else {
            return;
        };
        if check_start(&self.space.manifold, "the camera", capture.camera().u).is_err() {
            self.give_capture_up(": its camera is outside the changed space");
            return;
        }
        self.number += 1;
        self.capture = Some(capture.anew((self.number, self.revision)));
        self.hint = Some("the saved picture begins anew: the scene has changed".into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn plan(purpose: Purpose, size: (usize, usize), split: bool, workers: usize) -> FramePlan {
        let content = FrameContent {
            camera: Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z),
            fov: 90.0,
            kind: PictureKind::Table,
            split: split.then_some(PictureKind::Exact),
            pass: None,
            slow: split,
        };
        FramePlan::new((1, 1), purpose, content, (size, 1), workers)
    }

    #[test]
    fn blocks_cover_every_pixel_once_in_the_way_of_its_half() {
        for purpose in [
            Purpose::Moving,
            Purpose::Still,
            Purpose::Pass,
            Purpose::Capture,
        ] {
            for (size, split, workers) in [
                ((640, 360), false, 1),
                ((641, 359), true, 3),
                ((1, 1), true, 8),
            ] {
                let mut plan = plan(purpose, size, split, workers);
                let mut times = vec![0; size.0 * size.1];
                while let Some(request) = plan.next(0.0) {
                    let b = request.block;
                    for (y, x) in (b.y..b.y + b.height)
                        .flat_map(|y| (b.x..b.x + b.width).map(move |x| (y, x)))
                    {
                        times[y * size.0 + x] += 1;
                        let right = split && x >= size.0 / 2;
                        assert_eq!(request.kind == PictureKind::Exact, right);
                    }
                }
                assert!(times.iter().all(|n| *n == 1), "{purpose:?} {size:?}");
            }
        }
    }

    #[test]
    fn a_frame_is_whole_when_its_last_block_is_back() {
        let mut plan = plan(Purpose::Moving, (640, 360), false, 2);
        assert!(plan.next(1.0).is_some() && plan.next(2.0).is_some() && plan.next(3.0).is_none());
        assert_eq!(plan.started, 1.0);
        assert!(!plan.returned());
        assert!(plan.returned());
    }

    #[test]
    fn still_blocks_do_not_depend_on_the_workers() {
        let all = |workers: usize| {
            let mut plan = plan(Purpose::Still, (1280, 720), false, workers);
            std::iter::from_fn(move || plan.next(0.0)).collect::<Vec<_>>()
        };
        assert_eq!(all(1), all(7));
    }
}
