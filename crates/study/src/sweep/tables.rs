//! Tables as points of the sweep: bundles and grids.
//!
//! In: a manifold's rays, limits, and a promise or numbers of cells. Out: the bundle that `geofan bake` makes for the
//! promise, measured, or four measured points of one sampled grid, which is read in four ways; or the limit that the
//! table met.
//!
//! Discrete symmetries of a space, which a bundle takes out, would serve a grid just as well. They are not taken out of
//! the grids here, but their bytes count only by the share of cells and faces that a bundle stores.

use crate::sweep::{
    grid::{Grid, GridSamples, Interpolation, NumberFormat, slope_channels},
    manifold_sweep::{ManifoldSweep, Rival, equal_error},
    measurement::{self, PointOutcome, SweepPoint, TableMeasurement, TableSpec, TimeSpent, load},
    npz,
};
use geofan_bake::{
    BakeOptions,
    chunk_files::{BakedChunk, ChunkFiles},
    chunks::ChunkBaker,
    plan::{plan, usual_tangents},
};
use geofan_bundle::{Bundle, Contents, PlanRecord, Table, identity};
use geofan_core::{Error, Muted, Observer, Progress, Result, files::make_output_folder};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Says how patches are divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PatchDivision {
    /// As in any bundle: boxes are halved until held-out rays meet the promise.
    Adaptive,
    /// Boxes are not halved; rays that one polynomial cannot hold are flagged. It shows the worth of
    /// halving.
    Undivided,
}

impl PatchDivision {
    fn apply(self, plan: &mut PlanRecord) {
        if self == Self::Undivided {
            plan.least_volume = 1.0;
            plan.most_arc_halvings = 0;
        }
    }
}

/// A bundle with the cost of its bake.
struct BakedBundle {
    /// The bundle, without a certificate.
    bundle: Bundle,
    /// Its file's bytes.
    bytes: u64,
    /// Time of the bake.
    spent: TimeSpent,
    /// Number of rays integrated.
    rays: u64,
}

/// Ends work that takes too long. A sweep shows progress of its own.
struct TimeLimit<'a> {
    observer: &'a dyn Observer,
    began: TimeSpent,
    seconds: f64,
}

impl Observer for TimeLimit<'_> {
    fn progress(&self, _: Progress<'_>) {}

    fn cancelled(&self) -> bool {
        self.observer.cancelled() || TimeSpent::since(self.began).cpu_s > self.seconds
    }
}

/// Reports an interrupted sweep.
pub fn interrupted() -> Error {
    Error::Interrupted {
        resume: "measured points are kept; run the same command again to go on".into(),
    }
}

