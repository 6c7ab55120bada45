//! The tracer that looks paths up in a table, and in a glued space goes on beyond its length.
//!
//! In: a table, once ([`Lookup`]), and the fan of a camera for each frame ([`TableTracer`]). Out:
//! [`PathBatch`] on knots that are the same for all cameras.
//!
//! In: the samples whose paths end by the table's length, and the states that they have there. Out: what they see
//! farther on ([`Lookup::go_on`]). Each part of a path is brought into the domain and has a fan of its own there; the copies
//! of the scene about the domain are those that it meets.

use super::{
    curve::{Cubic, Curve, Ending},
    endings::EventLocator,
    family::{FamilyPath, RayFamily, refine_sixteen},
    frame::Outcomes,
    intersect::{HitSearch, Seen, beyond},
    lanes::{LANES, Vectors},
    path_batch::{PathBatch, PathOrigin, PathView, ROWS, piece_at, stay},
    tiles::{PixelSamples, SamplePlace},
    tracer::{ExactTracer, GridTracer, even_knots, refine_each},
    world::World,
};
use geofan_bundle::{Fan, PathCoefficients, Table, TablePath, rays::Orbit};
use geofan_core::{manifold::Manifold, parallel::*, random::fibonacci_direction};
use glam::DVec3;
use std::{borrow::Borrow, sync::Arc};

/// A table made ready for frames.
#[derive(Debug, Clone)]
pub struct Lookup<'t> {
    /// The table.
    pub table: &'t Table,
    knots: Arc<[f64]>,
    /// The table's promise.
    error: f64,
    tolerance: f64,
    /// How far paths are followed: beyond the table's length by looking them up again.
    length: f64,
}

impl<'t> Lookup<'t> {
    /// Chooses knots for a table whose promise is `error` in radians. Rays that it gave up on are
    /// integrated at `tolerance`, or at a small share of the promise if that is wider.
    pub fn new(table: &'t Table, error: f64, tolerance: f64) -> Self {
        let manifold = table.space.manifold();
        let integrated = tolerance.max(FALLBACK_SHARE * error);
        let knots = choose_knots(manifold, DVec3::NAN, [table.length, integrated, KNOT_ERROR]);
        Self::at_knots(table, knots, error, tolerance)
    }

    /// Does so at the [`Lookup::knots`] that were chosen for this table before.
    pub fn at_knots(table: &'t Table, knots: Arc<[f64]>, error: f64, tolerance: f64) -> Self {
        Self {
            table,
            knots,
            error,
            tolerance: tolerance.max(FALLBACK_SHARE * error),
            length: table.length,
        }
    }

    /// Follows paths of a glued space over `length`, however short the table's are.
    #[must_use]
    pub fn continued(self, length: f64) -> Self {
        let length = length.max(self.table.length);
        Self { length, ..self }
    }

    /// Returns how far paths are followed.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Returns itself if paths are followed beyond the table's length.
    pub(super) fn restarts(&self) -> Option<&Self> {
        (self.length > self.table.length).then_some(self)
    }

    /// Returns the arc lengths at which paths are known.
    pub fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    /// Returns the angle at the camera by which cubics between the knots may miss the path.
    pub(super) fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    /// Tells whether the metric may have edges, across which cubics between knots follow no path.
    fn is_sharp(&self) -> bool {
        self.table.space.manifold().switching_functions().is_some()
    }

    /// Tells whether a path meets an edge of the metric.
    pub(super) fn meets_edge(&self, path: &TablePath<'_>) -> bool {
        self.is_sharp() && path.edges().next().is_some()
    }

    /// Returns the tracer of rays from `u` that the table gave up on.
    pub(super) fn exact(&self, u: DVec3) -> ExactTracer<'_> {
        let manifold = self.table.space.manifold();
        ExactTracer::new(manifold, u, self.length, self.tolerance)
    }

    /// Returns the tracer of one frame, from the camera of `fan`.
    pub fn tracer<'f>(&'f self, fan: &'f Fan) -> TableTracer<'f> {
        TableTracer {
            fan,
            lookup: self,
            knots: &self.knots,
            exact: self.exact(fan.place.u),
            family: RayFamily::new(fan, &self.knots, self.error),
            sharp: self.is_sharp(),
        }
    }
}

/// Looks rays up in a fan.
pub struct TableTracer<'f> {
    fan: &'f Fan,
    lookup: &'f Lookup<'f>,
    knots: &'f Arc<[f64]>,
    exact: ExactTracer<'f>,
    family: Option<RayFamily<'f>>,
    /// Set if the metric has edges.
    sharp: bool,
}

