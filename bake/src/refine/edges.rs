//! Boxes whose paths meet edges of the metric, where they are refracted or reflected, or exits behind which they get rough.
//!
//! In: a box and its held-out rays, with the edges that each meets. Out: what becomes of the box because of them.
//!
//! Where all rays meet the same edges in the same sense, the place of the first is a polynomial of the ray
//! ([`EdgeDivision`]), and the box is divided there: what is before it and what is behind it is smooth again. Where
//! they do not (some miss a ball of glass, or are reflected totally), paths jump from ray to ray, and the box is
//! halved to part them, as long as that pays ([`Decision::Mixed`]).
//!
//! An exit behind which paths get rough is an edge, too (see `EdgePiece`): tables end paths there.
//!
//! In: the rays of a space. Out: for each exit whether it is one of them, and how far behind it paths may end
//! ([`rough_exits`]). Paths in a table go on past their exits, as smooth as they are; behind a horizon that a wind carries
//! them over they turn about a singularity within a moment, and polynomials that followed them there would take all their
//! degrees for what nobody sees.

use super::{
    Refiner,
    held_out::HeldOutRays,
    line_series::{Resolution, tail},
    most_urgent,
    refinement_tree::{Decision, ParameterBox},
};
use crate::plan::{PlanWatch, divides_paths, random_stored_rays};
use geofan_bundle::{
    PlanRecord, Polynomial, StepSize, Tensor, Train, Tree, divided_at_edge,
    rays::{BetweenEdges, EdgePiece, RaySpace, exit_met, speed_behind_end},
};
use geofan_core::{
    Result,
    geodesic::{End, Path, Ray, Settings, Step, ends_alone, paths},
};
use glam::DVec3;
use ndarray::ArrayD;
use rayon::prelude::*;
use std::{collections::BTreeMap, num::NonZeroU32, ops::Range, sync::Arc};

/// The most edges of a path that a table knows of: light that goes round in a ball of glass meets ever more, and
/// each of its pieces is a patch of its own.
const MOST_EDGES: usize = 6;

/// The part of the promise that the place of an edge may be off, as a share of the arc length. Both sides know of
/// it: they are fitted to where the table says that the edge is.
const PLACE_SHARE: f64 = 0.1;

/// The same for ends of paths, as a share of the arc length: all that matters is that exits are found before them.
const END_PLACE_ERROR: f64 = 2e-4;

/// Nodes along each axis that are tried first for the place of an edge.
pub(super) const FIRST_NODES: usize = 5;

/// How far points behind the end of paths may be off, as a share of the way from the exit to the end, and slopes there,
/// as a share of what they are.
const STRAY_BEHIND_END: f64 = 0.2;
const SLOPE_BEHIND_END: f64 = 0.1;

/// Rays followed at once to where they meet an edge.
const BATCH: usize = 256;

/// Share of the promise of a place that a polynomial may miss before more nodes are tried.
pub(super) const ROOMY: f64 = 0.5;

/// The edges between which the paths of a box are.
#[derive(Debug, Clone)]
pub struct EdgeBounds {
    /// Those that bound it.
    pub piece: EdgePiece,
    /// The divisions that led to it: where each is, and whether the piece is before (0) or behind (1) it.
    divisions: Vec<(EdgePlace, usize)>,
}

/// The place of an edge on the paths of a box.
#[derive(Debug, Clone)]
struct EdgePlace {
    arc_length: Arc<Tensor>,
    /// Its box.
    of: ParameterBox,
}

/// An edge that all paths of a box meet first.
#[derive(Debug)]
pub struct EdgeDivision {
    /// Its number: see [`geofan_core::geodesic::Step::edge`].
    pub edge: NonZeroU32,
    /// Its arc length, as the table stores it.
    pub place: Arc<Tensor>,
    /// The part of the box's arc lengths before it, in the mean.
    pub share: f64,
}

impl EdgeBounds {
    /// Makes those of the part of `bounds` on one side of an edge.
    pub fn beside(bounds: &ParameterBox, crossing: &EdgeDivision, side: usize) -> Self {
        let (mut piece, mut divisions) = match &bounds.edges {
            Some(edges) => (edges.piece.clone(), edges.divisions.clone()),
            None => (EdgePiece::default(), Vec::new()),
        };
        match side {
            0 => piece.next = Some(crossing.edge),
            _ => piece.before.push(crossing.edge),
        }
        let place = EdgePlace {
            arc_length: crossing.place.clone(),
            of: bounds.clone(),
        };
        divisions.push((place, side));
        Self { piece, divisions }
    }

