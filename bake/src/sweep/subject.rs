//! One manifold of the sweep.
//!
//! In: a manifold file. Out: its [`Point`]s in order, kept ones read and the others measured, and its
//! [`Rival`]s. What several points need (exact rays, maps, a sampled grid) is made when the first of
//! them is measured.

use super::{
    SweepArgs,
    effort::Effort,
    frames::Stage,
    grid::{Axes, FEWEST, Grid, Interpolation, Number, Samples, Spacing, balanced, cells},
    maps::{ErrorMap, Map, maps},
    npz,
    patches::{Attempt, Refinement, bake, interrupted},
    point::{Key, Measured, Outcome, Point, Store, What, load},
    rival::{Rival, rivals},
    speed,
    truth::{Lookup, Truth},
};
use crate::plan::plan;
use geofan::{
    Error, Result, bundle::PlanRecord, fan::FanSpace, manifold::Manifold, terminal::Interrupt,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{
    cell::OnceCell,
    path::{Path, PathBuf},
    sync::Arc,
};

/// A manifold being measured.
pub struct Subject<'a> {
    store: &'a Store,
    interrupt: &'a Interrupt,
    /// Where bundles and sampled fans go.
    out: &'a Path,
    /// Whether sampled fans are written.
    export: bool,
    effort: Effort,
    /// The key of all its points; of each, `what` differs.
    key: Key,
    space: FanSpace,
    /// The plan of its grids: how points are stored and how exactly they are integrated.
    grid_space: FanSpace,
    grid_plan: PlanRecord,
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
    key: Key,
    cells: Vec<f64>,
    rivals: Vec<Rival>,
}

/// The promise that the plan of grids is made for, mrad: their integration errors must not count.
const GRID_PROMISE: f64 = 0.02;

/// The four ways to read one sampled grid.
const READINGS: [(Interpolation, Number); 4] = [
    (Interpolation::Multilinear, Number::F32),
    (Interpolation::Multilinear, Number::U16),
    (Interpolation::Cubic, Number::F32),
    (Interpolation::Cubic, Number::U16),
];

/// Options of a subject that all manifolds share.
pub struct Shared<'a> {
    /// Kept results.
    pub store: &'a Store,
    /// Signals.
    pub interrupt: &'a Interrupt,
    /// The command's options.
    pub args: &'a SweepArgs,
}