impl GridTracer for TableTracer<'_> {
    fn knots(&self) -> &Arc<[f64]> {
        self.knots
    }

    fn add(&self, directions: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        batch.reserve(directions.len());
        batch.with_coefficients(|batch, coefficients| match &self.family {
            Some(family) => {
                let mut near = None;
                for directions in directions.chunks(LANES) {
                    let orbits = family.orbits(directions);
                    for (direction, orbit) in directions.iter().zip(orbits) {
                        match family.path(&orbit, &mut near, events) {
                            Some(path) => {
                                self.add_of_family((*direction, orbit), &path, events, batch)
                            }
                            None => self.add_of_table(*direction, coefficients, events, batch),
                        }
                    }
                }
            }
            None => {
                for direction in directions {
                    self.add_of_table(*direction, coefficients, events, batch);
                }
            }
        });
    }

    fn endings(&self, directions: &[DVec3], events: &mut EventLocator<'_>) -> Vec<Option<Ending>> {
        let Some(family) = &self.family else {
            return vec![None; directions.len()];
        };
        let mut endings = Vec::with_capacity(directions.len());
        let mut near = None;
        for directions in directions.chunks(LANES) {
            let orbits = family.orbits(directions).into_iter().take(directions.len());
            endings.extend(orbits.map(|orbit| {
                let path = family.path(&orbit, &mut near, events)?;
                path.ending(events)
            }));
        }
        endings
    }

    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        match path.source {
            (_, PathOrigin::Knots) => path.sample(s, rows),
            (coefficients, PathOrigin::Table(number)) => {
                let known = self.fan.among(coefficients, *number).sample_into(s, rows);
                stay(rows, s.len(), known);
            }
            (_, PathOrigin::Family(orbit)) => match self.known_path(orbit) {
                // Between its knots the family does not know where each path meets them.
                Some(of_family) if !of_family.edges().is_empty() => {
                    let known = self.fan.path(path.direction).sample_into(s, rows);
                    stay(rows, s.len(), known);
                }
                Some(of_family) => of_family.refine(s, rows),
                None => {}
            },
        }
    }

    fn meets_edge(&self, path: PathView<'_>, pieces: &[usize]) -> bool {
        match (self.sharp, path.source) {
            (false, _) | (true, (_, PathOrigin::Knots)) => false,
            (true, (coefficients, PathOrigin::Table(number))) => {
                let mut edges = pieces_with(coefficients.edges(*number), self.knots);
                edges.any(|k| pieces.contains(&k))
            }
            (true, (_, PathOrigin::Family(orbit))) => {
                let path = self.known_path(orbit);
                path.is_some_and(|path| path.edges().iter().any(|k| pieces.contains(k)))
            }
        }
    }

    fn edges(&self, path: PathView<'_>) -> Vec<f64> {
        match (self.sharp, path.source) {
            (false, _) | (true, (_, PathOrigin::Knots)) => Vec::new(),
            (true, (coefficients, PathOrigin::Table(number))) => {
                coefficients.edges(*number).collect()
            }
            (true, (_, PathOrigin::Family(_))) => self.fan.path(path.direction).edges().collect(),
        }
    }

    fn refine_sixteen(&self, paths: &[PathView<'_>; LANES], s: &[f64]) -> Vec<[Vectors; 2]> {
        let mut near = None;
        let in_family = |path: &PathView<'_>| match path.source.1 {
            PathOrigin::Family(orbit) => self.family.as_ref()?.known_path(orbit, &mut near),
            _ => None,
        };
        let known: Option<Vec<FamilyPath<'_, '_>>> = paths.iter().map(in_family).collect();
        match known.as_ref().and_then(|known| known.first_chunk()) {
            Some(known) => refine_sixteen(known, s),
            None => refine_each(self, paths, s),
        }
    }

    fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }

    fn restarts(&self) -> Option<&Lookup<'_>> {
        self.lookup.restarts()
    }
}

/// Iterates over the numbers of the pieces between `knots` in which `edges` are.
fn pieces_with(edges: impl Iterator<Item = f64>, knots: &[f64]) -> impl Iterator<Item = usize> {
    edges.map(|edge| piece_at(knots, edge))
}

impl<'f> TableTracer<'f> {
    /// Returns a path of the family that has been asked for before.
    fn known_path(&self, orbit: &Orbit) -> Option<FamilyPath<'_, 'f>> {
        self.family.as_ref()?.known_path(orbit, &mut None)
    }

