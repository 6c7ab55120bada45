//! A whole picture: paths, colours, pixels.
//!
//! In: a world, a view, how paths are made, and how many samples. Out: a [`Drawing`]. Samples are
//! taken in passes, so that memory does not grow with their number.

use super::{
    film::Film,
    frame::{NOTHING, Outcomes, Paths, Work, offsets, trace},
    picture::Picture,
    shade::{Footprints, shade},
    view::View,
    world::World,
};
use std::time::{Duration, Instant};

/// A picture, and what it took.
pub struct Drawing {
    /// The picture.
    pub picture: Picture,
    /// What the samples of the first pass see.
    pub outcomes: Outcomes,
    /// Work on paths and pixels.
    pub work: Work,
    /// Time for paths and what they meet.
    pub paths: Duration,
    /// Time for colours and pixels.
    pub shade: Duration,
}

/// Samples of one pass: as many as fit one packet.
const PASS: usize = 16;

/// Draws with `samples` for each pixel.
pub fn draw(
    world: &World,
    view: &View,
    paths: Paths<'_>,
    samples: usize,
    footprints: Footprints,
) -> Drawing {
    let all = offsets(samples);
    let mut film = Film::new(view.size, samples);
    let mut first = Outcomes::from_elem((0, 0, 0), NOTHING);
    let mut work = Work::default();
    let mut times = [Duration::ZERO; 2];
    for offsets in all.chunks(PASS) {
        let began = Instant::now();
        let traced = trace(world, view, paths, offsets);
        work += traced.work;
        let middle = Instant::now();
        let colours = shade(world, view, traced.outcomes.view(), samples, footprints);
        film.add(colours, offsets);
        times[0] += middle - began;
        times[1] += middle.elapsed();
        if first.is_empty() {
            first = traced.outcomes;
        }
    }
    let began = Instant::now();
    let picture = film.develop();
    Drawing {
        picture,
        outcomes: first,
        work,
        paths: times[0],
        shade: times[1] + began.elapsed(),
    }
}
