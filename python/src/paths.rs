//! Paths of many rays, exact and through a table, and all geodesics between points.
//!
//! In: points, directions, and where along the paths samples are wanted. Out: one array for each thing that
//! samples tell, written by all threads, block by block. A path's samples are those of `geofan trace`. Rays that a table
//! gives up on are integrated.

use crate::{
    arrays::{Columns, VectorRows, memory, room, zeros},
    manifold::vectors,
    work::{self, About},
};
use geofan_bundle::{Bundle, Fan, LookupError, TablePath, trace_in};
use geofan_core::{
    Error, Observer, Result,
    geodesic::{
        End, Path, Ray, RayPath, Sample, Settings, check_point, depart, elapsed, paths,
        paths_beside_poles, sample,
    },
    manifold::{Carried, Manifold},
};
use geofan_light::LightFan;
use glam::DVec3;
use numpy::{PyArray1, PyArrayMethods, ToPyArray};
use pyo3::{prelude::*, types::PyDict};
use rayon::prelude::*;

/// Rays followed by one thread at a time: enough to fill the integrator's lanes many times over.
pub const BLOCK: usize = 256;

/// Says where along paths samples are taken.
pub enum Places {
    /// So many, equally spaced from the start to each path's end.
    Even(usize),
    /// At these arc lengths; there are none beyond a path's end.
    At(Vec<f64>),
}

impl Places {
    /// Counts the samples of a path.
    pub fn count(&self) -> usize {
        match self {
            Self::Even(count) => *count,
            Self::At(s) => s.len(),
        }
    }

    /// Returns the arc length of a sample of a path that ended at `length`; `None` beyond.
    fn at(&self, i: usize, length: f64) -> Option<f64> {
        match self {
            Self::Even(count) => Some(length * (i as f64 / (count - 1) as f64)),
            Self::At(s) => Some(s[i]).filter(|s| *s <= length),
        }
    }
}

/// Says what to follow and what to tell.
pub struct TraceRequest<'a> {
    /// The space.
    pub manifold: &'a Manifold,
    /// How far.
    pub length: f64,
    /// Where samples are taken.
    pub places: Places,
    /// Local error of a step, radians.
    pub tolerance: f64,
    /// Whether frames and areas are wanted.
    pub carried: Carried,
    /// Whether conjugate points are wanted.
    pub conjugate: bool,
}

/// Numbers of the columns of samples.
const S: usize = 0;
const U: usize = 1;
const V: usize = 2;
const FRAME: usize = 3;
const AREA: usize = 4;
const REDSHIFT: usize = 5;
const TIME: usize = 6;
const LENGTH: usize = 7;

/// Names of the columns with how many numbers each sample has; the last has one a ray.
const FLOATS: [(&str, usize); 8] = [
    ("s", 1),
    ("u", 3),
    ("v", 3),
    ("frame", 9),
    ("area", 1),
    ("g", 1),
    ("t", 1),
    ("length", 0),
];

/// Numbers of the columns of whole numbers.
const END: usize = 0;
const STEPS: usize = 1;

type TraceColumns<'a> = Columns<'a, 8, 2>;

