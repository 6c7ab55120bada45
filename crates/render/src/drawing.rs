//! A whole picture: where its paths come from, colours, pixels.
//!
//! In: a world, a view, how paths are made, how many samples, and a clock. Out: a [`Drawing`]. Samples are
//! taken in passes, so that memory does not grow with their number.
//!
//! In: a choice ([`PathSource`]) and [`DrawingOptions`]. Out: a [`Drawing`], its picture with the layers of an EXR
//! file, and the paths that were not followed far enough ([`UnfinishedPaths`]): of samples that see nothing for that
//! reason, with the length with which they would see something where the scene has no sky for them.
//!
//! Where rays do not start at the camera ([`View::is_central`]), each path comes from a fan of its own. That takes a
//! contraction of the table for every path, which only a lattice makes few enough; the paths are kept on finer knots,
//! because no fan is there any more when they are refined.

use super::{
    endings::EventLocator,
    filter::Film,
    frame::{Clock, FrameStatistics, Outcomes, Paths, Watch, offsets, trace_watched, unwatched},
    intersect::{Seen, SeenBehind, first_seen},
    lookup::{Lookup, ending},
    panels::{Part, PicturePanel, PicturePanels},
    path_batch::{PathBatch, PathOrigin, PathView},
    picture::Picture,
    redshift::shift_colours,
    shade::{Footprints, shade, with_layers},
    starts::starts,
    tiles::{PixelSamples, SamplePlace},
    tracer::{ExactTracer, GridTracer, even_knots},
    view::{Optics, View},
    world::World,
};
use geofan_bundle::{Bundle, Fan};
use geofan_core::{
    error::Result,
    geodesic::{Ray, UnfinishedPaths},
    parallel::*,
};
use glam::{DVec2, DVec3};
use ndarray::s;
use std::{sync::Arc, time::Duration};

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

    /// Cuts it to these columns and rows.
    fn within(mut self, (columns, rows): &Part) -> Self {
        let part = s![rows.clone(), columns.clone(), ..];
        self.picture = Picture::new(self.picture.rgb.slice(part).to_owned());
        self.outcomes = self.outcomes.slice(part).to_owned();
        let inside = |(y, x, _): &SamplePlace| rows.contains(y) && columns.contains(x);
        self.flagged.retain(inside);
        for (y, x, _) in &mut self.flagged {
            (*y, *x) = (*y - rows.start, *x - columns.start);
        }
        self
    }
}

/// Pixels around a part of a picture that are drawn with it and then cut off, so that it is the same as in the whole: the
/// pixel filter reaches one and a half, and how much a sample shows is measured to the next.
const MARGIN: usize = 3;

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
    draw_watched(world, view, paths, samples, footprints, (clock, &unwatched))
}

