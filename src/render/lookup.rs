//! The tracer that looks paths up in a table.
//!
//! In: a table, once ([`Lookup`]), and the fan of a camera for each frame ([`TableTracer`]). Out:
//! [`Strands`] on knots that are the same for all cameras.

use super::{
    curve::{Curve, Ending},
    endings::EndingFinder,
    lanes::{LANES, Points},
    pencil::{Near, Pencil},
    strands::{Source, Strand, Strands, stay},
    strip::{self, Rung},
    tracer::{ExactTracer, GridTracer, even_knots, refine_each},
};
use crate::{
    bundle::{Courses, Fan, FanPath, Table},
    fan::Orbit,
};
use glam::DVec3;
use std::{borrow::Borrow, sync::Arc};

/// A table made ready for frames.
#[derive(Debug, Clone)]
pub struct Lookup<'t> {
    /// The table.
    pub table: &'t Table,
    knots: Arc<[f64]>,
    tolerance: f64,
}

impl<'t> Lookup<'t> {
    /// `error` is the table's promise in radians. Rays that it gave up on are integrated at
    /// `tolerance`, or at a small share of the promise if that is wider.
    pub fn new(table: &'t Table, error: f64, tolerance: f64) -> Self {
        let tolerance = tolerance.max(FALLBACK_SHARE * error);
        Self {
            table,
            knots: choose_knots(table, tolerance),
            tolerance,
        }
    }

    /// The arc lengths of the knots.
    pub(super) fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    /// Returns the angle at the camera by which cubics between the knots may miss the path.
    pub(super) fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    /// Who follows rays from `u` that the table gave up on.
    pub(super) fn exact(&self, u: DVec3) -> ExactTracer<'_> {
        let manifold = self.table.space.manifold();
        ExactTracer::new(manifold, u, self.table.length, self.tolerance)
    }

    /// The tracer of one frame, from the camera of `fan`.
    pub fn tracer<'f>(&'f self, fan: &'f Fan<'t>) -> TableTracer<'f, 't> {
        TableTracer {
            fan,
            knots: &self.knots,
            exact: self.exact(fan.place.u),
            pencil: Pencil::new(fan, &self.knots),
        }
    }
}

/// Looks rays up in a fan.
pub struct TableTracer<'f, 't> {
    fan: &'f Fan<'t>,
    knots: &'f Arc<[f64]>,
    exact: ExactTracer<'f>,
    pencil: Option<Pencil<'f, 't>>,
}

impl GridTracer for TableTracer<'_, '_> {
    fn knots(&self) -> &Arc<[f64]> {
        self.knots
    }

    fn add(&self, directions: &[DVec3], endings: &mut EndingFinder<'_>, strands: &mut Strands) {
        strands.reserve(directions.len());
        strands.with_courses(|strands, courses| match &self.pencil {
            Some(pencil) => {
                let mut near = Near::default();
                for directions in directions.chunks(LANES) {
                    let orbits = pencil.orbits(directions);
                    for (direction, orbit) in directions.iter().zip(orbits) {
                        match pencil.rung(&orbit, &mut near, endings) {
                            Some(rung) => self.climb((*direction, orbit), &rung, endings, strands),
                            None => self.follow(*direction, courses, endings, strands),
                        }
                    }
                }
            }
            None => {
                for direction in directions {
                    self.follow(*direction, courses, endings, strands);
                }
            }
        });
    }

    fn endings(&self, directions: &[DVec3], endings: &mut EndingFinder<'_>) -> Vec<Option<Ending>> {
        let Some(pencil) = &self.pencil else {
            return vec![None; directions.len()];
        };
        let mut ends = Vec::with_capacity(directions.len());
        let mut near = Near::default();
        for directions in directions.chunks(LANES) {
            let orbits = pencil.orbits(directions).into_iter().take(directions.len());
            ends.extend(orbits.map(|orbit| {
                let rung = pencil.rung(&orbit, &mut near, endings)?;
                rung.ending(endings)
            }));
        }
        ends
    }

    fn refine(&self, strand: Strand<'_>, s: &[f64], rows: &mut [f64]) {
        match strand.source {
            (_, Source::Knots) => strand.sample(s, rows),
            (courses, Source::Course(number)) => {
                let known = self.fan.among(courses, *number).sample(s, rows);
                stay(rows, s.len(), known);
            }
            (_, Source::Pencil(orbit)) => {
                let pencil = self.pencil.as_ref();
                let rung = pencil.and_then(|pencil| pencil.known(orbit, &mut Near::default()));
                rung.into_iter().for_each(|rung| rung.refine(s, rows));
            }
        }
    }

