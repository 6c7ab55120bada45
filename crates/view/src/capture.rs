//! A picture that is saved, while it is drawn.
//!
//! In: what was asked for, at the moment of asking: camera, kind, exposure. Out: its blocks, in turns with those of the
//! display, and how far it is. It shows one state only: when the scene changes it is given up, with a hint.

use crate::{
    frame_plan::{Block, FramePlan},
    protocol::DrawRequest,
    session::Session,
};

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

    /// Returns the number of its frame.
    pub fn number(&self) -> u32 {
        self.plan.number
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
}

/// The reason that a saved picture would be of two states.
pub(crate) const SCENE_HAS_CHANGED: &str = ": the scene has changed";