    /// Adds the path in a direction that is in no family.
    fn add_of_table(
        &self,
        direction: DVec3,
        coefficients: &mut PathCoefficients,
        events: &mut EventLocator<'_>,
        batch: &mut PathBatch,
    ) {
        let number = self.fan.add(self.fan.locate(direction), coefficients);
        let path = self.fan.among(coefficients, number);
        let source = (direction, PathOrigin::Table(number));
        let end = |view: PathView<'_>| ending(&path, view, events);
        batch.push(source, |knots, rows| path.sample_into(knots, rows), end);
        if self.sharp {
            batch.widen_at_edges(pieces_with(path.edges(), self.knots));
        }
    }

    /// Adds a path of the family.
    fn add_of_family(
        &self,
        (direction, orbit): (DVec3, Orbit),
        path: &FamilyPath<'_, '_>,
        events: &mut EventLocator<'_>,
        batch: &mut PathBatch,
    ) {
        let fill = |knots: &[f64], rows: &mut [f64]| {
            path.fill(rows);
            knots.len()
        };
        batch.push((direction, PathOrigin::Family(orbit)), fill, |view| {
            let known = path.ending(events);
            known.or_else(|| ending(&self.fan.path(direction), view, events))
        });
        batch.widen_at_edges(path.edges().iter().copied());
    }
}

/// Finds how a path from the table ends, of which `view` holds the knots.
pub(super) fn ending<C: Borrow<PathCoefficients>>(
    path: &TablePath<'_, C>,
    view: PathView<'_>,
    events: &mut EventLocator<'_>,
) -> Option<Ending> {
    match events.refined_ending(view, &|s, rows| path.sample_into(s, rows)) {
        Some(ending) => Some(ending),
        // A path that the table gave up on might still end before anything is met.
        None if view.known < view.knots.len() => None,
        None => Some(Ending::Length),
    }
}

/// Local tolerance of the rays that the table gave up on, as a share of its promise: from cameras about holes and bumps
/// 99 % of their screen errors are then below a hundredth of it, and they take a fifth fewer steps than at a tenth of this.
const FALLBACK_SHARE: f64 = 1e-2;

/// Error of the cubics between knots, radians at the camera. They decide what a
/// tile may meet and how finely its chords are cut, both with a margin for this; points come from
/// the table itself. Smaller takes more knots (on the Ellis wormhole 31 intervals for this, 48 for
/// 2e-3, which made the lattice a quarter slower), larger makes boxes that seem to meet more.
const KNOT_ERROR: f64 = 8e-3;

/// Paths on which the knots are chosen, from each of the places below.
const KNOT_PATHS: usize = 24;

/// Places in the camera region where those paths begin, as fractions of every parameter's interval: both
/// ends, where paths are most unlike, and between.
const KNOT_PLACES: [f64; 4] = [0.0, 0.35, 0.65, 1.0];

/// Chooses the fewest equal intervals (of a few) between which cubics follow a sample of exact paths to
/// `error`, all but one in twelve. Exact paths, because the slopes of a table's own
/// polynomials carry noise that finer knots would only follow. They are chosen for the whole region (for `u`
/// if there is none), because integrating the sample takes longer than a frame.
pub(super) fn choose_knots(
    manifold: &Manifold,
    u: DVec3,
    [length, tolerance, error]: [f64; 3],
) -> Arc<[f64]> {
    let directions: Vec<DVec3> = (0..KNOT_PATHS)
        .map(|i| fibonacci_direction(i, KNOT_PATHS))
        .collect();
    let places = match &manifold.cameras {
        Some(region) => KNOT_PLACES
            .map(|t| region.at(&region.lerp(&[t; 3])))
            .to_vec(),
        None => vec![u],
    };
    let curves: Vec<Curve> = places
        .into_iter()
        .flat_map(|u| ExactTracer::new(manifold, u, length, tolerance).trace(&directions))
        .collect();
    let good = |n: &usize| {
        let knots = even_knots(length, *n);
        let errors = curves.iter().map(|curve| worst_middle(curve, &knots));
        errors.filter(|e| *e > error).count() <= curves.len() / 12
    };
    // With the first knot multiples of sixteen, in which paths are sampled.
    let counts = [15, 31, 47, 63, 79, 95, 127];
    even_knots(length, counts.into_iter().find(good).unwrap_or(191))
}

/// Returns the largest angle by which the middles of cubics between `knots` miss the curve.
pub(super) fn worst_middle(curve: &Curve, knots: &[f64]) -> f64 {
    let end = curve.ending.limit();
    let mut worst = 0.0_f64;
    for pair in knots.windows(2).take_while(|pair| pair[1] < end) {
        let middle = 0.5 * (pair[0] + pair[1]);
        let (Some((u0, v0)), Some((u1, v1)), Some((u, v))) = (
            curve.state(pair[0]),
            curve.state(pair[1]),
            curve.state(middle),
        ) else {
            break;
        };
        let cubic = Cubic {
            s: [pair[0], pair[1]],
            u: [u0, u1],
            v: [v0, v1],
        };
        worst = worst.max((cubic.middle() - u).length() / (middle * v.length()));
    }
    worst
}

