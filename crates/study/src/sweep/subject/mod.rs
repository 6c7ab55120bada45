//! One manifold of the sweep.
//!
//! In: a manifold file. Out: its [`Point`]s in order, kept ones read and the others measured, and its
//! [`Rival`]s. What several points need (exact rays, maps, a sampled grid) is made when the first of
//! them is measured.

mod bundles;
mod grids;

use crate::sweep::{
    Spacing, SweepOptions,
    effort::{Effort, Extent},
    frames::Stage,
    grid::{Axes, FEWEST, Samples, Stored, balanced, cells},
    maps::{ErrorMap, Map, maps},
    patches::{Refinement, interrupted},
    point::{Basis, Key, Outcome, Point, Store},
    rival::{Rival, rivals},
    truth::{Lookup, Truth},
};
use geofan_bake::plan::plan;
use geofan_bundle::{
    PlanRecord,
    rays::{RaySpace, ReferenceSphere},
};
use geofan_core::{Error, Muted, Observer, Result, manifold::Manifold};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{cell::OnceCell, path::Path, sync::Arc};

/// A manifold being measured.
pub struct Subject<'a> {
    store: &'a Store,
    observer: &'a dyn Observer,
    /// Where bundles and sampled fans go.
    out: &'a Path,
    /// Whether sampled fans are written.
    export: bool,
    effort: Effort,
    basis: Basis,
    space: RaySpace,
    /// The plan of its grids: how points are stored and how exactly they are integrated.
    grid_space: RaySpace,
    grid_plan: PlanRecord,
    /// The share of a grid that the space's mirrors leave.
    grid_share: f64,
    /// The camera of timings.
    u: DVec3,
    truth: OnceCell<Truth>,
    maps: OnceCell<Vec<Map>>,
    stage: OnceCell<Option<Stage>>,
}

/// All results of one manifold.
#[derive(Debug, Clone)]
pub struct Results {
    /// The manifold's name.
    pub title: String,
    /// Its file, without folder and ending.
    pub name: String,
    /// Stored camera parameters.
    pub cameras: usize,
    /// Axes, arc length included.
    pub axes: usize,
    /// Its points.
    pub points: Vec<Point>,
    /// Equal steps in single precision, fewest first.
    pub rivals: Vec<Rival>,
}

/// What is kept of the rivals.
#[derive(Serialize, Deserialize)]
struct KeptRivals {
    basis: Basis,
    cells: Vec<f64>,
    rivals: Vec<Rival>,
}

/// The promise that the plan of grids is made for, mrad: their integration errors must not count.
const GRID_PROMISE: f64 = 0.02;

/// Axes of a table of `space`: camera…, direction…, arc length.
fn axes(space: &RaySpace) -> usize {
    space.cameras().len() + space.directions() + 1
}

/// Options of a subject that all manifolds share.
pub struct Shared<'a> {
    /// Kept results.
    pub store: &'a Store,
    /// Signals.
    pub observer: &'a dyn Observer,
    /// What to measure.
    pub options: &'a SweepOptions,
}

impl Shared<'_> {
    /// What to measure of the rays of `space`.
    fn effort(&self, space: &RaySpace) -> Effort {
        let options = self.options;
        let extent = match options.quick {
            true => Extent::Quick,
            false => Extent::Full,
        };
        let usual = Effort::new(space.cameras().len(), axes(space), extent);
        let own = |given: &[f64], usual: Vec<f64>| match given {
            [] => usual,
            given => given.to_vec(),
        };
        let mut promises = own(&options.max_error, usual.promises);
        promises.sort_by(|a, b| b.total_cmp(a));
        Effort {
            promises,
            cells: own(&options.cells, usual.cells),
            rays: options.rays.unwrap_or(usual.rays),
            ..usual
        }
    }
}

impl<'a> Subject<'a> {
    /// The manifold in the file `path`.
    ///
    /// # Errors
    /// The file cannot work, or has no camera region or length.
    pub fn load(path: &Path, shared: &Shared<'a>) -> Result<Self> {
        let manifold = Arc::new(Manifold::load(path, &[])?);
        let length = manifold.length_or(None)?;
        let space = RaySpace::new(manifold.clone())?;
        let effort = shared.effort(&space);
        let observer = Muted(shared.observer);
        let (grid_space, grid_plan) = plan(space.clone(), length, GRID_PROMISE, true, &observer)?;
        // The usual table knows directions by themselves.
        let grid_space = grid_space
            .focused(ReferenceSphere::default())
            .on_sphere(None);
        let division = grid_plan.division(&grid_space);
        let all = division.cells.iter().product::<usize>() * division.blocks;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let (name, seed) = (name.into_owned(), shared.options.seed);
        let region = manifold.cameras.as_ref();
        Ok(Self {
            store: shared.store,
            observer: shared.observer,
            out: &shared.options.out,
            export: shared.options.export_npz,
            basis: Basis::new(name, &manifold, length, effort.rays, seed),
            effort,
            u: region.map_or(DVec3::ZERO, |r| r.at(&r.lerp(&[0.5; 3]))),
            space,
            grid_space,
            grid_plan,
            grid_share: division.chunks() as f64 / all as f64,
            truth: OnceCell::new(),
            maps: OnceCell::new(),
            stage: OnceCell::new(),
        })
    }