impl Shared<'_> {
    /// What to measure of a space with so many camera parameters and axes.
    fn effort(&self, cameras: usize, axes: usize) -> Effort {
        let args = self.args;
        let usual = Effort::new(cameras, axes, args.quick);
        let own = |given: &[f64], usual: Vec<f64>| match given {
            [] => usual,
            given => given.to_vec(),
        };
        Effort {
            promises: own(&args.max_error, usual.promises),
            cells: own(&args.cells, usual.cells),
            rays: args.rays.unwrap_or(usual.rays),
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
        let space = FanSpace::new(manifold.clone())?;
        let axes = space.cameras().len() + space.directions() + 1;
        let effort = shared.effort(space.cameras().len(), axes);
        let (grid_space, grid_plan) = plan(space.clone(), length, GRID_PROMISE, true);
        let (format, version) = Key::current();
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let fingerprint = manifold.fingerprint();
        let region = manifold.cameras.as_ref();
        Ok(Self {
            store: shared.store,
            interrupt: shared.interrupt,
            out: &shared.args.out,
            export: shared.args.export_npz,
            key: Key {
                format,
                version,
                manifold: name.into_owned(),
                fingerprint: fingerprint.iter().map(|b| format!("{b:02x}")).collect(),
                length,
                rays: effort.rays,
                seed: shared.args.seed,
                // A place holder: every point has its own.
                what: What::Patches {
                    promise: 0.0,
                    refinement: Refinement::Adaptive,
                },
            },
            effort,
            u: region.map_or(DVec3::ZERO, |r| r.at(&r.lerp(&[0.5; 3]))),
            space,
            grid_space,
            grid_plan,
            truth: OnceCell::new(),
            maps: OnceCell::new(),
            stage: OnceCell::new(),
        })
    }

    /// Its file, without folder and ending.
    pub fn name(&self) -> &str {
        &self.key.manifold
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
        let undivided = self.effort.middle();
        let promises = self.effort.promises.iter();
        let adaptive = promises.map(|p| (*p, Refinement::Adaptive));
        let all = adaptive.chain(undivided.map(|p| (p, Refinement::Undivided)));
        let kept = self.kept_rivals()?;
        done("exact");
        for (promise, refinement) in all {
            points.push(self.patches(promise, refinement, &kept.rivals)?);
            done(&format!("patches {promise} mrad"));
        }
        for even in &self.effort.cells {
            points.extend(self.grids(&cells(*even, &kept.cells, FEWEST - 1))?);
            done(&format!("grids of {even:.0} cells"));
        }
        Ok(Results {
            title: self.space.manifold().name.clone(),
            name: self.key.manifold.clone(),
            cameras: self.space.cameras().len(),
            axes: self.space.cameras().len() + self.space.directions() + 1,
            points,
            rivals: kept.rivals,
        })
    }

    fn check(&self) -> Result<()> {
        match self.interrupt.requested() {
            true => Err(interrupted()),
            false => Ok(()),
        }
    }

    fn truth(&self) -> Result<&Truth> {
        if self.truth.get().is_none() {
            let (rays, seed) = (self.key.rays, self.key.seed);
            let truth = Truth::new(&self.space, self.key.length, rays, seed)?;
            let _ = self.truth.set(truth);
        }
        self.truth
            .get()
            .ok_or_else(|| Error::input("sweep", "no exact rays"))
    }

    fn maps(&self) -> &[Map] {
        self.maps.get_or_init(|| maps(&self.space, self.key.length))
    }

    /// The errors of `table` on the maps.
    fn mapped<L: Lookup>(&self, table: &L) -> Result<Vec<ErrorMap>> {
        self.maps().iter().map(|map| map.of(table)).collect()
    }

    /// The rivals, and the relative numbers of cells of grids.
    fn kept_rivals(&self) -> Result<KeptRivals> {
        let name = format!("{}-exact", self.key.manifold);
        let kept: Option<KeptRivals> = self.store.load(&name);
        if let Some(kept) = kept.filter(|kept| kept.key == self.key) {
            return Ok(kept);
        }
        self.check()?;
        let relative = match self.pilot() {
            Some(samples) => balanced(&samples),
            None => return Err(interrupted()),
        };
        let kept = KeptRivals {
            key: self.key.clone(),
            cells: relative,
            rivals: rivals(self.space.manifold(), self.truth()?, self.u),
        };
        self.store.keep(&name, &kept)?;
        Ok(kept)
    }

    /// A coarse grid with as many cells along every axis.
    fn pilot(&self) -> Option<Samples> {
        let axes = self.space.cameras().len() + self.space.directions() + 1;
        let coarsest = self.effort.cells.first().map_or(0.0, |cells| cells.round());
        let count = coarsest as usize + 1;
        self.sampled(&vec![count.max(FEWEST); axes])
    }

    fn sampled(&self, nodes: &[usize]) -> Option<Samples> {
        let (space, plan) = (&self.grid_space, &self.grid_plan);
        let axes = Axes::new(space, plan.length, nodes, Spacing::Uniform);
        Samples::new(space, axes, (plan.tolerance, true), || {
            self.interrupt.requested()
        })
    }

    fn patches(&self, promise: f64, refinement: Refinement, rivals: &[Rival]) -> Result<Point> {
        let key = self.key.of(What::Patches {
            promise,
            refinement,
        });
        if let Some(kept) = self.store.point(&key) {
            return Ok(kept);
        }
        self.check()?;
        let path = self.bundle_path(&key)?;
        let (space, limits) = (self.space.clone(), self.effort.limits);
        let length = self.key.length;
        let attempt = bake(
            space,
            length,
            (promise, refinement),
            limits,
            &path,
            self.interrupt,
        )?;
        let (outcome, maps) = match attempt {
            Attempt::Skipped(why) => (Outcome::Skipped(why), Vec::new()),
            Attempt::Baked(baked) => {
                let table = &baked.bundle.table;
                let errors = self.truth()?.errors(table)?;
                let times = speed::patches(table, self.u)?;
                let frame_ms = match self.stage()? {
                    Some(stage) => Some(stage.by_table(table, promise)?),
                    None => None,
                };
                let wanted =
                    refinement == Refinement::Adaptive && self.effort.middle() == Some(promise);
                let maps = if wanted {
                    self.mapped(table)?
                } else {
                    Vec::new()
                };
                let measured = Measured {
                    disk: baked.bytes,
                    memory: baked.memory()?,
                    errors,
                    bake_s: baked.seconds,
                    baked_rays: baked.rays,
                    contract_ms: times.contract_ms,
                    path_ns: times.path_ns,
                    frame_ms,
                    rival_frame_ms: self.rival_frame(rivals, errors.screen.p99)?,
                    load: load(),
                };
                (Outcome::Measured(Box::new(measured)), maps)
            }
        };
        self.finish(key, outcome, maps)
    }

    fn bundle_path(&self, key: &Key) -> Result<PathBuf> {
        let folder = self.out.join("bundles");
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        Ok(folder.join(format!("{}.fan", key.name())))
    }

    fn stage(&self) -> Result<Option<&Stage>> {
        if self.stage.get().is_none() {
            let _ = self.stage.set(Stage::new(self.space.manifold())?);
        }
        Ok(self.stage.get().and_then(Option::as_ref))
    }

    /// Milliseconds of a frame by the rival that is no worse than `p99`.
    fn rival_frame(&self, rivals: &[Rival], p99: f64) -> Result<Option<f64>> {
        let rival = super::rival::equal(rivals, p99);
        let stage = self.stage()?;
        let frame = stage.zip(rival);
        Ok(frame.map(|(stage, rival)| stage.by_steps(self.key.length, rival.steps)))
    }

    /// The four readings of one sampled grid.
    fn grids(&self, cells: &[usize]) -> Result<Vec<Point>> {
        let keys = READINGS.map(|(interpolation, number)| {
            self.key.of(What::Grid {
                interpolation,
                number,
                cells: cells.to_vec(),
            })
        });
        let kept: Vec<Option<Point>> = keys.iter().map(|key| self.store.point(key)).collect();
        if kept.iter().all(Option::is_some) && !self.export {
            return Ok(kept.into_iter().flatten().collect());
        }
        self.check()?;
        let nodes: Vec<usize> = cells.iter().map(|n| n + 1).collect();
        if let Some(why) = self.too_large(&nodes) {
            let skip = |key: Key| self.finish(key, Outcome::Skipped(why.clone()), Vec::new());
            return keys.into_iter().map(skip).collect();
        }
        let samples = self.sampled(&nodes).ok_or_else(interrupted)?;
        if self.export {
            let name = format!("{}-{}", self.key.manifold, keys[0].what.setting());
            npz::write(self.out, &name, &samples)?;
        }
        let mut points = Vec::new();
        for (key, kept) in keys.into_iter().zip(kept) {
            self.check()?;
            points.push(match kept {
                Some(point) => point,
                None => self.grid(key, &samples)?,
            });
        }
        Ok(points)
    }

    /// Why a grid of so many nodes is not made, if it is not.
    fn too_large(&self, nodes: &[usize]) -> Option<String> {
        let axes = Axes::new(&self.grid_space, self.key.length, nodes, Spacing::Uniform);
        let channels = super::grid::stored_channels(&self.grid_space, true).len();
        let bytes = 4 * (axes.rays() * axes.lengths.len() * channels) as u64;
        let most = self.effort.grid_bytes;
        (bytes > most).then(|| format!("skipped: {bytes} bytes, the limit is {most}"))
    }

    fn grid(&self, key: Key, samples: &Samples) -> Result<Point> {
        let What::Grid {
            interpolation,
            number,
            ..
        } = key.what
        else {
            return Err(Error::input("sweep", "a grid is needed"));
        };
        let length = self.key.length;
        let grid = Grid::new(&self.grid_space, samples, length, interpolation, number);
        let times = speed::grid(&grid, self.u, length)?;
        let measured = Measured {
            disk: grid.bytes(),
            memory: grid.bytes(),
            errors: self.truth()?.errors(&grid)?,
            bake_s: grid.seconds,
            baked_rays: samples.axes.rays() as u64,
            contract_ms: times.contract_ms,
            path_ns: times.path_ns,
            frame_ms: None,
            rival_frame_ms: None,
            load: load(),
        };
        let mapped = (interpolation, number) == (Interpolation::Cubic, Number::U16);
        let maps = if mapped {
            self.mapped(&grid)?
        } else {
            Vec::new()
        };
        self.finish(key, Outcome::Measured(Box::new(measured)), maps)
    }

    fn finish(&self, key: Key, outcome: Outcome, maps: Vec<ErrorMap>) -> Result<Point> {
        let point = Point { key, outcome, maps };
        self.store.keep(&point.key.name(), &point)?;
        Ok(point)
    }
}
