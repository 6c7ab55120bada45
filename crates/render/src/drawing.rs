//! A whole picture: paths, colours, pixels.
//!
//! In: a world, a view, how paths are made, how many samples, and a clock. Out: a [`Drawing`]. Samples are
//! taken in passes, so that memory does not grow with their number.

use super::{
<<<<<<< HEAD:crates/render/src/drawing.rs
    filter::Film,
    frame::{Clock, Outcomes, Paths, Work, offsets, trace_timed},
    picture::Picture,
    shade::{Footprints, shade},
    tiles::SamplePlace,
=======
    behind::Behind,
    film::Film,
    frame::{Outcomes, Paths, Work, offsets, trace},
    picture::Picture,
    shade::{Footprints, shade},
    tiles::{Place, Samples},
>>>>>>> 95ae3cb (Meshes as programs export them: OBJ, MTL, PLY and glTF; opacity in every tracer):src/render/drawing.rs
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
<<<<<<< HEAD:crates/render/src/drawing.rs
        let middle = clock();
        let colours = shade(world, view, traced.outcomes.view(), samples, footprints);
        film.add(colours, offsets);
        times[0] += middle.saturating_sub(began);
        times[1] += clock().saturating_sub(middle);
=======
        let middle = Instant::now();
        let mut colours = shade(world, view, traced.outcomes.view(), samples, footprints);
        let shaded = Instant::now();
        let behind = Behind {
            samples: Samples {
                world,
                view,
                offsets,
            },
            paths,
            of_pixel: samples,
            footprints,
        };
        behind.show(traced.outcomes.view(), &mut colours);
        let shown = Instant::now();
        film.add(colours, offsets);
        times[0] += (middle - began) + (shown - shaded);
        times[1] += (shaded - middle) + shown.elapsed();
>>>>>>> 95ae3cb (Meshes as programs export them: OBJ, MTL, PLY and glTF; opacity in every tracer):src/render/drawing.rs
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