    fn refine_sixteen(&self, strands: &[Strand<'_>; LANES], s: &[f64]) -> Vec<[Points; 2]> {
        let mut near = Near::default();
        let rung = |strand: &Strand<'_>| match strand.source.1 {
            Source::Pencil(orbit) => self.pencil.as_ref()?.known(orbit, &mut near),
            _ => None,
        };
        let rungs: Option<Vec<Rung<'_, '_, '_>>> = strands.iter().map(rung).collect();
        match rungs.as_ref().and_then(|rungs| rungs.first_chunk()) {
            Some(rungs) => strip::refine_sixteen(rungs, s),
            None => refine_each(self, strands, s),
        }
    }

    fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }
}

impl TableTracer<'_, '_> {
    /// Adds the path in a direction that no pencil knows.
    fn follow(
        &self,
        direction: DVec3,
        courses: &mut Courses,
        endings: &mut EndingFinder<'_>,
        strands: &mut Strands,
    ) {
        let number = self.fan.add(self.fan.locate(direction), courses);
        let path = self.fan.among(courses, number);
        let course = (direction, Source::Course(number));
        let ending = |strand: Strand<'_>| ending(&path, strand, endings);
        strands.push(course, |knots, rows| path.sample(knots, rows), ending);
    }

    /// Adds the path of a rung.
    fn climb(
        &self,
        (direction, orbit): (DVec3, Orbit),
        rung: &Rung<'_, '_, '_>,
        endings: &mut EndingFinder<'_>,
        strands: &mut Strands,
    ) {
        let fill = |knots: &[f64], rows: &mut [f64]| {
            rung.fill(rows);
            knots.len()
        };
        strands.push((direction, Source::Pencil(orbit)), fill, |strand| {
            let known = rung.ending(endings);
            known.or_else(|| ending(&self.fan.path(direction), strand, endings))
        });
    }
}

/// How a strand of `path` ends.
pub(super) fn ending<C: Borrow<Courses>>(
    path: &FanPath<'_, '_, C>,
    strand: Strand<'_>,
    endings: &mut EndingFinder<'_>,
) -> Option<Ending> {
    match endings.sharp_ending(strand, |s, rows| path.sample(s, rows)) {
        Some(ending) => Some(ending),
        // What the table gave up on might still end before anything is met.
        None if strand.known < strand.knots.len() => None,
        None => Some(Ending::Nowhere),
    }
}

/// Local tolerance of the rays that the table gave up on, as a share of its promise: their error is
/// then far below the promise, and they cost half of what the finest tolerance does.
const FALLBACK_SHARE: f64 = 1e-3;

/// By how much the cubics between knots may miss the path, radians at the camera. They decide what a
/// tile may meet and how finely its chords are cut, both with a margin for this; points come from
/// the table itself. Smaller takes more knots (on the Ellis wormhole 31 intervals for this, 48 for
/// 2e-3, which made the lattice a quarter slower), larger makes boxes that seem to meet more.
const KNOT_ERROR: f64 = 8e-3;

/// Paths on which the knots are chosen, from each of the places below.
const KNOT_PATHS: usize = 24;

/// Where in the camera region, as a fraction of every parameter's interval, those paths begin: both
/// ends, where paths are most unlike, and between.
const KNOT_PLACES: [f64; 4] = [0.0, 0.35, 0.65, 1.0];

/// The fewest equal intervals (of a few) between which cubics follow a sample of exact paths to
/// [`KNOT_ERROR`], all but one in twelve. Exact paths, because the slopes of the table's own
/// polynomials carry noise that finer knots would only follow. Chosen for the whole region, because
/// integrating the sample takes longer than a frame.
fn choose_knots(table: &Table, tolerance: f64) -> Arc<[f64]> {
    let manifold = table.space.manifold();
    let directions: Vec<DVec3> = (0..KNOT_PATHS).map(fibonacci_direction).collect();
    let places = manifold
        .cameras
        .iter()
        .flat_map(|region| KNOT_PLACES.map(|t| region.at(&region.lerp(&[t; 3]))));
    let curves: Vec<Curve> = places
        .flat_map(|u| ExactTracer::new(manifold, u, table.length, tolerance).trace(&directions))
        .collect();
    let good = |n: &usize| {
        let knots = even_knots(table.length, *n);
        let errors = curves.iter().map(|curve| worst_middle(curve, &knots));
        errors.filter(|e| *e > KNOT_ERROR).count() <= curves.len() / 12
    };
    // With the first knot multiples of sixteen, in which paths are sampled.
    let counts = [15, 31, 47, 63, 79, 95, 127];
    even_knots(table.length, counts.into_iter().find(good).unwrap_or(191))
}

/// The largest angle by which the middles of cubics between `knots` miss the curve.
fn worst_middle(curve: &Curve, knots: &[f64]) -> f64 {
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
        let cubic = (u0 + u1) * 0.5 + (v0 - v1) * ((pair[1] - pair[0]) / 8.0);
        worst = worst.max((cubic - u).length() / (middle * v.length()));
    }
    worst
}

/// Directions spread evenly over the sphere.
fn fibonacci_direction(i: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / KNOT_PATHS as f64;
    let phi = i as f64 * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * phi.cos(), r * phi.sin(), z)
}
