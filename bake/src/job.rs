//! The chunks of one plan, baked in parallel with their parts on the disk.
//!
//! In: a [`Job`]. Out: its chunks in order, or why not. Every chunk has a [`Tally`] of its own, so
//! the number of rays a chunk took is as reproducible as the chunk.

use crate::{
    options::Share,
    parts::{Baked, Parts},
    refine::{Refiner, Tally},
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

/// What is to be baked.
#[derive(Debug)]
pub struct Job<'a> {
    /// The rays.
    pub space: &'a RaySpace,
    /// The plan.
    pub plan: &'a PlanRecord,
    /// The bundle's id.
    pub id: Id,
    /// Which chunks; all if `None`.
    pub share: Option<Share>,
    /// Size of the chunks at which to give up.
    pub most_bytes: Option<u64>,
}

/// How baking ended.
#[derive(Debug)]
pub enum Ended {
    /// With all chunks of the job.
    Done(Vec<(u32, Baked)>),
    /// At the size limit: so many bytes were made of this share of the volume.
    TooLarge {
        /// Bytes of the patches so far.
        bytes: u64,
        /// The share of the volume that they cover.
        share: f64,
    },
    /// The user asked for it.
    Interrupted,
}

/// How often progress is looked at: seldom enough to cost nothing, often enough for a signal.
const TICK: Duration = Duration::from_millis(100);

/// Steps of the progress bar.
const PARTS_OF_VOLUME: u64 = 1000;

/// What chunks can be asked while they are baked.
struct Watch<'a> {
    tallies: &'a [Tally],
    most_bytes: u64,
    /// The volume of the job's chunks in the units of [`Tally::volume`].
    volume: f64,
    started: Instant,
}

/// The volume of a chunk in the units of [`Tally::volume`].
fn volume(division: &Division) -> f64 {
    f64::from(u32::MAX) / division.chunks() as f64
}

impl Job<'_> {
    /// Bakes the chunks that `parts` does not hold yet.
    ///
    /// # Errors
    /// A part cannot be written.
    pub fn run(&self, parts: &Parts, observer: &dyn Observer) -> Result<Ended> {
        let division = self.plan.division(self.space);
        let all = division.chunks() as u32;
        let mine = (0..all).filter(|c| self.share.is_none_or(|share| share.has(*c)));
        let mine: Vec<u32> = mine.collect();
        let tallies: Vec<Tally> = mine.iter().map(|_| Tally::default()).collect();
        let unit = volume(&division);
        let watch = Watch {
            tallies: &tallies,
            most_bytes: self.most_bytes.unwrap_or(u64::MAX),
            volume: unit * mine.len() as f64,
            started: Instant::now(),
        };
        let baked = std::thread::scope(|scope| {
            let (working, ended) = mpsc::channel::<()>();
            let watch = &watch;
            scope.spawn(move || watch.until(&ended, observer));
            let baked = self.all_chunks(&mine, &tallies, parts, &division);
            drop(working);
            baked
        })?;
        if baked.iter().all(Option::is_some) {
            let chunks = mine.into_iter().zip(baked.into_iter().flatten());
            return Ok(Ended::Done(chunks.collect()));
        }
        let (bytes, share) = (watch.bytes(), watch.share());
        Ok(match bytes > watch.most_bytes {
            true => Ended::TooLarge { bytes, share },
            false => Ended::Interrupted,
        })
    }

    fn all_chunks(
        &self,
        mine: &[u32],
        tallies: &[Tally],
        parts: &Parts,
        division: &Division,
    ) -> Result<Vec<Option<Baked>>> {
        // One waiting thread for each working one, so that only so many chunks are under way: what
        // they have of unfinished chunks is lost in an interruption. Work itself is in the pool.
        let next = AtomicUsize::new(0);
        let results: Vec<OnceLock<Result<Option<Baked>>>> =
            mine.iter().map(|_| OnceLock::new()).collect();
        let take_chunks = || {
            while let Some(k) = Some(next.fetch_add(1, Relaxed)).filter(|k| *k < mine.len()) {
                let work = || self.chunk(mine[k], &tallies[k], parts, division);
                let (baked, ()) = rayon::join(work, || ());
                if baked.is_err() {
                    stop(tallies);
                }
                let _ = results[k].set(baked);
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..rayon::current_num_threads().min(mine.len()) {
                scope.spawn(take_chunks);
            }
        });
        let results = results.into_iter().map(OnceLock::into_inner);
        results.map(|result| result.unwrap_or(Ok(None))).collect()
    }

    /// The chunk from its part, or baked; `None` if told to stop.
    fn chunk(
        &self,
        chunk: u32,
        tally: &Tally,
        parts: &Parts,
        division: &Division,
    ) -> Result<Option<Baked>> {
        if let Some(baked) = parts.load(chunk, self.id, Table::shape(self.space, self.plan.stretch))
        {
            tally.volume.store(volume(division) as u64, Relaxed);
            tally.bytes.store(baked.tree.len() as u64, Relaxed);
            return Ok(Some(baked));
        }
        let refiner = Refiner {
            space: self.space,
            plan: self.plan,
            division,
            tally,
        };
        let Some(tree) = refiner.chunk(chunk as usize) else {
            return Ok(None);
        };
        let baked = Baked {
            tree: tree.encode(),
            rays: tally.rays.load(Relaxed),
        };
        parts.store(chunk, self.id, &baked)?;
        Ok(Some(baked))
    }
}

fn stop(tallies: &[Tally]) {
    tallies.iter().for_each(|t| t.stop.store(true, Relaxed));
}

impl Watch<'_> {
    fn sum(&self, of: impl Fn(&Tally) -> &AtomicU64) -> u64 {
        self.tallies.iter().map(|t| of(t).load(Relaxed)).sum()
    }

    fn bytes(&self) -> u64 {
        self.sum(|t| &t.bytes)
    }

    fn share(&self) -> f64 {
        (self.sum(|t| &t.volume) as f64 / self.volume).min(1.0)
    }

    /// Tells progress, and stops the work when the user asks or the limit is reached, until the
    /// other side of `ended` is dropped.
    fn until(&self, ended: &mpsc::Receiver<()>, observer: &dyn Observer) {
        while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(TICK) {
            if observer.cancelled() || self.bytes() > self.most_bytes {
                stop(self.tallies);
            }
            self.tell(self.share(), observer);
        }
        self.tell(1.0, observer);
    }

    /// Tells that `share` of the volume is done.
    fn tell(&self, share: f64, observer: &dyn Observer) {
        let rays = self.sum(|t| &t.rays) as f64 / self.started.elapsed().as_secs_f64();
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