/// Does so and tells `watch`; what it draws is worth nothing if that ends it.
fn draw_watched(
    world: &World,
    view: &View,
    paths: Paths<'_>,
    samples: usize,
    footprints: Footprints,
    (clock, watch): (Clock<'_>, Watch<'_>),
) -> Drawing {
    let all = offsets(samples);
    let mut film = Film::new(view.size, samples);
    let mut first = None;
    let mut work = FrameStatistics::default();
    let mut times = [Duration::ZERO; 2];
    for offsets in all.chunks(PASS) {
        if first.is_some() && !watch(0) {
            break;
        }
        let began = clock();
        let mut traced = trace_watched(world, view, paths, offsets, (clock, watch));
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

/// Says how finely to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrawingOptions {
    /// Samples for each pixel.
    pub samples: usize,
    /// Largest error of interpolation between looked-up paths, mrad.
    pub error: f64,
    /// Local tolerance of the exact tracer, radians.
    pub tolerance: f64,
    /// Set if the picture is to have the layers of an EXR file.
    pub layers: bool,
}

/// A picture of all parts, and what it took: the share of samples that the table gave up on, and seconds.
#[derive(Default)]
pub struct DrawnPanels {
    /// The picture, put together.
    pub picture: Picture,
    /// What the samples of each part see.
    pub parts: Vec<(View, Outcomes)>,
    /// True if there is anything at the end of any path.
    pub shows: bool,
    /// Share of the samples that the table gave up on.
    pub flagged: f64,
    /// Fixing the cameras.
    pub contract: f64,
    /// Paths and what they meet.
    pub paths: f64,
    /// Colours and pixels.
    pub shade: f64,
}

/// Names where paths come from.
pub enum PathSource<'b> {
    /// A table.
    Table(Lookup<'b>),
    /// Integration over a length.
    Exact(f64),
    /// Straight lines of the chart over a length.
    Local(f64),
}

impl<'b> PathSource<'b> {
    /// Takes paths from `bundle`; those that it gives up on are integrated at `tolerance`.
    pub fn table(bundle: &'b Bundle, tolerance: f64) -> Self {
        Self::Table(Lookup::new(&bundle.table, bundle.promise(), tolerance))
    }

    /// Follows paths of a table in a glued space over `length`, by looking them up again where the table's end.
    #[must_use]
    pub fn continued(self, length: f64) -> Self {
        match self {
            Self::Table(lookup) => Self::Table(lookup.continued(length)),
            other => other,
        }
    }

    /// Names the tracer.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Table(_) => "table",
            Self::Exact(_) => "exact",
            Self::Local(_) => "local",
        }
    }

    /// Finds which of its paths end by their length, and which length would do; of straight lines only the
    /// first, as no length of theirs tells about light.
    pub fn ends(
        &self,
        world: &World,
        parts: &[(View, Outcomes)],
        tolerance: f64,
    ) -> UnfinishedPaths {
        let length = match self {
            Self::Table(lookup) => lookup.length(),
            Self::Exact(length) => *length,
            Self::Local(_) => return count_unfinished(parts.iter().map(|(_, seen)| seen)),
        };
        unfinished(world, parts, (length, tolerance))
    }

    /// Draws the picture of one view; returns it with the time that fixing the camera took. `kept` is the fan
    /// of the view before, if there is one, and then of this one.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn draw(
        &self,
        world: &World,
        view: &View,
        options: DrawingOptions,
        (kept, clock): (&mut Option<(DVec3, Fan)>, Clock<'_>),
    ) -> Result<(Drawing, Duration)> {
        self.draw_watched(world, view, options, (kept, clock, &unwatched))
    }

    /// Does so and tells `watch`; what it draws is worth nothing if that ends it.
    fn draw_watched(
        &self,
        world: &World,
        view: &View,
        options: DrawingOptions,
        (kept, clock, watch): (&mut Option<(DVec3, Fan)>, Clock<'_>, Watch<'_>),
    ) -> Result<(Drawing, Duration)> {
        let (samples, budget) = (options.samples, 1e-3 * options.error);
        let by = |paths: Paths<'_>| {
            let watched = (clock, watch);
            draw_watched(world, view, paths, samples, Footprints::Filtered, watched)
        };
        match self {
            Self::Table(lookup) if !view.is_central() => {
                // Of all places only the camera's own can be asked for; where a ray starts outside the
                // table's region it is integrated.
                lookup.table.space.place(view.u)?;
                let tracer = ShiftedTracer::new(lookup, view);
                Ok((by(Paths::Lattice(&tracer, budget)), Duration::ZERO))
            }
            Self::Table(lookup) => {
                let began = clock();
                let fan = match kept.take() {
                    Some((u, fan)) if u == view.u => fan,
                    _ => lookup.table.fan(view.u)?,
                };
                fan.prepare(&view.spread());
                let contract = clock().saturating_sub(began);
                let drawing = by(Paths::Lattice(&lookup.tracer(&fan), budget));
                *kept = Some((view.u, fan));
                Ok((drawing, contract))
            }
            Self::Local(length) => Ok((by(Paths::Straight(*length)), Duration::ZERO)),
            Self::Exact(length) => {
                let tolerance = options.tolerance;
                let tracer = ExactTracer::new(&world.manifold, view.u, *length, tolerance);
                Ok((by(Paths::Exact(&tracer)), Duration::ZERO))
            }
        }
    }

    /// Draws the picture of all parts.
    ///
    /// # Errors
    /// As of [`PathSource::draw`].
    pub fn draw_panels(
        &self,
        world: &World,
        panels: &PicturePanels,
        options: DrawingOptions,
        clock: Clock<'_>,
    ) -> Result<DrawnPanels> {
        self.draw_panels_watched(world, panels, options, (clock, &unwatched))
    }

    /// Does so and tells `watch`; what it draws is worth nothing if that ends it.
    ///
    /// # Errors
    /// As of [`PathSource::draw`].
    pub fn draw_panels_watched(
        &self,
        world: &World,
        panels: &PicturePanels,
        options: DrawingOptions,
        (clock, watch): (Clock<'_>, Watch<'_>),
    ) -> Result<DrawnPanels> {
        let mut drawn = DrawnPanels::default();
        let (mut pictures, mut fan, mut samples) = (Vec::new(), None, 0);
        for PicturePanel { view, .. } in &panels.parts {
            let (wide, part) = view.widened(MARGIN);
            let (drawing, contract) =
                self.draw_watched(world, &wide, options, (&mut fan, clock, watch))?;
            if !watch(0) {
                return Ok(drawn);
            }
            let drawing = match wide.size == view.size {
                true => drawing,
                false => drawing.within(&part),
            };
            drawn.contract += contract.as_secs_f64();
            drawn.paths += drawing.paths.as_secs_f64();
            drawn.shade += drawing.shade.as_secs_f64();
            drawn.flagged += drawing.flagged.len() as f64;
            samples += drawing.outcomes.len();
            drawn.shows |= drawing.outcomes.iter().any(|seen| world.shows(seen));
            pictures.push(match options.layers {
                true => {
                    let seen = (&drawing.outcomes, &drawing.flagged[..]);
                    with_layers(drawing.picture, world, view, seen, options.tolerance)
                }
                false => drawing.picture,
            });
            drawn.parts.push((view.clone(), drawing.outcomes));
        }
        drawn.flagged /= samples as f64;
        drawn.picture = panels.join(pictures);
        Ok(drawn)
    }
}