impl ManifoldSweep<'_> {
    /// Measures the bundle at a promise, or reads its point.
    pub(super) fn bundle(
        &self,
        promise: f64,
        division: PatchDivision,
        rivals: &[Rival],
    ) -> Result<SweepPoint> {
        let spec = TableSpec::Patches { promise, division };
        let limits = self.effort.limits;
        let mapped = division == PatchDivision::Adaptive && self.effort.middle() == Some(promise);
        // A point that was kept when another promise stood in the middle has no maps.
        let kept = self.store.point(&spec, limits);
        let kept = kept.filter(|p| !mapped || p.measured().is_none() || !p.maps.is_empty());
        if let Some(kept) = kept {
            return Ok(kept);
        }
        self.check()?;
        let path = self.bundle_path(&spec)?;
        let Some(baked) = self.bake(promise, division, &path)? else {
            let why = format!(
                "skipped: not finished after {:.0} s of processor time",
                limits.seconds
            );
            return self.finish(spec, PointOutcome::Skipped { why, limits }, Vec::new());
        };
        let measured = self.measured_bundle(&baked, promise, rivals)?;
        let maps = match mapped {
            true => self.mapped(&baked.bundle.table)?,
            false => Vec::new(),
        };
        self.finish(spec, PointOutcome::Measured(Box::new(measured)), maps)
    }

    /// Skips a promise below one that met a limit: it would take longer still.
    pub(super) fn beyond(&self, promise: f64) -> Result<SweepPoint> {
        let division = PatchDivision::Adaptive;
        let spec = TableSpec::Patches { promise, division };
        let limits = self.effort.limits;
        if let Some(kept) = self.store.point(&spec, limits) {
            return Ok(kept);
        }
        let why = "skipped: a looser promise met the limit".into();
        self.finish(spec, PointOutcome::Skipped { why, limits }, Vec::new())
    }

    /// Measures errors, sizes and times of a bundle.
    fn measured_bundle(
        &self,
        baked: &BakedBundle,
        promise: f64,
        rivals: &[Rival],
    ) -> Result<TableMeasurement> {
        let table = &baked.bundle.table;
        let errors = self.table_errors(table)?;
        let (fan, contract_ms) = measurement::bundle_fan(table, self.u)?;
        let view = self.default_view()?;
        let rival = equal_error(rivals, &errors);
        let rival_frame = |(view, rival): (_, &Rival)| {
            measurement::fixed_steps_frame(view, self.length(), rival.steps)
        };
        Ok(TableMeasurement {
            disk: baked.bytes,
            memory: memory(&baked.bundle)?,
            errors,
            bake: baked.spent,
            baked_rays: baked.rays,
            contract_ms,
            path_ns: measurement::bundle_path(&fan, table.length),
            frame_ms: view
                .map(|view| measurement::bundle_frame(view, table, promise))
                .transpose()?,
            rival_frame_ms: view.zip(rival).map(rival_frame),
            load: load(),
        })
    }

    /// Returns the path of a bundle's file, in a folder that is made if it is missing.
    fn bundle_path(&self, spec: &TableSpec) -> Result<PathBuf> {
        let folder = self.out.join("bundles");
        make_output_folder(&folder)?;
        Ok(folder.join(format!("{}.fan", self.store.name(spec))))
    }

    /// Bakes into the file `path`; `None` if that takes too long.
    fn bake(
        &self,
        promise: f64,
        division: PatchDivision,
        path: &Path,
    ) -> Result<Option<BakedBundle>> {
        let began = TimeSpent::now();
        let observer = Muted(self.observer);
        let (space, tangents) = (self.space.clone(), usual_tangents(&self.space, promise));
        let (space, mut plan) = plan(space, self.length(), promise, tangents, &observer)?;
        division.apply(&mut plan);
        let space = plan.applied(space);
        let id = identity(space.manifold(), &plan).map_err(|e| e.about(path))?;
        // No limit of size: the bytes that are counted while a bake runs are an estimate, at times far too large.
        let options = BakeOptions::default();
        let baker = ChunkBaker::new(&space, &plan, id, &options);
        let Some(chunks) = self.run(&baker, path)? else {
            return Ok(None);
        };
        // Writing the file is not counted: it does not depend on the bake.
        let rays = chunks.iter().map(|(_, baked)| baked.rays).sum();
        let chunks = chunks.into_iter().map(|(chunk, baked)| (chunk, baked.tree));
        let contents =
            Contents::new(space, plan, 0, chunks.collect()).map_err(|e| e.about(path))?;
        let spent = TimeSpent::since(began);
        let bytes = contents.write(path)?;
        let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
        Ok(Some(BakedBundle {
            bundle,
            bytes,
            spent,
            rays,
        }))
    }

    /// Bakes all chunks, whose files lie beside the file `path`; `None` if that takes too long.
    fn run(&self, baker: &ChunkBaker<'_>, path: &Path) -> Result<Option<Vec<(u32, BakedChunk)>>> {
        // Chunks of an earlier run would make this bake look quicker than it is.
        let files = ChunkFiles::open(path)?;
        files.discard()?;
        let limited = TimeLimit {
            observer: self.observer,
            began: TimeSpent::now(),
            seconds: self.effort.limits.seconds,
        };
        let chunks = baker.run(&files, &limited)?;
        files.remove()?;
        match chunks {
            None if self.observer.cancelled() => Err(interrupted()),
            chunks => Ok(chunks),
        }
    }
}

/// Counts the bytes when every patch is decoded: the coded chunks stay, and every integer takes 32 bits.
fn memory(bundle: &Bundle) -> Result<u64> {
    let table: &Table = &bundle.table;
    let mut sum = 0;
    for chunk in table.chunks.iter() {
        let tree = chunk.tree();
        let tree = tree.map_err(|e| Error::input("bundle", e.to_string()))?;
        sum += chunk.bytes().len() as u64 + 4 * tree.integers() as u64;
    }
    Ok(sum)
}

