//! One manifold of the sweep.
//!
//! In: a manifold file and the sweep's options. Out: its [`SweepPoint`]s in order, kept ones read and
//! the others measured, and its [`Rival`]s. Work that several points need (exact rays, maps, a sampled
//! grid) is done when the first of them is measured.

use crate::{
    comparison::rivals,
    sweep::{
        Spacing, SweepOptions,
        exact_rays::{
            ErrorMap, ExactFan, FanTable, MapRays, TableErrors, exact_fans, map_rays, probed,
        },
        grid::{FEWEST, GridAxes, GridSamples, balanced, cells, slope_channels},
        measurement::{
            self, Conditions, PointOutcome, PointStore, SweepPoint, TableLimits, TableSpec,
        },
        tables::{PatchDivision, interrupted},
    },
};
use geofan_bake::plan::{plan, usual_tangents};
use geofan_bundle::{
    PlanRecord,
    rays::{RaySpace, ReferenceSphere},
};
use geofan_core::{Muted, Observer, Result, manifold::Manifold, quantiles::Quantiles};
use geofan_render::{View, World};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{cell::OnceCell, path::Path, sync::Arc};

/// A manifold being measured.
pub struct ManifoldSweep<'a> {
    pub(super) observer: &'a dyn Observer,
    /// The folder for bundles and sampled fans.
    pub(super) out: &'a Path,
    /// Set if sampled fans are written.
    pub(super) export: bool,
    pub(super) effort: Effort,
    pub(super) store: PointStore,
    pub(super) space: RaySpace,
    /// The plan of its grids: how points are stored and how exactly they are integrated.
    pub(super) grid_space: RaySpace,
    grid_plan: PlanRecord,
    /// The share of a grid that the space's mirrors leave.
    pub(super) grid_share: f64,
    /// The camera of timings.
    pub(super) u: DVec3,
    exact: OnceCell<Vec<ExactFan>>,
    maps: OnceCell<Vec<MapRays>>,
    default_view: OnceCell<Option<(World, View)>>,
}

/// All results of one manifold.
#[derive(Debug, Clone)]
pub struct ManifoldResults {
    /// The manifold's name.
    pub title: String,
    /// The conditions of all measurements.
    pub conditions: Conditions,
    /// Number of stored camera parameters.
    pub cameras: usize,
    /// Number of axes, arc length included.
    pub axes: usize,
    /// Its points.
    pub points: Vec<SweepPoint>,
    /// Equal steps in single precision, fewest first.
    pub rivals: Vec<Rival>,
}

/// An integrator with a fixed number of steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rival {
    /// Equal steps over the length.
    pub steps: usize,
    /// Screen errors, mrad.
    pub screen: Quantiles,
    /// Processor nanoseconds for a path.
    pub path_ns: f64,
}

/// Says what is measured of one manifold.
#[derive(Debug, Clone)]
pub struct Effort {
    /// Promises of bundles, mrad, loosest first.
    pub promises: Vec<f64>,
    /// Even numbers of cells of grids, coarsest first.
    pub cells: Vec<f64>,
    /// Cells along every axis of the grid from which it is learnt how to share them out.
    pub pilot: usize,
    /// Limits of one table.
    pub limits: TableLimits,
    /// Number of fresh rays.
    pub rays: usize,
}

/// The promise that the plan of grids is made for, mrad: their integration errors must not count.
const GRID_PROMISE: f64 = 0.02;

/// An error, mrad, below which no table is.
const FLOOR: f64 = 1e-3;

/// An error, mrad, below which more steps that do not help mean that rounding of single precision
/// has been reached.
const ROUNDING: f64 = 1e-2;

/// Counts the axes of a table of `space`: camera…, direction…, arc length.
fn axes(space: &RaySpace) -> usize {
    space.cameras().len() + space.directions() + 1
}

impl Effort {
    /// Chooses what to measure of the rays of `space`: minutes of work for a quick sweep, else up to
    /// hours, unless the options say more.
    pub fn new(space: &RaySpace, options: &SweepOptions) -> Self {
        let (promises, seconds, grid_bytes, rays) = match options.quick {
            true => (quick_promises(space), 120.0, 128 << 20, 4_000),
            false => (full_promises(space), 900.0, 5 << 28, 20_000),
        };
        let usual_cells = usual_cells(axes(space), options.quick);
        let own = |given: &[f64], usual: &[f64]| match given {
            [] => usual.to_vec(),
            given => given.to_vec(),
        };
        let mut promises = own(&options.max_error, promises);
        promises.sort_by(|a, b| b.total_cmp(a));
        promises.dedup();
        let mut cells = own(&options.cells, &usual_cells);
        cells.sort_by(f64::total_cmp);
        cells.dedup();
        Self {
            promises,
            pilot: usual_cells[0] as usize,
            cells,
            limits: TableLimits {
                seconds,
                grid_bytes,
            },
            rays: options.rays.unwrap_or(rays),
        }
    }

