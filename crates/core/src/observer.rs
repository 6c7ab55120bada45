//! Watching long work, and ending it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

/// Tells how far long work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress<'a> {
    /// Name of the work, the same from its first report to its last.
    pub work: &'a str,
    /// Units done so far.
    pub done: u64,
    /// Units in all; `done` reaches it when the work has ended.
    pub total: u64,
    /// Further figures for people; may be empty.
    pub detail: &'a str,
}

/// Watches long work: is told how far it is, and can end it.
pub trait Observer: Sync {
    /// Takes note of how far the work is. Called from any thread, a few times a second at most for
    /// each piece of work that is under way.
    fn progress(&self, progress: Progress<'_>);

    /// Tells whether the work is to end at the next good place.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Passes on the cancelling of another observer and drops progress: for parts of work that reports its progress as a
/// whole.
pub struct Muted<'a>(pub &'a dyn Observer);

impl Observer for Muted<'_> {
    fn progress(&self, _: Progress<'_>) {}

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Stops long work piece by piece. A piece calls [`Stop::goes_on`] before it begins; if that is false, it returns at
/// once with any value, which nobody reads. Calls are counted, which shows how long a stop takes.
#[derive(Debug, Default)]
pub struct Stop {
    told: AtomicBool,
    asked: AtomicU64,
    largest: AtomicU64,
    /// The question at which to end the work; none if 0.
    last: u64,
}

impl Stop {
    /// Ends the work at the question of this number, from 1 on.
    pub fn at_question(last: u64) -> Self {
        Self {
            last,
            ..Self::default()
        }
    }

    /// Ends the work.
    pub fn tell(&self) {
        self.told.store(true, Relaxed);
    }

    /// Tells whether the work is to end.
    pub fn told(&self) -> bool {
        self.told.load(Relaxed)
    }

    /// Tells whether the work goes on, before a piece of so many operations: products, or what takes as long.
    pub fn goes_on(&self, operations: usize) -> bool {
        if self.asked.fetch_add(1, Relaxed) + 1 == self.last {
            self.tell();
        }
        let goes_on = !self.told();
        if goes_on {
            self.largest.fetch_max(operations as u64, Relaxed);
        }
        goes_on
    }

    /// Returns the number of questions, and the most operations of a piece that was begun.
    pub fn counts(&self) -> (u64, u64) {
        (self.asked.load(Relaxed), self.largest.load(Relaxed))
    }
}

/// Lets work run to its end unwatched.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn progress(&self, _: Progress<'_>) {}
}