    /// Returns the arc lengths of the piece on paths of `length`, of rays with these parameters in the chunk.
    pub fn pieces(&self, rays: &[Vec<f64>], length: f64) -> Vec<[f64; 2]> {
        let mut pieces = vec![[0.0, length]; rays.len()];
        for (place, side) in &self.divisions {
            for (piece, at) in pieces.iter_mut().zip(place.on(rays)) {
                *piece = divided_at_edge(*piece, at)[*side];
            }
        }
        pieces
    }
}

impl EdgePlace {
    /// Returns the arc lengths at which the paths of rays with these parameters in the chunk meet the edge.
    fn on(&self, rays: &[Vec<f64>]) -> Vec<f64> {
        let inner: Vec<Vec<f64>> = rays.iter().map(|x| self.of.in_box(x)).collect();
        let points: Vec<&[f64]> = inner.iter().map(Vec::as_slice).collect();
        let found = self.arc_length.at_many(&points);
        found.into_iter().map(|row| row[0]).collect()
    }
}

impl ParameterBox {
    /// Returns the piece of paths that it is of; the whole of those that meet no edge if none bounds it.
    pub fn piece(&self) -> EdgePiece {
        let edges = self.edges.as_ref();
        edges.map_or_else(EdgePiece::default, |edges| edges.piece.clone())
    }
}