    /// Returns the promise in the middle of the list: there errors are mapped, and one bundle is also
    /// made without halving.
    pub fn middle(&self) -> Option<f64> {
        self.promises.get(self.promises.len() / 2).copied()
    }
}

/// Returns promises of bundles for a quick sweep. Two and three camera parameters make large files: it
/// asks for little of them.
fn quick_promises(space: &RaySpace) -> &'static [f64] {
    match space.cameras().len() {
        0 | 1 => &[2.0, 0.5, 0.1],
        2 => &[10.0],
        _ => &[60.0],
    }
}

/// Returns promises of bundles for a full sweep.
fn full_promises(space: &RaySpace) -> &'static [f64] {
    match space.cameras().len() {
        0 | 1 => &[2.0, 0.5, 0.2, 0.1, 0.03],
        2 => &[30.0, 10.0, 3.0, 1.0],
        _ => &[60.0, 30.0, 15.0, 4.0, 1.0],
    }
}

/// Returns even numbers of cells of grids. Spacings are halved where axes are few; with more, doubling
/// all cells would leave two sizes between nothing and too much. The largest end near the limit of
/// bytes.
fn usual_cells(axes: usize, quick: bool) -> Vec<f64> {
    let root = std::f64::consts::SQRT_2;
    let (first, ratio, count) = match (axes, quick) {
        (0..=2, _) => (16.0, 2.0, 5),
        (3, true) => (8.0, 2.0, 4),
        (3, false) => (8.0, 2.0, 7),
        (4, true) => (6.0, root, 5),
        (4, false) => (6.0, root, 7),
        (5, true) => (4.0, root, 4),
        (5, false) => (4.0, root, 6),
        _ => (3.0, root, 5),
    };
    (0..count).map(|i| first * f64::powi(ratio, i)).collect()
}

impl<'a> ManifoldSweep<'a> {
    /// Loads the manifold in the file `path`.
    ///
    /// # Errors
    /// The file cannot work, or has no camera region or length; or the results' folder cannot be made.
    pub fn load(
        path: &Path,
        options: &'a SweepOptions,
        observer: &'a dyn Observer,
    ) -> Result<Self> {
        let manifold = Arc::new(Manifold::load(path, &[])?);
        let length = manifold.length_or(None)?;
        let space = RaySpace::new(manifold.clone())?;
        let effort = Effort::new(&space, options);
        let muted = Muted(observer);
        let tangents = usual_tangents(&space, GRID_PROMISE);
        let (grid_space, grid_plan) = plan(space.clone(), length, GRID_PROMISE, tangents, &muted)?;
        // The usual table knows directions by themselves.
        let grid_space = grid_space
            .with_reference_sphere(ReferenceSphere::default())
            .on_sphere(None);
        let division = grid_plan.division(&grid_space);
        let all = division.cells.iter().product::<usize>() * division.blocks;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let (name, rays) = (name.into_owned(), effort.rays);
        let conditions = Conditions::new(name, &manifold, length, rays, options.seed);
        let region = manifold.cameras.as_ref();
        Ok(Self {
            observer,
            out: &options.out,
            export: options.export_npz,
            effort,
            store: PointStore::open(&options.out, conditions)?,
            u: region.map_or(DVec3::ZERO, |r| r.at(&r.lerp(&[0.5; 3]))),
            space,
            grid_space,
            grid_plan,
            grid_share: division.chunks() as f64 / all as f64,
            exact: OnceCell::new(),
            maps: OnceCell::new(),
            default_view: OnceCell::new(),
        })
    }

    /// Returns the name of its file, without folder and ending.
    pub fn name(&self) -> &str {
        &self.store.conditions.manifold
    }

    /// Counts its pieces of work: bundles, grids, rivals.
    pub fn work(&self) -> u64 {
        (self.effort.promises.len() + 1 + self.effort.cells.len() + 1) as u64
    }

    /// Measures everything; `done` is told of every piece of work.
    ///
    /// # Errors
    /// Interrupted, or the folder cannot be written.
    pub fn measure(&self, done: impl Fn(&str)) -> Result<ManifoldResults> {
        let mut points = Vec::new();
        let (relative_cells, rivals) = self.baseline()?;
        done("exact");
        // Bundles, until one meets a limit: smaller promises would take longer still.
        let mut within_limits = true;
        for promise in self.effort.promises.iter().copied() {
            let point = match within_limits {
                true => self.bundle(promise, PatchDivision::Adaptive, &rivals)?,
                false => self.beyond(promise)?,
            };
            within_limits = point.measured().is_some();
            points.push(point);
            done(&format!("patches {promise} mrad"));
        }
        if let Some(promise) = self.effort.middle() {
            points.push(self.bundle(promise, PatchDivision::Undivided, &rivals)?);
            done("undivided patches");
        }
        for even in &self.effort.cells {
            points.extend(self.grids(&cells(*even, &relative_cells, FEWEST - 1))?);
            done(&format!("grids of {even:.0} cells"));
        }
        Ok(ManifoldResults {
            title: self.space.manifold().name.clone(),
            conditions: self.store.conditions.clone(),
            cameras: self.space.cameras().len(),
            axes: axes(&self.space),
            points,
            rivals,
        })
    }