/// The arrays of a result.
pub struct TraceArrays<'py> {
    floats: [Bound<'py, PyArray1<f64>>; 8],
    integers: [Bound<'py, PyArray1<i32>>; 2],
    wanted: [bool; 8],
    samples: usize,
}

impl<'py> TraceArrays<'py> {
    /// Makes room for `rays` paths with so many samples; unwanted columns stay empty.
    pub fn new(
        py: Python<'py>,
        rays: usize,
        samples: usize,
        wanted: impl Fn(usize) -> bool,
    ) -> PyResult<Self> {
        let width = |width: usize| match width {
            0 => Some(1),
            width => width.checked_mul(samples),
        };
        let mut counts = [Some(0); 8];
        let wanted = std::array::from_fn(wanted);
        for (column, (_, each)) in FLOATS.iter().enumerate().filter(|(i, _)| wanted[*i]) {
            counts[column] = width(*each).and_then(|n| n.checked_mul(rays));
        }
        // The ends and the steps of a ray take as much as one number.
        let all = counts
            .iter()
            .try_fold(rays, |all, n| all.checked_add((*n)?));
        memory(py, "samples", all.and_then(|n| n.checked_mul(8)))?;
        let [s, u, v, frame, area, g, t, length] = counts.map(|n| zeros(py, n.unwrap_or(0)));
        let floats = [s?, u?, v?, frame?, area?, g?, t?, length?];
        let integers = [zeros(py, rays)?, zeros(py, rays)?];
        Ok(Self {
            floats,
            integers,
            wanted,
            samples,
        })
    }

    /// Lets `fill` write the columns.
    pub fn fill<T>(&self, fill: impl FnOnce(TraceColumns<'_>) -> PyResult<T>) -> PyResult<T> {
        let mut floats = self.floats.each_ref().map(|array| array.readwrite());
        let mut integers = self.integers.each_ref().map(|array| array.readwrite());
        let widths = FLOATS.map(|(_, width)| match width {
            0 => 1,
            width => width * self.samples,
        });
        let mut widths = widths.into_iter();
        let floats = floats.each_mut().map(|array| {
            let column = array.as_slice_mut().expect("a fresh array is contiguous");
            (column, widths.next().unwrap_or(1))
        });
        let integers = integers.each_mut();
        let integers = integers.map(|a| a.as_slice_mut().expect("a fresh array is contiguous"));
        fill(Columns { floats, integers })
    }

    /// Names the arrays that have been filled.
    pub fn into_dict(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (((name, _), array), wanted) in FLOATS.iter().zip(self.floats).zip(self.wanted) {
            if wanted {
                dict.set_item(name, array)?;
            }
        }
        for (name, array) in ["end", "steps"].iter().zip(self.integers) {
            dict.set_item(name, array)?;
        }
        Ok(dict)
    }
}

/// Returns the number under which an end is told: that of its exit, then that of `length`, then `singular`.
fn end_number(end: End, manifold: &Manifold) -> i32 {
    let exits = manifold.exits.len() as i32;
    match end {
        End::Exit(k) => k as i32,
        End::Length => exits,
        End::Singular => exits + 1,
    }
}

/// Follows rays and returns what is wanted of them.
pub fn trace<'py>(
    py: Python<'py>,
    request: &TraceRequest<'_>,
    at: &VectorRows<'_>,
    directions: &VectorRows<'_>,
) -> PyResult<Bound<'py, PyDict>> {
    let (rays, samples) = (at.len(), request.places.count());
    let manifold = request.manifold;
    let arrays = TraceArrays::new(py, rays, samples, |column| match column {
        FRAME => request.carried.frame,
        AREA => request.carried.deviation,
        REDSHIFT => manifold.has_redshift(),
        TIME => manifold.has_drift(),
        _ => true,
    })?;
    let conjugate = arrays.fill(|columns| {
        work::run(py, About::Input, |observer| {
            let blocks = columns.blocks(rays, BLOCK).into_par_iter().enumerate();
            let found: Result<Vec<Vec<Vec<f64>>>> = blocks
                .map(|(i, columns)| request.block(i * BLOCK, at, directions, columns, observer))
                .collect();
            Ok(found?.concat())
        })
    })?;
    let dict = arrays.into_dict(py)?;
    if request.conjugate {
        let lists = conjugate.iter().map(|s| s.to_pyarray(py));
        dict.set_item("conjugate", lists.collect::<Vec<_>>())?;
    }
    Ok(dict)
}

