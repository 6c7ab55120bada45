//! The chunks of one plan, baked in parallel.
//!
//! In: a space, its plan, and the files of chunks that are finished already. Out: all chunks in order, or
//! none when stopped. Every chunk has a [`RefinementTally`] of its own, so the number of rays a chunk took
//! is as reproducible as the chunk.

use crate::{
    attempts::{BakeOptions, SizeSoFar},
    chunk_files::{BakedChunk, ChunkFiles},
    refine::{RefinementTally, Refiner, WorkCounts},
};
use geofan_bundle::{Division, PlanRecord, Table, container::Id, rays::RaySpace};
use geofan_core::{Observer, Progress, Result};
use std::{
    sync::{
        OnceLock,
        atomic::{AtomicUsize, Ordering::Relaxed},
        mpsc::{self, RecvTimeoutError},
    },
    time::{Duration, Instant},
};

/// Time between two looks at the progress: long enough to cost nothing, short enough for a signal.
const TICK: Duration = Duration::from_millis(100);

/// Share by which patches may take more bytes when each is coded by itself than they do in their chunk: Schwarzschild's
/// table takes a hundredth more. Chosen, not measured: too little gives tables up that fit, too much only costs time.
const OVERESTIMATE: f64 = 0.1;

/// Steps of the progress bar.
const PARTS_OF_VOLUME: u64 = 1000;

/// The largest share of unfinished work that is told.
const MOST_UNFINISHED: f64 = 0.9999;

/// Bakes the chunks of one plan, or a share of them.
pub struct ChunkBaker<'a> {
    /// The bundle's id.
    pub id: Id,
    space: &'a RaySpace,
    plan: &'a PlanRecord,
    division: Division,
    /// Numbers of the chunks, and what is counted of each.
    chunks: Vec<u32>,
    tallies: Vec<RefinementTally<'static>>,
    options: &'a BakeOptions,
    /// What there was when patches took too many bytes.
    excess: OnceLock<SizeSoFar>,
}

impl<'a> ChunkBaker<'a> {
    /// Prepares to bake the chunks of the bundle `id`: those of the options' share, up to their size.
    pub fn new(
        space: &'a RaySpace,
        plan: &'a PlanRecord,
        id: Id,
        options: &'a BakeOptions,
    ) -> Self {
        let division = plan.division(space);
        let all = 0..division.chunks() as u32;
        let chunks: Vec<u32> = all
            .filter(|c| options.share.is_none_or(|share| share.has(*c)))
            .collect();
        Self {
            id,
            space,
            plan,
            division,
            tallies: chunks.iter().map(|_| RefinementTally::default()).collect(),
            chunks,
            options,
            excess: OnceLock::new(),
        }
    }