/// Decisions about boxes because of edges.
impl Refiner<'_> {
    /// Decides about a box whose paths meet edges; `None` where those in it do not meet any that its neighbours
    /// do not, so that it is like every other.
    pub(super) fn decide_edges(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        held_out: &mut HeldOutRays<'_>,
    ) -> Option<Decision> {
        if !divides_paths(self.plan) {
            return None;
        }
        let piece = bounds.piece();
        if !held_out.meets_edges() {
            // A corner of the box may.
            held_out.look_closer();
        }
        if bounds.edges.is_none() && !held_out.meets_edges() {
            return None;
        }
        let expected: Vec<NonZeroU32> = piece.before.iter().chain(&piece.next).copied().collect();
        let alike = |held_out: &HeldOutRays<'_>| {
            let first = held_out.edges_met(0)?;
            let same = (1..held_out.len()).all(|ray| held_out.edges_met(ray) == Some(first));
            (same && first.starts_with(&expected)).then(|| first.get(expected.len()).copied())
        };
        // The first rays most often tell that they are not.
        let mut next = alike(held_out);
        if next.is_some() {
            held_out.complete();
            next = alike(held_out);
        }
        let Some(next) = next else {
            return Some(self.decide_mixed(chunk, bounds, held_out));
        };
        let edge = next?;
        if bounds.arc_halvings() > 0 || piece.before.len() >= MOST_EDGES {
            return Some(self.give_up(bounds, held_out));
        }
        Some(match self.crossing(chunk, bounds, edge, held_out) {
            Ok(crossing) => Decision::Edge(Box::new(crossing)),
            Err(urgency) => match most_urgent(&urgency, &self.may_halve_rays(bounds)) {
                Some(axis) => Decision::Halve(axis),
                None => self.give_up(bounds, held_out),
            },
        })
    }

    /// Decides about a box whose paths do not meet the same edges: it is parted along a separatrix if there is one, and
    /// given up where it would be too small before they do.
    fn decide_mixed(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        held_out: &HeldOutRays<'_>,
    ) -> Decision {
        if let Some(found) = self.separatrix(chunk, bounds, held_out) {
            return Decision::Separatrix(Arc::new(found));
        }
        let groups = groups(held_out.kinds());
        let largest = groups.values().copied().fold(0.0, f64::max) / held_out.len() as f64;
        let halvings = (bounds.volume() / self.least_mixed(bounds)).log2();
        let urgency = parting(bounds, held_out.kinds());
        match most_urgent(&urgency, &self.may_halve_rays(bounds)) {
            Some(axis) if HALVINGS * -largest.log2() <= halvings => Decision::Mixed(axis),
            _ => self.give_up(bounds, held_out),
        }
    }

    /// Returns the volume of boxes whose paths do not meet the same edges that are not halved any more.
    fn least_mixed(&self, bounds: &ParameterBox) -> f64 {
        match bounds.arc() {
            ..3 => self.plan.least_volume,
            _ => MIXED_OF_MANY_AXES * self.plan.least_volume,
        }
    }

    /// Gives up a box too small to be halved, but the first half of its arc lengths where no edge is there.
    fn give_up(&self, bounds: &ParameterBox, held_out: &HeldOutRays<'_>) -> Decision {
        let arc = bounds.arc();
        if self.may_halve(bounds)[arc] && held_out.first_half_is_alike() {
            return Decision::Halve(arc);
        }
        self.count_finished(bounds, 1);
        Decision::Unread(Tree::Flagged)
    }

    /// Tells along which axes but the arc length the box may be halved.
    pub(super) fn may_halve_rays(&self, bounds: &ParameterBox) -> Vec<bool> {
        let mut may = self.may_halve(bounds);
        may[bounds.arc()] = false;
        may
    }

    /// Finds where the paths of a box meet `edge`, the first behind its start; the urgency of halving each axis
    /// if no polynomial tells.
    fn crossing(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        edge: NonZeroU32,
        held_out: &HeldOutRays<'_>,
    ) -> Result<EdgeDivision, Vec<f64>> {
        let piece = EdgePiece {
            next: Some(edge),
            ..bounds.piece()
        };
        let most = match piece.is_at_end() {
            true => END_PLACE_ERROR,
            false => PLACE_SHARE * 1e-3 * self.plan.max_error,
        };
        let mut limits = self.most_nodes(bounds);
        limits[bounds.arc()] = 1;
        let nodes = limits.iter().map(|most| FIRST_NODES.min(*most)).collect();
        let mut resolution = Resolution::of_nodes(nodes);
        let polynomial = loop {
            let polynomial = self.fit_place(chunk, bounds, &resolution.nodes, &piece)?;
            let left = held_out.place_error(|points| polynomial.at(points)) / most;
            if left <= ROOMY {
                break polynomial;
            }
            let mut spectra = polynomial.spectra();
            spectra[bounds.arc()] = vec![0.0];
            if !resolution.raise((&limits, self.most_rays(bounds)), &spectra, left) {
                return Err(spectra.iter().map(|s| tail(s)).collect());
            }
        };
        let place = self.quantise_place(&polynomial, most * held_out.least_place(), |tensor| {
            held_out.place_error(|points| tensor.at_many(points)) / most
        });
        let place = place.ok_or_else(|| parting(bounds, held_out.kinds()))?;
        Ok(EdgeDivision {
            edge,
            place: Arc::new(place),
            share: held_out.share_before_edge(),
        })
    }

    /// Fits the polynomial through the places where rays on the tensor grid of `nodes` meet the edge at the end of
    /// `piece`; the urgency of halving each axis if some meet others.
    fn fit_place(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        nodes: &[usize],
        piece: &EdgePiece,
    ) -> Result<Polynomial, Vec<f64>> {
        let count: usize = nodes[..bounds.arc()].iter().product();
        let grid = self.grid(chunk, bounds, nodes);
        let ends = self.ends(piece, self.tolerance(bounds), (count, grid));
        if self.tally.stop().told() {
            return Err(vec![0.0; nodes.len()]);
        }
        if ends.iter().any(|end| end.is_nan()) {
            let parameters = self.all_parameters(bounds, nodes);
            let kinds = ends.iter().map(|end| end.is_nan());
            return Err(parting(bounds, parameters.iter().zip(kinds)));
        }
        Ok(self.polynomial_of(bounds, nodes, ends))
    }

    /// Finds where the paths of so many rays (chart point, unit tangent), given by their numbers, meet the edge at the end
    /// of `piece`; not a number for those that meet others.
    pub(super) fn ends(
        &self,
        piece: &EdgePiece,
        tolerance: f64,
        (count, rays): (usize, impl Fn(Range<usize>) -> Vec<(DVec3, DVec3)> + Sync),
    ) -> Vec<f64> {
        // Nobody looks behind exits.
        let settings = Settings {
            events: self.space.ends_alike(),
            ..Settings::bare(tolerance)
        };
        let starts: Vec<usize> = (0..count).step_by(BATCH).collect();
        let ends = starts.into_par_iter().flat_map_iter(|first| {
            let rays = rays(first..count.min(first + BATCH)).into_iter();
            let rays = rays.map(|(u, v)| Ray::without_spread(u, v, self.plan.length));
            self.ends_of(piece, settings, rays.collect())
        });
        ends.collect()
    }

    /// Finds the ends of [`Refiner::ends`] of a few rays.
    fn ends_of(&self, piece: &EdgePiece, settings: Settings, rays: Vec<Ray>) -> Vec<f64> {
        let (space, manifold) = (self.space, self.space.manifold());
        // Where there are no edges but exits, nobody looks at the steps.
        if settings.events && manifold.switching_functions().is_none() {
            let ends = ends_alone(manifold, settings, &rays).into_iter();
            return ends.map(|end| piece.end_at_exit(space, end)).collect();
        }
        let found = paths(manifold, settings, rays);
        found.iter().map(|path| piece.end(space, path)).collect()
    }

    /// Fits the polynomial with one number for each ray of the tensor grid of `nodes`.
    pub(super) fn polynomial_of(
        &self,
        bounds: &ParameterBox,
        nodes: &[usize],
        numbers: Vec<f64>,
    ) -> Polynomial {
        let shape = [&nodes[..bounds.arc()], &[1, 1]].concat();
        let samples = ArrayD::from_shape_vec(shape, numbers).expect("one number for each node");
        Polynomial::fit(samples, 0, self.variables(bounds))
    }

    /// Makes the patch of a box behind the end of its paths, which is `behind` their exit as a share of the arc length.
    /// Nobody looks there, but who looks for the exit must find that paths are behind it.
    pub(super) fn behind_end(&self, chunk: usize, bounds: &ParameterBox, behind: f64) -> Tree {
        let middle = vec![0.0; bounds.arc()];
        let interval = bounds.arc_intervals(&[middle], self.plan.length)[0];
        let speed = self.lifted_speed(chunk, bounds, interval[0]);
        let most = STRAY_BEHIND_END * behind * speed;
        let step = StepSize::near(SLOPE_BEHIND_END * speed_behind_end(behind, interval) * speed);
        let mut limits = self.most_nodes(bounds);
        limits[bounds.arc()] = 1;
        let nodes = limits.iter().map(|most| FIRST_NODES.min(*most)).collect();
        let mut resolution = Resolution::of_nodes(nodes);
        let found = loop {
            let Ok(polynomial) = self.fit(chunk, bounds, &resolution.nodes) else {
                break None;
            };
            let mut spectra = polynomial.spectra();
            spectra[bounds.arc()] = vec![0.0];
            let left = spectra.iter().map(|s| tail(s)).sum::<f64>() / most;
            if left <= 1.0 {
                break Train::plain(&polynomial).rounded(step);
            }
            if !resolution.raise((&limits, self.most_rays(bounds)), &spectra, left) {
                break None;
            }
        };
        self.count_finished(bounds, found.as_ref().map_or(1, Tensor::bytes));
        found.map_or(Tree::Flagged, |tensor| Tree::Leaf(Arc::new(tensor)))
    }

    /// Returns how fast points, as they are stored, move at the arc length `s` of the box's middle ray.
    fn lifted_speed(&self, chunk: usize, bounds: &ParameterBox, s: f64) -> f64 {
        let one = vec![1; bounds.arc() + 1];
        let middle = self.grid(chunk, bounds, &one)(0..1).into_iter();
        let rays = middle.map(|(u, v)| Ray::without_spread(u, v, s));
        let settings = Settings::bare(self.tolerance(bounds));
        let found = paths(self.space.manifold(), settings, rays);
        let last = found.first().and_then(|path| path.steps.last());
        last.map_or(1.0, |step| {
            let (u, v) = (step.position(step.end), step.tangent(step.end));
            self.space.chart_map().speed(u, v)
        })
    }

    /// Returns the pieces of the paths of the rays with these parameters, to be sampled between edges; `None` of a
    /// box that no edge bounds.
    pub(super) fn pieces(
        &self,
        bounds: &ParameterBox,
        rays: &[Vec<f64>],
    ) -> Option<(EdgePiece, Vec<[f64; 2]>)> {
        let edges = bounds.edges.as_ref()?;
        let intervals = bounds.arc_intervals(rays, self.plan.length);
        Some((edges.piece.clone(), intervals))
    }
}