impl TraceRequest<'_> {
    /// Follows the rays of a block, the first of which is `first`; returns their conjugate points.
    fn block(
        &self,
        first: usize,
        at: &VectorRows<'_>,
        directions: &VectorRows<'_>,
        mut columns: TraceColumns<'_>,
        observer: &dyn Observer,
    ) -> Result<Vec<Vec<f64>>> {
        work::go_on(observer)?;
        let count = columns.integers[END].len();
        let rays = (first..first + count).map(|row| {
            let direction = directions.direction(row)?;
            depart(
                self.manifold,
                &at.label(row),
                at.at(row),
                direction,
                self.length,
            )
        });
        let rays: Vec<Ray> = rays.collect::<Result<_>>()?;
        // Conjugate points are told by how neighbours lie in the frame.
        let carried = Carried {
            frame: self.carried.frame || self.conjugate,
            ..self.carried
        };
        let settings = Settings {
            tolerance: self.tolerance,
            carried,
            events: true,
        };
        let found = paths_beside_poles(self.manifold, settings, &rays);
        let mut conjugate = Vec::new();
        for (row, followed) in found.iter().enumerate() {
            work::go_on(observer)?;
            self.write(row, followed, &mut columns);
            if self.conjugate {
                conjugate.push(followed.conjugate_points(self.manifold));
            }
        }
        Ok(conjugate)
    }

    /// Writes the samples of a path.
    fn write(&self, row: usize, followed: &RayPath, columns: &mut TraceColumns<'_>) {
        let RayPath { ray, path, .. } = followed;
        let mut start = None;
        for i in 0..self.places.count() {
            let Some(s) = self.places.at(i, path.length) else {
                blank_from(row, i, columns);
                break;
            };
            let mut found = followed.sample(self.manifold, s);
            found.frame = found.frame.filter(|_| self.carried.frame);
            write_sample(row, i, &found, columns);
            let start = *start.get_or_insert_with(|| self.start(ray, path, &found));
            if let Some(g) = self.manifold.redshift(start, (found.u, found.v)) {
                columns.put(REDSHIFT, row, i, &[g]);
            }
            if self.manifold.has_drift() {
                columns.put(TIME, row, i, &[elapsed(self.manifold, path, s)]);
            }
        }
        columns.put(LENGTH, row, 0, &[path.length]);
        columns.integers[END][row] = end_number(path.end, self.manifold);
        columns.integers[STEPS][row] = path.tried as i32;
    }

    /// Returns point and tangent at the start of a path.
    fn start(&self, ray: &Ray, path: &Path, first: &Sample) -> (DVec3, DVec3) {
        let start = match first.s == 0.0 || !self.manifold.has_redshift() {
            true => *first,
            false => sample(self.manifold, ray, path, 0.0),
        };
        (start.u, start.v)
    }
}

/// Writes the sample of number `i` of a ray.
fn write_sample(row: usize, i: usize, found: &Sample, columns: &mut TraceColumns<'_>) {
    columns.put(S, row, i, &[found.s]);
    columns.put(U, row, 3 * i, &found.u.to_array());
    columns.put(V, row, 3 * i, &found.v.to_array());
    if let Some(frame) = found.frame {
        columns.put(FRAME, row, 9 * i, &frame.to_cols_array());
    }
    if let Some(area) = found.area {
        columns.put(AREA, row, i, &[area]);
    }
}

/// Writes how a path ended.
fn write_end(row: usize, (end, length, steps): (i32, f64, usize), columns: &mut TraceColumns<'_>) {
    columns.put(LENGTH, row, 0, &[length]);
    columns.integers[END][row] = end;
    columns.integers[STEPS][row] = steps as i32;
}

/// Marks the samples of a ray from number `i` on as beyond its end.
fn blank_from(row: usize, i: usize, columns: &mut TraceColumns<'_>) {
    for (column, (_, width)) in FLOATS
        .iter()
        .enumerate()
        .filter(|(_, (_, width))| *width > 0)
    {
        columns.blank(column, row, width * i);
    }
}

/// Tells which columns a path from a table has, with or without `frames`.
pub fn is_known_to_table(column: usize, frames: bool) -> bool {
    match column {
        AREA | REDSHIFT | TIME => false,
        FRAME => frames,
        _ => true,
    }
}

/// Points that geodesics are found to at a time: between two looks at whether that is to go on.
const TARGETS: usize = 1024;