    /// Its file, without folder and ending.
    pub fn name(&self) -> &str {
        &self.basis.manifold
    }

    /// How many pieces of work it has: bundles, grids, rivals.
    pub fn work(&self) -> u64 {
        (self.effort.promises.len() + 1 + self.effort.cells.len() + 1) as u64
    }

    /// All its results; `done` is told of every piece of work.
    ///
    /// # Errors
    /// Interrupted, or the folder cannot be written.
    pub fn measure(&self, done: impl Fn(&str)) -> Result<Results> {
        let mut points = Vec::new();
        let kept = self.kept_rivals()?;
        done("exact");
        let mut within_limits = true;
        for promise in self.effort.promises.iter().copied() {
            let point = match within_limits {
                true => self.patches(promise, Refinement::Adaptive, &kept.rivals)?,
                false => self.beyond(promise)?,
            };
            within_limits = point.measured().is_some();
            points.push(point);
            done(&format!("patches {promise} mrad"));
        }
        if let Some(promise) = self.effort.middle() {
            points.push(self.patches(promise, Refinement::Undivided, &kept.rivals)?);
            done("undivided patches");
        }
        for even in &self.effort.cells {
            points.extend(self.grids(&cells(*even, &kept.cells, FEWEST - 1))?);
            done(&format!("grids of {even:.0} cells"));
        }
        Ok(Results {
            title: self.space.manifold().name.clone(),
            name: self.basis.manifold.clone(),
            cameras: self.space.cameras().len(),
            axes: axes(&self.space),
            points,
            rivals: kept.rivals,
        })
    }

    fn check(&self) -> Result<()> {
        match self.observer.cancelled() {
            true => Err(interrupted()),
            false => Ok(()),
        }
    }

    fn truth(&self) -> Result<&Truth> {
        if self.truth.get().is_none() {
            let (rays, seed) = (self.basis.rays, self.basis.seed);
            let truth = Truth::new(&self.space, self.basis.length, rays, seed)?;
            let _ = self.truth.set(truth);
        }
        self.truth
            .get()
            .ok_or_else(|| Error::input("sweep", "no exact rays"))
    }

    fn maps(&self) -> &[Map] {
        self.maps
            .get_or_init(|| maps(&self.space, self.basis.length))
    }

    /// The errors of `table` on the maps.
    fn mapped<L: Lookup>(&self, table: &L) -> Result<Vec<ErrorMap>> {
        self.maps().iter().map(|map| map.of(table)).collect()
    }

    /// The rivals, and the relative numbers of cells of grids.
    fn kept_rivals(&self) -> Result<KeptRivals> {
        let name = format!("{}-exact", self.basis.manifold);
        let kept: Option<KeptRivals> = self.store.load(&name);
        if let Some(kept) = kept.filter(|kept| kept.basis == self.basis) {
            return Ok(kept);
        }
        self.check()?;
        let relative = match self.pilot() {
            Some(samples) => balanced(&samples),
            None => return Err(interrupted()),
        };
        let kept = KeptRivals {
            basis: self.basis.clone(),
            cells: relative,
            rivals: rivals(self.space.manifold(), self.truth()?, self.u),
        };
        self.store.keep(&name, &kept)?;
        Ok(kept)
    }

    /// A coarse grid with as many cells along every axis.
    fn pilot(&self) -> Option<Samples> {
        self.sampled(&vec![self.effort.pilot + 1; axes(&self.space)])
    }

    fn sampled(&self, nodes: &[usize]) -> Option<Samples> {
        let (space, plan) = (&self.grid_space, &self.grid_plan);
        let axes = Axes::new(space, plan.length, nodes, Spacing::Uniform);
        Samples::new(space, axes, (plan.tolerance, Stored::Slope), || {
            self.observer.cancelled()
        })
    }

    fn finish(&self, key: Key, outcome: Outcome, maps: Vec<ErrorMap>) -> Result<Point> {
        let point = Point { key, outcome, maps };
        self.store.keep(&point.key.name(), &point)?;
        Ok(point)
    }
}