/// Intervals between the places where a part is sampled, for one of the table's knots: cubics between those may miss
/// the path by far more than what is seen may.
const FINER: usize = 4;

/// Samples that one thread works on at a time.
const BLOCK: usize = 256;

/// Memory for one thread that looks paths up again.
struct RestartScratch<'w> {
    events: EventLocator<'w>,
    search: HitSearch<'w>,
    rows: Vec<f64>,
    s: Arc<[f64]>,
}

impl Lookup<'_> {
    /// Goes on with all samples whose paths end by the length of `tracer`'s, by looking them up again where the table ends;
    /// lists those that no look-up serves.
    pub fn go_on(
        &self,
        samples: &PixelSamples<'_>,
        tracer: &dyn GridTracer,
        outcomes: &mut Outcomes,
    ) -> Vec<SamplePlace> {
        let ended = outcomes.indexed_iter();
        let ended = ended.filter(|(_, seen)| **seen == Seen::Length);
        let ended: Vec<SamplePlace> = ended.map(|(place, _)| place).collect();
        let blocks = ended.par_chunks(BLOCK);
        let found = blocks.flat_map_iter(|places| self.seen_farther(samples, tracer, places));
        let found: Vec<Option<Seen>> = found.collect();
        let mut lost = Vec::new();
        for (place, seen) in ended.into_iter().zip(found) {
            match seen {
                Some(seen) => outcomes[place] = seen,
                None => lost.push(place),
            }
        }
        lost
    }

    /// Returns what samples see beyond the length of the table, those in one block.
    fn seen_farther(
        &self,
        samples: &PixelSamples<'_>,
        tracer: &dyn GridTracer,
        places: &[SamplePlace],
    ) -> Vec<Option<Seen>> {
        let world = samples.world;
        let addresses: Vec<DVec3> = places.iter().map(|p| samples.address(*p)).collect();
        let knots = tracer.knots();
        let mut scratch = RestartScratch {
            events: EventLocator::new(&world.manifold),
            search: HitSearch::new(world),
            rows: Vec::new(),
            s: even_knots(self.table.length, FINER * (self.knots.len() - 1)),
        };
        let mut batch = PathBatch::new(knots.clone());
        tracer.add(&addresses, &mut scratch.events, &mut batch);
        let last = knots.len() - 1;
        let paths = (0..batch.len()).map(|i| batch.path(i));
        paths
            .map(|path| {
                let state = (path.known > last).then(|| (path.point(last), path.tangent(last)));
                self.seen_from(world, state?, &mut scratch)
            })
            .collect()
    }

    /// Returns what the path sees that has this state where the table ends; `None` where the table has no path from
    /// there, or one that meets an edge of the metric between its knots.
    fn seen_from(
        &self,
        world: &World,
        mut state: (DVec3, DVec3),
        scratch: &mut RestartScratch<'_>,
    ) -> Option<Seen> {
        let reach = self.table.length;
        let mut from = reach;
        while from < self.length {
            let (u, v, _) = world.manifold.brought_in(state.0, state.1)?;
            let (fan, direction) = self.table.restarted(u, v).ok()?;
            let path = fan.path(direction);
            if self.meets_edge(&path) {
                return None;
            }
            let RestartScratch {
                events,
                search,
                rows,
                s,
            } = scratch;
            rows.clear();
            rows.resize(ROWS * s.len(), 0.0);
            let known = path.sample_into(s, rows);
            stay(rows, s.len(), known);
            let view = PathView {
                knots: s,
                direction,
                rows,
                boxes: &[],
                known,
                ending: None,
                source: (&PathCoefficients::default(), &PathOrigin::Knots),
            };
            let end = ending(&path, view, events)?;
            let limit = end.limit().min(self.length - from);
            let pieces = (0..known - 1).take_while(|k| s[*k] < limit);
            search.go_on_from(from);
            let mut hits = pieces.filter_map(|k| search.first_hit(&view.piece(k), limit));
            if let Some(hit) = hits.next() {
                return Some(Seen::Surface(hit));
            }
            match end {
                Ending::Length => {}
                Ending::Exit { s, .. } if s <= limit => return Some(beyond(&end.farther(from))),
                Ending::Exit { .. } => return Some(Seen::Length),
                Ending::Singular => return Some(Seen::Singular),
            }
            let last = s.len() - 1;
            state = (view.point(last), view.tangent(last));
            from += reach;
        }
        Some(Seen::Length)
    }
}