    /// Ends the sweep if it has been cancelled.
    pub(super) fn check(&self) -> Result<()> {
        match self.observer.cancelled() {
            true => Err(interrupted()),
            false => Ok(()),
        }
    }

    /// Returns how far paths go.
    pub(super) fn length(&self) -> f64 {
        self.store.conditions.length
    }

    /// Measures the errors of `table` on the exact rays.
    pub(super) fn table_errors<T: FanTable>(&self, table: &T) -> Result<TableErrors> {
        TableErrors::new(table, self.exact()?)
    }

    /// Returns the exact rays on which tables are measured.
    fn exact(&self) -> Result<&[ExactFan]> {
        if self.exact.get().is_none() {
            let Conditions {
                length, rays, seed, ..
            } = self.store.conditions;
            let fans = exact_fans(&self.space, length, (rays, seed), self.observer)?;
            let _ = self.exact.set(fans);
        }
        Ok(self.exact.get().map_or(&[], Vec::as_slice))
    }

    /// Maps the errors of `table`.
    pub(super) fn mapped<T: FanTable>(&self, table: &T) -> Result<Vec<ErrorMap>> {
        let maps = || map_rays(&self.space, self.length());
        let maps = self.maps.get_or_init(maps).iter();
        maps.map(|rays| rays.measure(table)).collect()
    }

    /// Returns what frames are drawn of; `None` without a camera region.
    pub(super) fn default_view(&self) -> Result<Option<&(World, View)>> {
        if self.default_view.get().is_none() {
            let made = measurement::default_view(self.space.manifold())?;
            let _ = self.default_view.set(made);
        }
        Ok(self.default_view.get().and_then(Option::as_ref))
    }

    /// Returns the relative numbers of cells of grids, and the rivals: kept ones, or measured now.
    fn baseline(&self) -> Result<(Vec<f64>, Vec<Rival>)> {
        let name = format!("{}-exact", self.name());
        if let Some(kept) = self.store.load(&name) {
            return Ok(kept);
        }
        self.check()?;
        // A coarse grid with as many cells along every axis tells how to share them out.
        let nodes = vec![self.effort.pilot + 1; axes(&self.space)];
        let samples = self.sampled(&nodes).ok_or_else(interrupted)?;
        let baseline = (balanced(&samples), self.rivals()?);
        self.store.keep(&name, &baseline)?;
        Ok(baseline)
    }

    /// Measures rivals, fewest steps first, until their errors are small enough.
    fn rivals(&self) -> Result<Vec<Rival>> {
        let (manifold, length) = (self.space.manifold(), self.length());
        let fans = probed(self.exact()?);
        let mut found: Vec<Rival> = Vec::new();
        for (steps, screen) in rivals(manifold, &fans, length) {
            self.check()?;
            let before = found.last().map_or(f64::INFINITY, |last| last.screen.p99);
            let path_ns = measurement::fixed_steps_path(manifold, self.u, length, steps);
            found.push(Rival {
                steps,
                screen,
                path_ns,
            });
            if screen.p99 < FLOOR || (before < ROUNDING && screen.p99 >= before) {
                break;
            }
        }
        Ok(found)
    }

    /// Samples the slopes of all rays on `nodes` nodes along every axis; `None` if it is cancelled.
    pub(super) fn sampled(&self, nodes: &[usize]) -> Option<GridSamples> {
        let (space, plan) = (&self.grid_space, &self.grid_plan);
        let axes = GridAxes::new(space, plan.length, nodes, Spacing::Uniform);
        let channels = slope_channels(space);
        GridSamples::new(space, axes, plan.tolerance, channels, || {
            self.observer.cancelled()
        })
    }

    /// Keeps a point.
    pub(super) fn finish(
        &self,
        spec: TableSpec,
        outcome: PointOutcome,
        maps: Vec<ErrorMap>,
    ) -> Result<SweepPoint> {
        let point = SweepPoint {
            spec,
            outcome,
            maps,
        };
        self.store.keep(&self.store.name(&point.spec), &point)?;
        Ok(point)
    }
}

/// Largest share of rays that a table gives up at which it is held against rivals: they are measured on all rays, and the
/// 99th percentile of more would be that of rays which the table does not hold.
pub const MOST_FLAGGED: f64 = 0.01;

/// Picks the quickest of `rivals` whose 99th percentile of screen errors is no worse than that of a table with these
/// `errors`; `None` if none is, or if the table gives up more than [`MOST_FLAGGED`] of all rays.
pub fn equal_error<'r>(rivals: &'r [Rival], errors: &TableErrors) -> Option<&'r Rival> {
    let mut rivals = rivals.iter();
    (errors.flagged <= MOST_FLAGGED)
        .then(|| rivals.find(|rival| rival.screen.p99 <= errors.screen.p99))
        .flatten()
}
