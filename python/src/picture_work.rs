//! Long work on a picture, watched: the light of lamps, samples, and passes of the path tracer.
//!
//! In: an observer. Out: it is told how far the work is, and the work ends soon after it says so.

use crate::work;
use geofan_core::{Observer, Progress, Result};
use geofan_light::{
    cache,
    path_tracer::{PanelTracers, PassAccumulator},
};
use geofan_render::Stage;
use std::{
    path::Path,
    sync::atomic::{AtomicU64, AtomicUsize, Ordering},
    time::Instant,
};

/// A scene, and over which length its surfaces are lit.
pub type Staged = (Stage, Option<f64>);

/// Tells an observer how far a picture is.
pub struct PictureWork<'o> {
    done: AtomicU64,
    total: u64,
    observer: &'o dyn Observer,
}

impl<'o> PictureWork<'o> {
    /// Begins with no sample done.
    pub fn new(total: u64, observer: &'o dyn Observer) -> Self {
        Self {
            done: AtomicU64::new(0),
            total,
            observer,
        }
    }

    /// Takes note of more samples; tells whether the work goes on.
    pub fn goes_on(&self, more: usize) -> bool {
        if more > 0 {
            self.tell(more as u64);
        }
        !self.observer.cancelled()
    }

    /// Tells that all is done.
    pub fn end(&self) {
        self.tell(self.total);
    }

    fn tell(&self, more: u64) {
        let before = self.done.fetch_add(more, Ordering::Relaxed);
        // Pixels around a part of a picture are drawn with it and cut off; the end is told once.
        if before < self.total {
            self.observer.progress(Progress {
                work: "picture",
                done: (before + more).min(self.total),
                total: self.total,
                detail: "",
            });
        }
    }
}

/// Lights the surfaces over `length`, unless they are already.
pub fn light_up(staged: &mut Staged, file: Option<&Path>, length: f64, observer: &dyn Observer) {
    if staged.1 == Some(length) {
        return;
    }
    let lit = AtomicUsize::new(0);
    let done = |more: usize, all: usize| {
        work::give_up(observer);
        let done = lit.fetch_add(more, Ordering::Relaxed) + more;
        observer.progress(Progress {
            work: "light",
            done: done as u64,
            total: all as u64,
            detail: "",
        });
    };
    cache::light_up(&mut staged.0.world, file, length, done);
    staged.1 = Some(length);
}

/// Adds so many passes of the path tracer, or as many as so many seconds allow.
pub fn passes(
    tracers: &PanelTracers<'_>,
    size: (usize, usize),
    (count, seconds): (usize, Option<f64>),
    observer: &dyn Observer,
) -> Result<PassAccumulator> {
    let mut film = PassAccumulator::new(size);
    let began = Instant::now();
    for number in 0..count as u64 {
        let Some(pass) = tracers.pass(number, || observer.cancelled()) else {
            return Err(work::interrupted());
        };
        film.add(&pass);
        observer.progress(Progress {
            work: "samples",
            done: number + 1,
            total: count as u64,
            detail: "",
        });
        if seconds.is_some_and(|seconds| began.elapsed().as_secs_f64() >= seconds) {
            break;
        }
    }
    Ok(film)
}