/// Finds the geodesics from `p` to each of `q` up to `length`, at a local tolerance: by the number of the point,
/// and for each by ascending length.
pub fn connect<'py>(
    py: Python<'py>,
    manifold: &Manifold,
    p: DVec3,
    q: &VectorRows<'_>,
    length: f64,
    tolerance: f64,
) -> PyResult<Bound<'py, PyDict>> {
    room(py, "q", &[q.len(), 3])?;
    let found = work::run(py, About::Input, |observer| {
        check_point(manifold, "p", p)?;
        let points = q.finite()?;
        for (row, u) in points.iter().enumerate() {
            check_point(manifold, &q.label(row), *u)?;
        }
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let region = points
            .iter()
            .fold(none, |(low, high), u| (low.min(*u), high.max(*u)));
        if points.is_empty() {
            return Ok(Vec::new());
        }
        let fan = LightFan::new(manifold, p, length, region);
        let mut found = Vec::new();
        for (block, points) in points.chunks(TARGETS).enumerate() {
            work::go_on(observer)?;
            let connected = fan.connections(points, tolerance).0;
            found.extend(connected.into_iter().map(|(i, c)| (block * TARGETS + i, c)));
        }
        Ok(found)
    })?;
    let dict = PyDict::new(py);
    let index = found.iter().map(|(index, _)| *index as i64).collect();
    dict.set_item("index", PyArray1::<i64>::from_vec(py, index))?;
    let column = |of: fn(&geofan_light::Connection) -> f64| {
        PyArray1::from_vec(py, found.iter().map(|(_, c)| of(c)).collect())
    };
    dict.set_item("length", column(|c| c.s))?;
    dict.set_item("area", column(|c| c.area))?;
    dict.set_item(
        "direction",
        vectors(py, found.iter().map(|(_, c)| c.direction))?,
    )?;
    dict.set_item("u", vectors(py, found.iter().map(|(_, c)| c.u))?)?;
    dict.set_item("v", vectors(py, found.iter().map(|(_, c)| c.v))?)?;
    Ok(dict)
}

/// Numbers of the columns of `paths`.
pub const TABLE_U: usize = 0;
pub const TABLE_V: usize = 1;

/// Numbers of the columns of `sky`.
const SKY_DIRECTION: usize = 1;
const SKY_LENGTH: usize = 2;

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
    /// Tells whether the table has transported frames.
    pub fn has_frames(&self) -> bool {
        self.bundle.table.frames
    }

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
            work::go_on(observer)?;
            let u = self.at.at(first + row);
            let fan = match known.take() {
                Some(fan) if fan.place.u == u => fan,
                _ => {
                    let name = self.at.label(first + row);
                    check_point(manifold, &name, u)?;
                    self.bundle.fan(u).map_err(|error| match error {
                        LookupError::OutsideRegion { .. } => Error::input(name, error.to_string()),
                        LookupError::Damaged { .. } => error.into(),
                    })?
                }
            };
            let direction = self.directions.direction(first + row)?;
            let traced = trace_in(&fan, direction, self.length, self.samples, self.tolerance);
            for (i, sample) in traced.samples.into_iter().enumerate() {
                // Of a path that is integrated they are known, but not to the table.
                let frame = sample.frame.filter(|_| self.has_frames());
                write_sample(row, i, &Sample { frame, ..sample }, &mut columns);
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
                columns.blank(TABLE_U, *row, 3 * i);
                columns.blank(TABLE_V, *row, 3 * i);
                break;
            };
            columns.put(TABLE_U, *row, 3 * i, &step.position(*s).to_array());
            columns.put(TABLE_V, *row, 3 * i, &step.tangent(*s).to_array());
        }
    }
}

/// Follows paths alone.
fn exact_settings(tolerance: f64, events: bool) -> Settings {
    Settings {
        events,
        ..Settings::bare(tolerance)
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
            columns.put(TABLE_U, row, 0, &fan.place.u.to_array());
            columns.put(SKY_DIRECTION, row, 0, &[f64::NAN; 3]);
            columns.integers[0][row] = end_number(End::Singular, manifold);
            continue;
        };
        let exit = match end {
            End::Exit(k) => Some(k),
            _ => None,
        };
        let u = manifold.domain.wrap(u);
        let sky = manifold.sky_direction(exit, u, v);
        columns.put(TABLE_U, row, 0, &u.to_array());
        columns.put(SKY_DIRECTION, row, 0, &sky.to_array());
        columns.put(SKY_LENGTH, row, 0, &[s]);
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