/// How a sampled grid is read between its nodes, and how its numbers are stored.
type GridReading = (Interpolation, NumberFormat);

/// The four ways to read one sampled grid.
const READINGS: [GridReading; 4] = [
    (Interpolation::Multilinear, NumberFormat::F32),
    (Interpolation::Multilinear, NumberFormat::U16),
    (Interpolation::Cubic, NumberFormat::F32),
    (Interpolation::Cubic, NumberFormat::U16),
];

impl ManifoldSweep<'_> {
    /// Measures the four readings of one sampled grid, or reads their points.
    pub(super) fn grids(&self, cells: &[usize]) -> Result<Vec<SweepPoint>> {
        let limits = self.effort.limits;
        let spec = |(interpolation, format)| TableSpec::Grid {
            interpolation,
            format,
            cells: cells.to_vec(),
        };
        // Nothing is sampled if all points are known.
        let specs = READINGS.map(|reading| (reading, spec(reading)));
        let kept = specs.iter().map(|(_, s)| self.store.point(s, limits));
        let kept: Vec<Option<SweepPoint>> = kept.collect();
        if kept.iter().all(Option::is_some) && !self.export {
            return Ok(kept.into_iter().flatten().collect());
        }
        self.check()?;
        let name = format!("{}-{}", self.name(), specs[0].1.setting());
        let points = specs.into_iter().zip(kept);
        let missing = |make: &dyn Fn(TableSpec, GridReading) -> Result<SweepPoint>| {
            let made =
                points.map(|((reading, spec), kept)| kept.map_or_else(|| make(spec, reading), Ok));
            made.collect()
        };
        let nodes: Vec<usize> = cells.iter().map(|n| n + 1).collect();
        if let Some(why) = self.too_large(&nodes) {
            let skipped = PointOutcome::Skipped { why, limits };
            return missing(&|spec, _| self.finish(spec, skipped.clone(), Vec::new()));
        }
        let samples = self.sampled(&nodes).ok_or_else(interrupted)?;
        if self.export {
            npz::write_samples(self.out, &name, &samples)?;
        }
        missing(&|spec, reading| self.grid(spec, reading, &samples))
    }

    /// Tells why a grid of so many nodes is not made, if it is not.
    fn too_large(&self, nodes: &[usize]) -> Option<String> {
        let channels = slope_channels(&self.grid_space).len();
        let factors = nodes
            .iter()
            .copied()
            .chain([self.grid_space.faces(), channels]);
        let bytes = factors.fold(4, |n: u64, factor| n.saturating_mul(factor as u64));
        let most = self.effort.limits.grid_bytes;
        (bytes > most).then(|| format!("skipped: {bytes} bytes, the limit is {most}"))
    }

    /// Measures one reading of a sampled grid.
    fn grid(
        &self,
        spec: TableSpec,
        reading: GridReading,
        samples: &GridSamples,
    ) -> Result<SweepPoint> {
        self.check()?;
        let length = self.length();
        let grid = Grid::new(&self.grid_space, samples, length, reading);
        let (fixed, contract_ms) = measurement::grid_fan(&grid, self.u)?;
        // All of it is sampled, but only the part that a bundle would store is charged: the other
        // samples differ from these by signs.
        let bytes = (grid.bytes() as f64 * self.grid_share).ceil() as u64;
        let measured = TableMeasurement {
            disk: bytes,
            memory: bytes,
            errors: self.table_errors(&grid)?,
            bake: grid.spent,
            baked_rays: samples.axes.rays() as u64,
            contract_ms,
            path_ns: measurement::grid_path(fixed, length),
            frame_ms: None,
            rival_frame_ms: None,
            load: load(),
        };
        let maps = match reading == (Interpolation::Cubic, NumberFormat::U16) {
            true => self.mapped(&grid)?,
            false => Vec::new(),
        };
        self.finish(spec, PointOutcome::Measured(Box::new(measured)), maps)
    }
}
