//! A whole picture: paths, colours, pixels.
//!
//! In: a world, a view, how paths are made, how many samples, and a clock. Out: a [`Drawing`]. Samples are
//! taken in passes, so that memory does not grow with their number.

use super::{
    behind::SeenBehind,
    filter::Film,
    frame::{Clock, Outcomes, Paths, Work, offsets, trace_timed},
    picture::Picture,
    shade::{Footprints, shade},
    tiles::{PixelSamples, SamplePlace},
    view::View,
    world::World,
};
use std::time::Duration;

/// A picture, and what it took.
pub struct Drawing {
    /// The picture.
    pub picture: Picture,
    /// Outcomes of the samples of the first pass.
    pub outcomes: Outcomes,
    /// Those that the table gave up on.
    pub flagged: Vec<SamplePlace>,
    /// Work on paths and pixels.
    pub work: Work,
    /// Time for paths and what they meet.
    pub paths: Duration,
    /// Time for colours and pixels.
    pub shade: Duration,
}

impl Drawing {
    /// Returns the share of the first pass's samples that the table gave up on.
    pub fn flagged_share(&self) -> f64 {
        self.flagged.len() as f64 / self.outcomes.len() as f64
    }
}

/// Samples of one pass: as many as fit one packet.
const PASS: usize = 16;

/// Draws with `samples` for each pixel, and measures times by `clock`.
pub fn draw(
    world: &World,
    view: &View,
    paths: Paths<'_>,
    samples: usize,
    footprints: Footprints,
    clock: Clock<'_>,
) -> Drawing {
    let all = offsets(samples);
    let mut film = Film::new(view.size, samples);
    let mut first = None;
    let mut work = Work::default();
    let mut times = [Duration::ZERO; 2];
    for offsets in all.chunks(PASS) {
        let began = clock();
        let traced = trace_timed(world, view, paths, offsets, clock);
        work += traced.work;
        let middle = clock();
        let mut colours = shade(world, view, traced.outcomes.view(), samples, footprints);
        let shaded = clock();
        let behind = SeenBehind {
            samples: PixelSamples {
                world,
                view,
                offsets,
                clock,
            },
            paths,
            of_pixel: samples,
            footprints,
        };
        behind.show(traced.outcomes.view(), &mut colours);
        let shown = clock();
        film.add(colours, offsets);
        times[0] += middle.saturating_sub(began) + shown.saturating_sub(shaded);
        times[1] += shaded.saturating_sub(middle) + clock().saturating_sub(shown);
        first.get_or_insert((traced.outcomes, traced.flagged));
    }
    let began = clock();
    let picture = film.develop();
    let (outcomes, flagged) = first.unwrap_or_default();
    Drawing {
        picture,
        outcomes,
        flagged,
        work,
        paths: times[0],
        shade: times[1] + clock().saturating_sub(began),
    }
}
