//! Maps of a table's errors: over direction, and over camera position.
//!
//! In: a manifold's rays. Out: exact rays on regular maps, made once for a manifold, and the
//! [`ErrorMap`]s of tables on them. Errors are screen errors at the end of each path.
//!
//! | map | across | up | shows |
//! |---|---|---|---|
//! | direction | azimuth about the third axis of the standard frame | elevation | the error from the middle of the region |
//! | camera, 1 parameter | angle of the direction from the first axis, in the plane of the first two | the parameter | the error |
//! | camera, 2 or 3 parameters | the first | the second, the third in its middle | the 95th percentile over directions |

use crate::sweep::exact_rays::{ExactFan, FanTable};
use geofan_bundle::rays::RaySpace;
use geofan_core::{
    Result, geodesic::check_start, manifold::CameraRegion, quantiles::Quantiles, random::Stream,
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
    /// The coordinates of the map.
    pub over: MapDomain,
    /// Labels of the axes across and up, with units.
    pub labels: [String; 2],
    /// Ranges across and up.
    pub ranges: [[f64; 2]; 2],
    /// Rows from bottom to top; none where there is nothing to compare.
    pub rows: Vec<Vec<Option<f64>>>,
}

/// Names the coordinates of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapDomain {
    /// Directions from one camera.
    Direction,
    /// Camera positions.
    Camera,
}

/// Holds the exact rays of one map.
#[derive(Debug, Clone)]
pub struct MapRays {
    /// The map, without rows.
    empty: ErrorMap,
    columns: usize,
    /// Cells share the rays of their cameras evenly, in order: the rays of `fans` one after the other,
    /// `each` for every cell.
    each: usize,
    fans: Vec<ExactFan>,
}

/// Follows the rays of all maps of `space` over `length`.
pub fn map_rays(space: &RaySpace, length: f64) -> Vec<MapRays> {
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

/// Returns the middle of the interval numbered `i` of `n` equal ones.
fn middle(i: usize, n: usize, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * (i as f64 + 0.5) / n as f64
}

/// Returns the middles of a map's cells, row by row from the bottom.
fn cells((columns, rows): (usize, usize), ranges: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    let cell = |i: usize| {
        [
            middle(i % columns, columns, ranges[0]),
            middle(i / columns, rows, ranges[1]),
        ]
    };
    (0..columns * rows).map(cell).collect()
}

/// Follows the rays of the map over directions.
fn directions(space: &RaySpace, region: &CameraRegion, length: f64) -> MapRays {
    let ranges = [[-180.0, 180.0], [-90.0, 90.0]];
    let u = region.at(&region.lerp(&[0.5; 3]));
    let toward = |[azimuth, elevation]: [f64; 2]| {
        let (a, e) = (azimuth.to_radians(), elevation.to_radians());
        DVec3::new(a.cos() * e.cos(), a.sin() * e.cos(), e.sin())
    };
    let all: Vec<DVec3> = cells(DIRECTIONS, ranges).into_iter().map(toward).collect();
    let rows = all.par_chunks(DIRECTIONS.0);
    let fans = rows.map(|row| ExactFan::new(space, u, length, row.to_vec(), |_| SHARE));
    let labels = ["azimuth (degrees)".into(), "elevation (degrees)".into()];
    MapRays {
        empty: ErrorMap::empty(MapDomain::Direction, labels, ranges),
        columns: DIRECTIONS.0,
        each: 1,
        fans: fans.collect(),
    }
}

/// Follows the rays of the map over one camera parameter and the direction.
fn slice(space: &RaySpace, region: &CameraRegion, length: f64) -> MapRays {
    let ranges = [[0.0, 180.0], region.intervals[0]];
    let fan = |i: usize| {
        let u = region.at(&[middle(i, SLICE.0, ranges[1])]);
        let toward = |j: usize| {
            let angle = middle(j, SLICE.1, [0.0, PI]);
            DVec3::new(angle.cos(), angle.sin(), 0.0)
        };
        at(space, u, length, (0..SLICE.1).map(toward).collect())
    };
    let labels = [
        "angle of the direction from the first axis (degrees)".into(),
        format!("camera parameter {}", region.names[0]),
    ];
    MapRays {
        empty: ErrorMap::empty(MapDomain::Camera, labels, ranges),
        columns: SLICE.1,
        each: 1,
        fans: (0..SLICE.0).into_par_iter().map(fan).collect(),
    }
}

/// Follows the rays of the map over two camera parameters.
fn plane(space: &RaySpace, region: &CameraRegion, length: f64) -> MapRays {
    let ranges = [region.intervals[0], region.intervals[1]];
    let fan = |(i, [x, y]): (usize, [f64; 2])| {
        let mut parameters = region.lerp(&[0.5; 3]);
        (parameters[0], parameters[1]) = (x, y);
        let mut stream = Stream::new(&[0x6d61_7073, i as u64]);
        let directions = (0..EACH).map(|_| stream.direction()).collect();
        at(space, region.at(&parameters), length, directions)
    };
    let cells = cells(CAMERAS, ranges).into_par_iter().enumerate();
    let name = |k: usize| format!("camera parameter {}", region.names[k]);
    MapRays {
        empty: ErrorMap::empty(MapDomain::Camera, [name(0), name(1)], ranges),
        columns: CAMERAS.0,
        each: EACH,
        fans: cells.map(fan).collect(),
    }
}

/// Follows the rays from `u`, none where it is outside the domain or beyond an exit.
fn at(space: &RaySpace, u: DVec3, length: f64, directions: Vec<DVec3>) -> ExactFan {
    match check_start(space.manifold(), "camera", u) {
        Ok(_) => ExactFan::new(space, u, length, directions, |_| SHARE),
        Err(_) => ExactFan {
            u,
            rays: Vec::new(),
        },
    }
}

impl ErrorMap {
    fn empty(over: MapDomain, labels: [String; 2], ranges: [[f64; 2]; 2]) -> Self {
        Self {
            over,
            labels,
            ranges,
            rows: Vec::new(),
        }
    }
}

impl MapRays {
    /// Returns the number of rays of every camera that has some.
    fn rays_of_camera(&self) -> usize {
        let most = self.fans.iter().map(|fan| fan.rays.len()).max();
        most.unwrap_or(0)
    }

    /// Maps the errors of `table`.
    ///
    /// # Errors
    /// A camera is not in its region.
    pub fn measure<T: FanTable>(&self, table: &T) -> Result<ErrorMap> {
        let errors: Vec<Vec<f64>> = self
            .fans
            .par_iter()
            .map(|fan| match fan.rays.is_empty() {
                true => Ok(vec![f64::NAN; self.rays_of_camera()]),
                false => fan.screen_errors(table),
            })
            .collect::<Result<_>>()?;
        let errors: Vec<f64> = errors.into_iter().flatten().collect();
        // A cell shows the 95th percentile of its rays.
        let cell = |errors: &[f64]| {
            let mut known: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
            (!known.is_empty()).then(|| Quantiles::of(&mut known).p95)
        };
        let cells: Vec<Option<f64>> = errors.chunks(self.each).map(cell).collect();
        Ok(ErrorMap {
            rows: cells.chunks(self.columns).map(<[_]>::to_vec).collect(),
            ..self.empty.clone()
        })
    }
}
