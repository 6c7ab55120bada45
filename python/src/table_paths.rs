//! Paths of many rays through a table.
//!
//! In: cameras and directions, and where along the paths points and tangents are wanted. Out: columns of a result,
//! block by block; rays that the table gives up on are integrated.

use crate::{
    arrays::{Columns, VectorRows},
    exact_paths::{end_number, write_end, write_sample},
    work,
};
use geofan_bundle::{Bundle, Fan, TablePath, trace_in};
use geofan_core::{
    Observer, Result,
    geodesic::{End, Ray, Settings, check_point, paths},
    manifold::Carried,
};
use glam::DVec3;

/// Numbers of the columns of `paths`.
pub const U: usize = 0;
pub const V: usize = 1;

/// Numbers of the columns of `sky`.
const DIRECTION: usize = 1;
const LENGTH: usize = 2;

/// Paths to be read one by one.
pub struct TableTrace<'a> {
    /// The table.
    pub bundle: &'a Bundle,
    /// The cameras.
    pub at: &'a VectorRows<'a>,
    /// The directions, one for each camera.
    pub directions: &'a VectorRows<'a>,
    /// How far paths are read.
    pub length: f64,
    /// Samples of each path.
    pub samples: usize,
    /// Local tolerance of paths that are integrated.
    pub tolerance: f64,
}

impl TableTrace<'_> {
    /// Reads the paths of a block; tells which were integrated. Rays from one camera share its fan.
    pub fn block(
        &self,
        first: usize,
        mut columns: Columns<'_, 8, 2>,
        observer: &dyn Observer,
    ) -> Result<Vec<bool>> {
        work::go_on(observer)?;
        let manifold = &self.bundle.manifold;
        let mut known: Option<Fan> = None;
        let mut exact = Vec::new();
        for row in 0..columns.integers[0].len() {
            let u = self.at.at(first + row);
            let fan = match known.take() {
                Some(fan) if fan.place.u == u => fan,
                _ => {
                    check_point(manifold, &self.at.label(first + row), u)?;
                    self.bundle.fan(u)?
                }
            };
            let direction = self.directions.direction(first + row)?;
            let traced = trace_in(&fan, direction, self.length, self.samples, self.tolerance);
            for (i, sample) in traced.samples.iter().enumerate() {
                write_sample(row, i, sample, &mut columns);
            }
            let end = end_number(traced.end, manifold);
            write_end(row, (end, traced.length, traced.steps), &mut columns);
            exact.push(traced.exact);
            known = Some(fan);
        }
        Ok(exact)
    }
}

/// Looks up the rays of a block at the arc lengths `s`; those that the table gives up on are integrated.
pub fn look_up(
    fan: &Fan,
    (directions, first): (&VectorRows<'_>, usize),
    s: &[f64],
    tolerance: f64,
    mut columns: Columns<'_, 2, 1>,
    observer: &dyn Observer,
) -> Result<()> {
    work::go_on(observer)?;
    let mut rows = vec![0.0; 6 * s.len()];
    let mut given_up = Vec::new();
    for row in 0..columns.integers[0].len() {
        let direction = directions.direction(first + row)?;
        let known = fan.path(direction).sample_into(s, &mut rows);
        for (column, rows) in rows.chunks_exact(3 * s.len()).enumerate() {
            for i in 0..known {
                let values = [0, 1, 2].map(|k| rows[k * s.len() + i]);
                columns.put(column, row, 3 * i, &values);
            }
        }
        if known < s.len() {
            given_up.push((row, direction));
        }
    }
    integrate(fan, &given_up, s, tolerance, &mut columns);
    Ok(())
}

/// Follows exactly what a table gives up on, past exits as tables do.
fn integrate(
    fan: &Fan,
    rays: &[(usize, DVec3)],
    s: &[f64],
    tolerance: f64,
    columns: &mut Columns<'_, 2, 1>,
) {
    let Some(length) = s.last().copied().filter(|_| !rays.is_empty()) else {
        return;
    };
    let (manifold, settings) = (fan.space().manifold(), exact_settings(tolerance, false));
    let starts = rays
        .iter()
        .map(|(_, d)| Ray::new(manifold, fan.place.u, *d, length));
    for ((row, _), path) in rays.iter().zip(paths(manifold, settings, starts)) {
        columns.integers[0][*row] = 1;
        for (i, s) in s.iter().enumerate() {
            let step = path.step_at(*s).filter(|_| *s <= path.length);
            let Some(step) = step else {
                columns.blank(U, *row, 3 * i);
                columns.blank(V, *row, 3 * i);
                break;
            };
            columns.put(U, *row, 3 * i, &step.position(*s).to_array());
            columns.put(V, *row, 3 * i, &step.tangent(*s).to_array());
        }
    }
}

/// Follows paths alone.
fn exact_settings(tolerance: f64, events: bool) -> Settings {
    Settings {
        tolerance,
        carried: Carried::default(),
        events,
    }
}

/// Tells how the rays of a block end.
pub fn see_skies(
    fan: &Fan,
    (directions, first): (&VectorRows<'_>, usize),
    length: f64,
    tolerance: f64,
    mut columns: Columns<'_, 3, 1>,
    observer: &dyn Observer,
) -> Result<()> {
    work::go_on(observer)?;
    let manifold = fan.space().manifold();
    for row in 0..columns.integers[0].len() {
        let direction = directions.direction(first + row)?;
        let path = fan.path(direction);
        let found =
            ending(&path, length).or_else(|| exact_ending(fan, direction, length, tolerance));
        let Some((end, s, u, v)) = found else {
            columns.put(U, row, 0, &fan.place.u.to_array());
            columns.put(DIRECTION, row, 0, &[f64::NAN; 3]);
            columns.integers[0][row] = end_number(End::Singular, manifold);
            continue;
        };
        let exit = match end {
            End::Exit(k) => Some(k),
            _ => None,
        };
        let u = manifold.domain.wrap(u);
        let sky = manifold.sky_direction(exit, u, v);
        columns.put(U, row, 0, &u.to_array());
        columns.put(DIRECTION, row, 0, &sky.to_array());
        columns.put(LENGTH, row, 0, &[s]);
        columns.integers[0][row] = end_number(end, manifold);
    }
    Ok(())
}

/// How, where and in which direction a path ends.
type PathEnd = (End, f64, DVec3, DVec3);

/// Finds the end of a path in the table; `None` if the table gives up before.
fn ending(path: &TablePath<'_>, length: f64) -> Option<PathEnd> {
    let (end, s) = match path.first_event(length) {
        Some(found) => found,
        None if path.flagged_from() < length => return None,
        None => (End::Length, length),
    };
    let (u, v) = path.at(s)?;
    Some((end, s, u, v))
}

/// Finds it by integration; `None` for a path that ends where it starts.
fn exact_ending(fan: &Fan, d: DVec3, length: f64, tolerance: f64) -> Option<PathEnd> {
    let manifold = fan.space().manifold();
    let ray = Ray::new(manifold, fan.place.u, d, length);
    let path = paths(manifold, exact_settings(tolerance, true), [ray]).remove(0);
    let step = path.steps.last()?;
    let s = path.length;
    Some((path.end, s, step.position(s), step.tangent(s)))
}