/// Looks up each path from where it starts.
pub struct ShiftedTracer<'f, 't> {
    lookup: &'f Lookup<'t>,
    view: &'f View,
    knots: Arc<[f64]>,
    exact: ExactTracer<'f>,
}

/// Knots for each of those of a table's paths: cubics between them then miss by less than chords may, as
/// their error falls with the fourth power.
const FINER: usize = 4;

impl<'f, 't> ShiftedTracer<'f, 't> {
    /// Makes the tracer of one picture.
    pub fn new(lookup: &'f Lookup<'t>, view: &'f View) -> Self {
        let intervals = FINER * (lookup.knots().len() - 1);
        Self {
            lookup,
            view,
            knots: even_knots(lookup.table.length, intervals),
            exact: lookup.exact(view.u),
        }
    }
}

impl GridTracer for ShiftedTracer<'_, '_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    /// Adds the paths of points of the picture (see [`View::address`]). Those that start outside the table's
    /// region, or outside the space, are not given, nor those that meet an edge of the metric between knots.
    fn add(&self, addresses: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        let table = self.lookup.table;
        let manifold = table.space.manifold();
        let points = addresses.iter().map(|at| DVec2::new(at.x, at.y));
        batch.reserve(addresses.len());
        for (address, start) in addresses.iter().zip(starts(manifold, self.view, points)) {
            let source = (*address, PathOrigin::Knots);
            let known = start.and_then(|start| Some((start, table.fan(start.u).ok()?)));
            let path = known.as_ref().map(|(start, fan)| fan.path(start.direction));
            match path.filter(|path| !self.lookup.meets_edge(path)) {
                Some(path) => {
                    let fill = |knots: &[f64], rows: &mut [f64]| path.sample_into(knots, rows);
                    batch.push(source, fill, |view| ending(&path, view, events));
                }
                None => batch.push(source, |_, _| 0, |_| None),
            }
        }
    }

    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        path.sample(s, rows);
    }

    fn slack(&self) -> f64 {
        self.lookup.slack() / FINER.pow(4) as f64
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }

    fn restarts(&self) -> Option<&Lookup<'_>> {
        self.lookup.restarts()
    }
}

