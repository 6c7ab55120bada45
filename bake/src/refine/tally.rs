//! Counting the work of refinement while it runs, and stopping it.

use geofan_core::Stop;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Operations that following a ray takes: some dozens of steps of thousands each.
const RAY: usize = 300_000;

/// Says how much work was done.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct WorkCounts {
    /// Rays integrated.
    pub rays: u64,
    /// Patches finished.
    pub patches: u64,
    /// Bytes of them.
    pub bytes: u64,
    /// Volume finished, in units of 2⁻³² of all chunks.
    pub volume: u64,
}

/// Counts the work of refinement while it runs, and stops it.
#[derive(Debug, Default)]
pub struct RefinementTally<'a> {
    rays: AtomicU64,
    patches: AtomicU64,
    bytes: AtomicU64,
    volume: AtomicU64,
    stop: Stop,
    /// That of the whole chunk, if this is a box's.
    whole: Option<&'a RefinementTally<'a>>,
}

impl RefinementTally<'_> {
    /// Counts the work on a chunk that `stop` ends.
    pub fn new(stop: Stop) -> Self {
        Self {
            stop,
            ..Self::default()
        }
    }

    /// Counts the work on one box by itself; this tally counts it, too.
    pub fn of_box(&self) -> RefinementTally<'_> {
        RefinementTally {
            whole: Some(self),
            ..RefinementTally::default()
        }
    }

    /// Returns what ends the work.
    pub fn stop(&self) -> &Stop {
        self.whole.map_or(&self.stop, RefinementTally::stop)
    }

    /// Counts so many rays that are to be followed together, if the work goes on.
    pub fn go_on(&self, rays: usize) -> bool {
        let goes_on = self.stop().goes_on(rays * RAY);
        if goes_on {
            self.add(WorkCounts {
                rays: rays as u64,
                ..WorkCounts::default()
            });
        }
        goes_on
    }

    /// Adds work that was done.
    pub fn add(&self, counts: WorkCounts) {
        self.rays.fetch_add(counts.rays, Relaxed);
        self.patches.fetch_add(counts.patches, Relaxed);
        self.bytes.fetch_add(counts.bytes, Relaxed);
        self.volume.fetch_add(counts.volume, Relaxed);
        if let Some(whole) = self.whole {
            whole.add(counts);
        }
    }

    /// Returns what was counted so far.
    pub fn counts(&self) -> WorkCounts {
        WorkCounts {
            rays: self.rays.load(Relaxed),
            patches: self.patches.load(Relaxed),
            bytes: self.bytes.load(Relaxed),
            volume: self.volume.load(Relaxed),
        }
    }
}
