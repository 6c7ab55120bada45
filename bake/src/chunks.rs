//! The chunks of one plan, baked in parallel.
//!
//! In: a space, its plan, and the files of chunks that are finished already. Out: all chunks in order, or
//! none when stopped. Every chunk has a [`RefinementTally`] of its own, so the number of rays a chunk took
//! is as reproducible as the chunk.

use crate::{
    bake::Share,
    chunk_files::{BakedChunk, ChunkFiles},
    refine::{RefinementTally, Refiner},
};
use geofan_bundle::{Division, PlanRecord, Table, container::Id, rays::RaySpace};
use geofan_core::{Observer, Progress, Result};
use std::{
    sync::{
        OnceLock,
        atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed},
        mpsc::{self, RecvTimeoutError},
    },
    time::{Duration, Instant},
};

/// Time between two looks at the progress: long enough to cost nothing, short enough for a signal.
const TICK: Duration = Duration::from_millis(100);

/// Steps of the progress bar.
const PARTS_OF_VOLUME: u64 = 1000;

/// Bakes the chunks of one plan, or a share of them.
pub struct ChunkBaker<'a> {
    /// The bundle's id.
    pub id: Id,
    space: &'a RaySpace,
    plan: &'a PlanRecord,
    division: Division,
    /// Numbers of the chunks, and what is counted of each.
    chunks: Vec<u32>,
    tallies: Vec<RefinementTally>,
    /// Bytes of patches at which to give up.
    most_bytes: u64,
}

impl<'a> ChunkBaker<'a> {
    /// Prepares to bake the chunks of `share`, or all, of the bundle `id`, up to so many bytes.
    pub fn new(
        space: &'a RaySpace,
        plan: &'a PlanRecord,
        id: Id,
        share: Option<Share>,
        most_bytes: Option<u64>,
    ) -> Self {
        let division = plan.division(space);
        let all = 0..division.chunks() as u32;
        let chunks: Vec<u32> = all
            .filter(|c| share.is_none_or(|share| share.has(*c)))
            .collect();
        Self {
            id,
            space,
            plan,
            division,
            tallies: chunks.iter().map(|_| RefinementTally::default()).collect(),
            chunks,
            most_bytes: most_bytes.unwrap_or(u64::MAX),
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
        // One waiting thread for each working one, so that only so many chunks are under way: what
        // they have of unfinished chunks is lost in an interruption. Work itself is in the pool.
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
        if !tally.stop.goes_on(0) {
            return Ok(None);
        }
        let shape = Table::tensor_shape(self.space, self.plan.stretch);
        if let Some(baked) = files.load(chunk, self.id, shape) {
            tally.volume.store(self.chunk_volume() as u64, Relaxed);
            tally.bytes.store(baked.tree.len() as u64, Relaxed);
            return Ok(Some(baked));
        }
        let refiner = Refiner {
            space: self.space,
            plan: self.plan,
            division: &self.division,
            tally,
        };
        let Some(tree) = refiner.chunk(chunk as usize) else {
            return Ok(None);
        };
        let baked = BakedChunk {
            tree: tree.encode(),
            rays: tally.rays.load(Relaxed),
        };
        files.store(chunk, self.id, &baked)?;
        Ok(Some(baked))
    }

    /// Tells all chunks to stop.
    fn stop(&self) {
        self.tallies.iter().for_each(|t| t.stop.tell());
    }

    /// Returns the volume of a chunk in the units of [`RefinementTally::volume`].
    fn chunk_volume(&self) -> f64 {
        f64::from(u32::MAX) / self.division.chunks() as f64
    }

    /// Sums up one count over all chunks.
    fn sum(&self, count: impl Fn(&RefinementTally) -> &AtomicU64) -> u64 {
        self.tallies.iter().map(|t| count(t).load(Relaxed)).sum()
    }

    /// Returns the bytes of the patches so far.
    pub fn bytes(&self) -> u64 {
        self.sum(|t| &t.bytes)
    }

    /// Returns the share of the volume that is done.
    pub fn share_done(&self) -> f64 {
        let volume = self.chunk_volume() * self.chunks.len() as f64;
        (self.sum(|t| &t.volume) as f64 / volume).min(1.0)
    }

    /// Tells progress, and stops the work when the user asks or the limit is reached, until the
    /// other side of `ended` is dropped.
    fn watch(&self, ended: &mpsc::Receiver<()>, observer: &dyn Observer) {
        let started = Instant::now();
        while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(TICK) {
            if observer.cancelled() || self.bytes() > self.most_bytes {
                self.stop();
            }
            self.tell(self.share_done(), started, observer);
        }
        self.tell(1.0, started, observer);
    }

    /// Tells that `share` of the volume is done.
    fn tell(&self, share: f64, started: Instant, observer: &dyn Observer) {
        let rays = self.sum(|t| &t.rays) as f64 / started.elapsed().as_secs_f64();
        let patches = self.sum(|t| &t.patches);
        let (kilorays, kilobytes) = (rays / 1e3, self.bytes() as f64 / 1e3);
        observer.progress(Progress {
            work: "baking",
            done: (share * PARTS_OF_VOLUME as f64) as u64,
            total: PARTS_OF_VOLUME,
            detail: &format!("{patches} patches, {kilobytes:.0} kB, {kilorays:.0}k rays/s"),
        });
    }
}