/// Counts the samples whose paths end by their length or where the metric ends; those without a path do not
/// count.
pub fn count_unfinished<'o>(outcomes: impl IntoIterator<Item = &'o Outcomes>) -> UnfinishedPaths {
    let (mut by_length, mut singular, mut all) = (0, 0, 0);
    for seen in outcomes.into_iter().flatten() {
        by_length += usize::from(*seen == Seen::Length);
        singular += usize::from(*seen == Seen::Singular);
        all += usize::from(*seen != Seen::Nothing);
    }
    UnfinishedPaths::counted(by_length, singular, all)
}

/// Paths followed farther by one thread at a time: two fillings of the integrator's lanes.
const BLOCK: usize = 64;

/// Counts the samples likewise, and finds the length that would do by following some of them farther than
/// `length`, exactly at a local `tolerance`, if the scene has no sky for them. The outcomes of each part of the
/// picture are of the first samples of each pixel, out of any number.
pub fn unfinished(
    world: &World,
    parts: &[(View, Outcomes)],
    (length, tolerance): (f64, f64),
) -> UnfinishedPaths {
    let counted = count_unfinished(parts.iter().map(|(_, outcomes)| outcomes));
    if world.has_length_sky() {
        return counted;
    }
    counted.followed(length, |length| {
        let ray = |(u, v): (DVec3, DVec3)| (Ray::without_spread(u, v, length), 0.0);
        let sampled = sampled_starts(world, parts).into_iter().map(ray);
        let rays: Vec<(Ray, f64)> = sampled.collect();
        let seen = rays
            .par_chunks(BLOCK)
            .flat_map_iter(|rays| first_seen(world, rays, tolerance));
        let end = |seen: Seen| match seen {
            Seen::Surface(hit) => Some(f64::from(hit.s)),
            Seen::Sky { s, .. } => Some(f64::from(s)),
            Seen::Nothing | Seen::Length | Seen::Singular => None,
        };
        seen.map(end).collect()
    })
}

/// Finds the starts (chart point, tangent) of some of the samples that end by length, evenly.
fn sampled_starts(world: &World, parts: &[(View, Outcomes)]) -> Vec<(DVec3, DVec3)> {
    let places = parts.iter().enumerate().flat_map(|(part, (_, outcomes))| {
        let by_length = outcomes.indexed_iter();
        let by_length = by_length.filter(|(_, seen)| **seen == Seen::Length);
        by_length.map(move |(place, _)| (part, place))
    });
    let places: Vec<_> = places.collect();
    let sample = UnfinishedPaths::sample(&places);
    let in_part = |(part, (view, outcomes)): (usize, &(View, Outcomes))| {
        let offsets = offsets(outcomes.dim().2);
        let own = sample.iter().filter(|(of, _)| *of == part);
        let points = own.map(|(_, (y, x, k))| DVec2::new(*x as f64, *y as f64) + offsets[*k]);
        starts(&world.manifold, view, points)
    };
    let found = parts.iter().enumerate().flat_map(in_part).flatten();
    found.map(|start| (start.u, start.v)).collect()
}