/// Prepares pieces to be sampled.
pub(super) fn between(pieces: &(EdgePiece, Vec<[f64; 2]>)) -> BetweenEdges<'_> {
    BetweenEdges {
        piece: &pieces.0,
        intervals: &pieces.1,
    }
}

/// Rates each axis by how well halving a box along it parts rays of different kinds, each given with its parameters;
/// where there is one kind, by the box's width along it.
pub(super) fn parting<'x, K: Ord + Clone>(
    bounds: &ParameterBox,
    rays: impl Iterator<Item = (&'x Vec<f64>, K)> + Clone,
) -> Vec<f64> {
    // How many rays of its own kind a ray finds on one side.
    let agreement = |side: &dyn Fn(&[f64]) -> bool| {
        let groups = groups(rays.clone().filter(|(x, _)| side(x)));
        let all: f64 = groups.values().sum();
        groups.values().map(|n| n * n).sum::<f64>() / all.max(1.0)
    };
    let (whole, count) = (agreement(&|_| true), rays.clone().count() as f64);
    let axes = 0..bounds.arc();
    let mut urgency: Vec<f64> = axes
        .map(|axis| {
            let [low, high] = [-1.0, 1.0].map(|sign| agreement(&|x: &[f64]| sign * x[axis] > 0.0));
            let [a, b] = bounds.intervals[axis];
            let gain = (low + high - whole) / (count - whole).max(0.5);
            gain.max(0.0) + LEAST_GAIN * 0.5 * (b - a)
        })
        .collect();
    urgency.push(0.0);
    urgency
}