    /// Bakes the chunks that `files` does not hold yet; `None` if the observer or the size stopped it.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn run(
        &self,
        files: &ChunkFiles,
        observer: &dyn Observer,
    ) -> Result<Option<Vec<(u32, BakedChunk)>>> {
        let baked = std::thread::scope(|scope| {
            let (working, ended) = mpsc::channel::<()>();
            scope.spawn(move || self.watch(&ended, observer));
            let baked = self.all_chunks(files);
            drop(working);
            baked
        })?;
        let numbers = self.chunks.iter().copied();
        let baked = baked
            .into_iter()
            .zip(numbers)
            .map(|(baked, chunk)| Some((chunk, baked?)));
        Ok(baked.collect())
    }

    /// Bakes chunk by chunk, as many at once as there are threads; `None` for those not finished.
    fn all_chunks(&self, files: &ChunkFiles) -> Result<Vec<Option<BakedChunk>>> {
        // One waiting thread for each working one, so that only so many chunks are under way. Work itself is in the pool.
        let next = AtomicUsize::new(0);
        let count = self.chunks.len();
        let results: Vec<OnceLock<Result<Option<BakedChunk>>>> =
            self.chunks.iter().map(|_| OnceLock::new()).collect();
        let take_chunks = || {
            while let Some(k) = Some(next.fetch_add(1, Relaxed)).filter(|k| *k < count) {
                let (baked, ()) = rayon::join(|| self.chunk(k, files), || ());
                if baked.is_err() {
                    self.stop();
                }
                let _ = results[k].set(baked);
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..rayon::current_num_threads().min(count) {
                scope.spawn(take_chunks);
            }
        });
        let results = results.into_iter().map(OnceLock::into_inner);
        results.map(|result| result.unwrap_or(Ok(None))).collect()
    }

    /// Returns the chunk at position `k` from its file, or bakes it; `None` if told to stop.
    fn chunk(&self, k: usize, files: &ChunkFiles) -> Result<Option<BakedChunk>> {
        let (chunk, tally) = (self.chunks[k], &self.tallies[k]);
        // Reading it again takes as long as decoding it twice.
        if !tally.stop().goes_on(0) {
            return Ok(None);
        }
        let shape = Table::tensor_shape(self.space, self.plan.mapping);
        if let Some(baked) = files.load(chunk, self.id, shape) {
            tally.add(WorkCounts {
                volume: self.chunk_volume() as u64,
                bytes: baked.tree.len() as u64,
                ..WorkCounts::default()
            });
            return Ok(Some(baked));
        }
        let log = files.decisions(chunk, self.id, shape)?;
        let refiner = Refiner {
            space: self.space,
            plan: self.plan,
            division: &self.division,
            tally,
            flagged: self.options.flagged,
            log: Some(&log),
        };
        let Some(tree) = refiner.chunk(chunk as usize) else {
            return Ok(None);
        };
        let baked = BakedChunk {
            tree: tree.encode(),
            rays: tally.counts().rays,
        };
        tally.settle(baked.tree.len() as u64);
        files.store(chunk, self.id, &baked)?;
        Ok(Some(baked))
    }

    /// Tells all chunks to stop.
    fn stop(&self) {
        self.tallies.iter().for_each(|t| t.stop().tell());
    }

    /// Returns the volume of a chunk in the units of [`WorkCounts::volume`].
    fn chunk_volume(&self) -> f64 {
        f64::from(u32::MAX) / self.division.chunks() as f64
    }

    /// Sums up one count over all chunks.
    fn sum(&self, count: impl Fn(WorkCounts) -> u64) -> u64 {
        self.tallies.iter().map(|t| count(t.counts())).sum()
    }

    /// Returns the bytes of the patches so far.
    fn bytes(&self) -> u64 {
        self.sum(|counts| counts.bytes)
    }

    /// Returns the bytes that the patches so far take at least.
    fn least_bytes(&self) -> u64 {
        ((1.0 - OVERESTIMATE) * self.bytes() as f64) as u64
    }

    /// Returns what there was when too many bytes were the reason to stop.
    pub fn excess(&self) -> Option<SizeSoFar> {
        self.excess.get().copied()
    }

    /// Returns the share that is done where of each chunk so much is `wanted`, 1 for all.
    fn share_done(&self, wanted: f64) -> f64 {
        let volume = wanted * self.chunk_volume();
        let of_chunk = |counts: WorkCounts| (counts.volume as f64 / volume).min(1.0);
        let shares = self.tallies.iter().map(|tally| of_chunk(tally.counts()));
        shares.sum::<f64>() / self.tallies.len() as f64
    }

    /// Tells progress, and stops the work when the user asks or the limit is reached, until the
    /// other side of `ended` is dropped.
    fn watch(&self, ended: &mpsc::Receiver<()>, observer: &dyn Observer) {
        let started = Instant::now();
        while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(TICK) {
            let (bytes, share) = (self.least_bytes(), self.share_done(1.0));
            let are_too_many = self.options.max_size.is_some_and(|most| bytes > most);
            if are_too_many {
                // The first such look: the work goes on for a while after it.
                self.excess.get_or_init(|| SizeSoFar { bytes, share });
            }
            if observer.cancelled() || are_too_many {
                self.stop();
            }
            self.tell(false, started, observer);
        }
        let is_whole = self.tallies.iter().all(|tally| tally.stop().goes_on(0));
        self.tell(is_whole, started, observer);
    }

    /// Tells how much is done of what is wanted: of each chunk all but what may be flagged in the end.
    fn tell(&self, is_whole: bool, started: Instant, observer: &dyn Observer) {
        let wanted = 1.0 - self.options.flagged.unwrap_or(0.0);
        let share = match is_whole {
            true => 1.0,
            // Boxes of one size are decided together, and until all of them are the work goes on.
            false => self.share_done(wanted).min(MOST_UNFINISHED),
        };
        let rays = self.sum(|counts| counts.rays) as f64;
        let kilorays = rays / 1e3 / started.elapsed().as_secs_f64();
        let (patches, kilobytes) = (self.sum(|counts| counts.patches), self.bytes() as f64 / 1e3);
        observer.progress(Progress {
            work: "baking",
            done: (share * PARTS_OF_VOLUME as f64) as u64,
            total: PARTS_OF_VOLUME,
            detail: &format!("{patches} patches, {kilobytes:.0} kB, {kilorays:.0}k rays/s"),
        });
    }
}
