//! Fresh rays followed exactly, the errors of any table on them, and maps of these errors: over direction, and over camera
//! position.
//!
//! In: a manifold's rays, their number and a seed. Out: [`ExactFan`]s, made once for a manifold so that
//! all tables are compared on the same rays, and the [`TableErrors`] of one. Rays and errors are those
//! of `geofan check`: [`RandomRays`].
//!
//! In: a manifold's rays. Out: exact rays on regular maps, made once for a manifold, and the
//! [`ErrorMap`]s of tables on them. Errors are screen errors at the end of each path.
//!
//! | map | across | up | shows |
//! |---|---|---|---|
//! | direction | azimuth about the third axis of the standard frame | elevation | the error from the middle of the region |
//! | camera, 1 parameter | angle of the direction from the first axis, in the plane of the first two | the parameter | the error |
//! | camera, 2 or 3 parameters | the first | the second, the third in its middle | the 95th percentile over directions |

use crate::{
    comparison::{ProbedFan, finite},
    sweep::{grid::Grid, tables::interrupted},
};
use geofan_bake::{RandomRays, RayErrors, is_beyond_exit};
use geofan_bundle::{
    Table,
    measure::{Probed, probe, settings, with_end},
    rays::RaySpace,
};
use geofan_core::{
    Observer, Result, geodesic::check_start, manifold::CameraRegion, quantiles::Quantiles,
    random::Stream,
};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Keeps these random numbers apart from those that steer a bake.
const KEY: u64 = 0x7377_6565_7021;

/// Local tolerance of the exact tracer, radians: far below the best table's error.
const TOLERANCE: f64 = 1e-11;

/// Rays from one camera, with their exact states.
#[derive(Debug, Clone)]
pub struct ExactFan {
    /// The camera.
    pub u: DVec3,
    /// Directions in the standard frame, and the exact states along them.
    pub rays: Vec<(DVec3, Probed)>,
}

/// Tells the errors of a table as quantiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TableErrors {
    /// Transverse distance over arc length, mrad.
    pub mrad: Quantiles,
    /// The distance divided by the ray's magnification, mrad.
    pub screen: Quantiles,
    /// Sky error of the tangents at exits, mrad; without exits, at the places of the others.
    pub sky: Quantiles,
    /// Angle between the transported rotations, mrad; none if the table has none.
    pub rotation: Option<Quantiles>,
    /// The share of rays of which the table gives up a part.
    pub flagged: f64,
}

/// Compares a table's path from one camera, in a direction, with the exact one.
pub type FanErrors<'a> = Box<dyn Fn(DVec3, &Probed) -> RayErrors + 'a>;

/// Gives paths from any camera of a region.
pub trait FanTable: Sync {
    /// Fixes the camera at `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    fn fan_at(&self, u: DVec3) -> Result<FanErrors<'_>>;
}

impl FanTable for Table {
    fn fan_at(&self, u: DVec3) -> Result<FanErrors<'_>> {
        let fan = self.fan(u)?;
        Ok(Box::new(move |d, exact| {
            RayErrors::of_table(self, &fan.path(d), exact)
        }))
    }
}

impl FanTable for Grid {
    fn fan_at(&self, u: DVec3) -> Result<FanErrors<'_>> {
        let fan = self.fan(u)?;
        Ok(Box::new(move |d, exact| {
            let path = fan.path(d);
            let at = |s: f64| Some(path.at(s));
            let leaves = || is_beyond_exit(self.manifold(), exact, self.length(), at);
            let rotation = |s: f64| path.rotation(s);
            RayErrors::of_path(exact, (at, rotation), (true, f64::INFINITY), leaves)
        }))
    }
}

/// Follows so many fresh rays of `space`, drawn by `seed`.
///
/// # Errors
/// No camera lies in the domain, or an interruption.
pub fn exact_fans(
    space: &RaySpace,
    length: f64,
    (rays, seed): (usize, u64),
    observer: &dyn Observer,
) -> Result<Vec<ExactFan>> {
    let fans = RandomRays::all(space, (rays, length), [KEY, seed]).map(|random| {
        if observer.cancelled() {
            return Err(interrupted());
        }
        let RandomRays {
            u,
            directions,
            shares,
        } = random?;
        Ok(ExactFan::new(space, u, length, directions, |ray| {
            shares[ray]
        }))
    });
    fans.collect()
}

/// Returns what a rival is measured on.
pub fn probed(fans: &[ExactFan]) -> Vec<ProbedFan> {
    let first = |(d, probed): &(DVec3, Probed)| Some((*d, *probed.probes.first()?));
    let fan = |fan: &ExactFan| (fan.u, fan.rays.iter().filter_map(first).collect());
    fans.iter().map(fan).collect()
}

impl TableErrors {
    /// Measures `table` on `fans`.
    ///
    /// # Errors
    /// A camera is not in its region.
    pub fn new<T: FanTable>(table: &T, fans: &[ExactFan]) -> Result<Self> {
        let found = fans.par_iter().map(|fan| fan.compared(table));
        let found: Vec<RayErrors> = found.collect::<Result<Vec<_>>>()?.concat();
        let quantiles = |of: &dyn Fn(&RayErrors) -> Option<f64>| {
            let mut values: Vec<f64> = found.iter().filter_map(of).map(finite).collect();
            (!values.is_empty()).then(|| Quantiles::of(&mut values))
        };
        let flagged = found.iter().filter(|ray| ray.flagged).count();
        Ok(Self {
            mrad: quantiles(&|ray| Some(ray.deviation?.mrad)).unwrap_or_default(),
            screen: quantiles(&|ray| Some(ray.deviation?.screen_mrad)).unwrap_or_default(),
            sky: quantiles(&|ray| ray.sky_mrad).unwrap_or_default(),
            rotation: quantiles(&|ray| ray.rotation_mrad),
            flagged: flagged as f64 / found.len().max(1) as f64,
        })
    }
}

impl ExactFan {
    /// Follows rays along `directions` from `u`, and probes each at the share `share(ray)` of its path.
    pub fn new(
        space: &RaySpace,
        u: DVec3,
        length: f64,
        directions: Vec<DVec3>,
        share: impl Fn(usize) -> f64,
    ) -> Self {
        let rays: Vec<(DVec3, DVec3)> = directions.iter().map(|d| (u, *d)).collect();
        let lengths = |ray: usize, end: f64| with_end(share(ray), end);
        let manifold = space.manifold();
        let probed = probe(manifold, settings(TOLERANCE), length, &rays, lengths);
        Self {
            u,
            rays: directions.into_iter().zip(probed).collect(),
        }
    }

    /// Measures the screen error of `table` on each ray, mrad; NaN where there is none.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn screen_errors<T: FanTable>(&self, table: &T) -> Result<Vec<f64>> {
        let error = |ray: RayErrors| ray.deviation.map_or(f64::NAN, |d| d.screen_mrad);
        Ok(self.compared(table)?.into_iter().map(error).collect())
    }

    /// Compares `table` on each ray.
    fn compared<T: FanTable>(&self, table: &T) -> Result<Vec<RayErrors>> {
        let errors = table.fan_at(self.u)?;
        Ok(self
            .rays
            .iter()
            .map(|(d, exact)| errors(*d, exact))
            .collect())
    }
}

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