/// Counts rays by their kinds.
pub(super) fn groups<'x, K: Ord>(
    rays: impl Iterator<Item = (&'x Vec<f64>, K)>,
) -> BTreeMap<K, f64> {
    let mut groups = BTreeMap::new();
    for (_, kind) in rays {
        *groups.entry(kind).or_default() += 1.0;
    }
    groups
}

/// Halvings that a box must have left for each time that its largest group of rays that meet the same edges has to be
/// doubled to be all of them.
const HALVINGS: f64 = 2.0;

/// Factor by which boxes of three and more axes of rays whose paths do not meet the same edges may be larger than others
/// when they are given up: what parts paths is a surface there, and halving all boxes along it takes half as much work
/// again and leaves four fifths of it.
const MIXED_OF_MANY_AXES: f64 = 16.0;

/// The gain, as a share of all that could be gained, that twice the width of a box outweighs.
const LEAST_GAIN: f64 = 0.1;

/// Random paths that are followed past their exits: some are to meet a hole that takes a hundredth of the sky.
const END_PATHS: usize = 4096;

/// Paths followed between two looks at the observer.
const END_BATCH: usize = 64;

/// Factor by which the least step of the integrator behind an exit must be smaller than that before it.
const ROUGHER: f64 = 4.0;

/// The share of the way, from the exit to where paths get rough, after which they end: as far from both as errors of a
/// table and differences between neighbours allow. And the bounds of it as a share of the arc length up to the exit.
const WAY_PART: f64 = 0.4;
const WAY_BOUNDS: [f64; 2] = [1e-3, 2e-2];

/// The share of paths that may get rough sooner than is reckoned with.
const SOONER: f64 = 0.05;

/// Tells of each exit of `space` whether most paths through it get rough behind it: then, how far behind it they are to
/// end, as a share of the arc length. None does where only the metric bends light: there paths come to rest near a
/// horizon by themselves.
///
/// # Errors
/// The observer ends it.
pub fn rough_exits(
    space: &RaySpace,
    plan: &PlanRecord,
    watch: &PlanWatch<'_>,
) -> Result<Vec<Option<f64>>> {
    let manifold = space.manifold();
    if !manifold.has_wind() || !manifold.domain.ends_rays() || !space.ends_alike() {
        return Ok(Vec::new());
    }
    let settings = Settings::bare(plan.tolerance);
    // Paths through each exit, and how far behind it they get rough.
    let mut found = vec![(0, Vec::new()); manifold.exits.len()];
    for batch in random_stored_rays(space, END_PATHS).chunks(END_BATCH) {
        watch.add(batch.len() as u64)?;
        let rays = batch
            .iter()
            .map(|&(u, d)| Ray::without_spread(u, manifold.local_frame(u).tangent(d), plan.length));
        for path in paths(manifold, settings, rays) {
            let Some((exit, place)) = exit_met(space, &path, path.length) else {
                continue;
            };
            if let Some((count, ways)) = found.get_mut(exit) {
                *count += 1;
                ways.extend(smooth_way(&path, place));
            }
        }
    }
    let share = |(count, mut ways): (usize, Vec<f64>)| {
        ways.sort_by(f64::total_cmp);
        let way = ways.get((SOONER * ways.len() as f64) as usize)?;
        (2 * ways.len() > count).then_some((WAY_PART * way).clamp(WAY_BOUNDS[0], WAY_BOUNDS[1]))
    };
    Ok(found.into_iter().map(share).collect())
}

/// Returns how far a path goes on behind the arc length `place`, as a share of it, before it gets rough: by steps far
/// shorter than all before, or by its end.
fn smooth_way(path: &Path, place: f64) -> Option<f64> {
    // The last step is cut off at the length.
    let (last, steps) = path.steps.split_last()?;
    let behind = steps.partition_point(|step| step.start < place);
    let length = |step: &Step| step.end - step.start;
    let least = steps[..behind]
        .iter()
        .map(length)
        .fold(f64::INFINITY, f64::min);
    let rough = steps[behind..]
        .iter()
        .find(|step| ROUGHER * length(step) < least);
    let end = match (rough, path.end) {
        (Some(step), _) => step.start,
        (None, End::Singular) => last.end,
        (None, _) => return None,
    };
    Some(end / place - 1.0)
}
