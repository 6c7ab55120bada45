//! A whole picture: paths, colours, pixels.
//!
//! In: a world, a view, how paths are made, how many samples, and a clock. Out: a [`Drawing`]. Samples are
//! taken in passes, so that memory does not grow with their number.

use super::{
    filter::Film,
    frame::{Clock, FrameStatistics, Outcomes, Paths, offsets, trace_timed},
    intersect::{Seen, SeenBehind},
    picture::Picture,
    redshift::shift_colours,
    shade::{Footprints, shade},
    tiles::{PixelSamples, SamplePlace},
    view::{Optics, View},
    world::World,
};
use glam::DVec2;
use ndarray::s;
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
    pub work: FrameStatistics,
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

/// Finds the samples that show nothing.
fn hidden(view: &View, offsets: &[DVec2]) -> Vec<SamplePlace> {
    if !matches!(view.optics(), Optics::Fisheye { .. }) {
        return Vec::new();
    }
    let (width, height) = view.size;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
    let places = pixels.flat_map(|(y, x)| (0..offsets.len()).map(move |k| (y, x, k)));
    let shows = |(y, x, k): &SamplePlace| {
        let at = offsets[*k] + DVec2::new(*x as f64, *y as f64);
        view.shows(at.x, at.y)
    };
    places.filter(|place| !shows(place)).collect()
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
    let mut work = FrameStatistics::default();
    let mut times = [Duration::ZERO; 2];
    for offsets in all.chunks(PASS) {
        let began = clock();
        let mut traced = trace_timed(world, view, paths, offsets, clock);
        work += traced.work;
        let middle = clock();
        let hidden = hidden(view, offsets);
        for place in &hidden {
            traced.outcomes[*place] = Seen::Nothing;
        }
        let mut colours = shade(world, view, traced.outcomes.view(), samples, footprints);
        shift_colours(world, view, &traced.outcomes, offsets, &mut colours);
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
        for (y, x, k) in hidden {
            colours.slice_mut(s![y, x, k, ..]).fill(0.0);
        }
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
