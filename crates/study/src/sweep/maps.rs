//! Where a table errs: over direction, and over camera position.
//!
//! In: a manifold's rays. Out: exact rays on regular maps, made once for a manifold, and the
//! [`ErrorMap`]s of tables on them. Errors are screen errors at the end of each path.
//!
//! | map | across | up | shows |
//! |---|---|---|---|
//! | direction | azimuth about the third axis of the standard frame | elevation | the error from the middle of the region |
//! | camera, 1 parameter | angle of the direction from the first axis, in the plane of the first two | the parameter | the error |
//! | camera, 2 or 3 parameters | the first | the second, the third in its middle | the 95th percentile over directions |

use crate::sweep::truth::{Camera, Lookup};
use geofan_bundle::rays::RaySpace;
use geofan_core::{
    Result, geodesic::check_point, manifold::CameraRegion, quantiles::Quantiles, random::Stream,
};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Cells of the map over directions: 5 degrees.
const DIRECTIONS: (usize, usize) = (72, 36);

/// Cells of the map over one camera parameter and the direction.
const SLICE: (usize, usize) = (60, 36);

/// Cells of the map over two camera parameters.
const CAMERAS: (usize, usize) = (20, 20);

/// Random directions of each of those.
const EACH: usize = 24;

/// Paths are compared just before their ends.
const SHARE: f64 = 1.0 - 1e-9;

/// Errors over a rectangle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorMap {
    /// What it is over.
    pub over: Over,
    /// What runs across and up, with units.
    pub labels: [String; 2],
    /// Ranges across and up.
    pub ranges: [[f64; 2]; 2],
    /// Rows from bottom to top; none where there is nothing to compare.
    pub rows: Vec<Vec<Option<f64>>>,
}

/// What a map is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Over {
    /// Directions from one camera.
    Direction,
    /// Camera positions.
    Camera,
}

/// Exact rays of one map.
#[derive(Debug, Clone)]
pub struct Map {
    over: Over,
    labels: [String; 2],
    ranges: [[f64; 2]; 2],
    columns: usize,
    /// Cells share the rays of their cameras evenly, in order: the rays of `cameras` one after the
    /// other, `each` for every cell.
    each: usize,
    cameras: Vec<Camera>,
}

/// The maps of the rays of `space` over `length`.
pub fn maps(space: &RaySpace, length: f64) -> Vec<Map> {
    let Some(region) = &space.manifold().cameras else {
        return Vec::new();
    };
    let over_camera = match region.dimension() {
        0 => None,
        1 => Some(slice(space, region, length)),
        _ => Some(plane(space, region, length)),
    };
    let direction = directions(space, region, length);
    [direction].into_iter().chain(over_camera).collect()
}

fn middle(i: usize, n: usize, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * (i as f64 + 0.5) / n as f64
}

/// The cells of a map, row by row from the bottom.
fn cells((columns, rows): (usize, usize), ranges: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    let cell = |i: usize| {
        [
            middle(i % columns, columns, ranges[0]),
            middle(i / columns, rows, ranges[1]),
        ]
    };
    (0..columns * rows).map(cell).collect()
}

fn directions(space: &RaySpace, region: &CameraRegion, length: f64) -> Map {
    let ranges = [[-180.0, 180.0], [-90.0, 90.0]];
    let u = region.at(&region.lerp(&[0.5; 3]));
    let toward = |[azimuth, elevation]: [f64; 2]| {
        let (a, e) = (azimuth.to_radians(), elevation.to_radians());
        DVec3::new(a.cos() * e.cos(), a.sin() * e.cos(), e.sin())
    };
    let all: Vec<DVec3> = cells(DIRECTIONS, ranges).into_iter().map(toward).collect();
    let rows = all.par_chunks(DIRECTIONS.0);
    let cameras = rows.map(|row| Camera::new(space, u, length, row.to_vec(), |_| SHARE));
    Map {
        over: Over::Direction,
        labels: ["azimuth (degrees)".into(), "elevation (degrees)".into()],
        ranges,
        columns: DIRECTIONS.0,
        each: 1,
        cameras: cameras.collect(),
    }
}

fn slice(space: &RaySpace, region: &CameraRegion, length: f64) -> Map {
    let ranges = [[0.0, 180.0], region.intervals[0]];
    let camera = |i: usize| {
        let u = region.at(&[middle(i, SLICE.0, ranges[1])]);
        let toward = |j: usize| {
            let angle = middle(j, SLICE.1, [0.0, PI]);
            DVec3::new(angle.cos(), angle.sin(), 0.0)
        };
        at(space, u, length, (0..SLICE.1).map(toward).collect())
    };
    Map {
        over: Over::Camera,
        labels: [
            "angle of the direction from the first axis (degrees)".into(),
            format!("camera parameter {}", region.names[0]),
        ],
        ranges,
        columns: SLICE.1,
        each: 1,
        cameras: (0..SLICE.0).into_par_iter().map(camera).collect(),
    }
}

fn plane(space: &RaySpace, region: &CameraRegion, length: f64) -> Map {
    let ranges = [region.intervals[0], region.intervals[1]];
    let camera = |(i, [x, y]): (usize, [f64; 2])| {
        let mut parameters = region.lerp(&[0.5; 3]);
        (parameters[0], parameters[1]) = (x, y);
        let mut stream = Stream::new(&[0x6d61_7073, i as u64]);
        let directions = (0..EACH).map(|_| stream.direction()).collect();
        at(space, region.at(&parameters), length, directions)
    };
    let cells = cells(CAMERAS, ranges).into_par_iter().enumerate();
    let name = |k: usize| format!("camera parameter {}", region.names[k]);
    Map {
        over: Over::Camera,
        labels: [name(0), name(1)],
        ranges,
        columns: CAMERAS.0,
        each: EACH,
        cameras: cells.map(camera).collect(),
    }
}

/// The exact rays from `u`, none where it is outside the domain.
fn at(space: &RaySpace, u: DVec3, length: f64, directions: Vec<DVec3>) -> Camera {
    match check_point(space.manifold(), "camera", u) {
        Ok(_) => Camera::new(space, u, length, directions, |_| SHARE),
        Err(_) => Camera {
            u,
            rays: Vec::new(),
        },
    }
}

impl Map {
    /// Rays of every camera.
    fn of_camera(&self) -> usize {
        let most = self.cameras.iter().map(|camera| camera.rays.len()).max();
        most.unwrap_or(0)
    }

    /// The errors of `table`.
    ///
    /// # Errors
    /// A camera is not in its region.
    pub fn of<L: Lookup>(&self, table: &L) -> Result<ErrorMap> {
        let cameras = self.cameras.par_iter();
        let errors: Vec<Vec<f64>> = cameras
            .map(|camera| match camera.rays.is_empty() {
                true => Ok(vec![f64::NAN; self.of_camera()]),
                false => camera.screen_errors(table),
            })
            .collect::<Result<_>>()?;
        let errors: Vec<f64> = errors.into_iter().flatten().collect();
        let cell = |errors: &[f64]| {
            let mut known: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
            (!known.is_empty()).then(|| Quantiles::of(&mut known).p95)
        };
        let cells: Vec<Option<f64>> = errors.chunks(self.each).map(cell).collect();
        Ok(ErrorMap {
            over: self.over,
            labels: self.labels.clone(),
            ranges: self.ranges,
            rows: cells.chunks(self.columns).map(<[_]>::to_vec).collect(),
        })
    }
}
