//! Grids as points of the sweep: one sampled grid is read in four ways.
//!
//! In: a manifold's rays, numbers of cells, limits. Out: four measured points; or the limit that the
//! grid would meet. Discrete symmetries of a space, which a bundle takes out, would serve a grid just as
//! well. They are not taken out of the grids here, but their bytes count only by the share of cells and
//! faces that a bundle stores.

use crate::sweep::{
    bundles::interrupted,
    grid::{Grid, GridSamples, Interpolation, NumberFormat, slope_channels},
    manifold_sweep::ManifoldSweep,
    npz,
    point::{PointOutcome, SweepPoint, TableMeasurement, TableSpec, load},
    timing,
};
use geofan_core::Result;

/// The four ways to read one sampled grid.
const READINGS: [(Interpolation, NumberFormat); 4] = [
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
        let nodes: Vec<usize> = cells.iter().map(|n| n + 1).collect();
        if let Some(why) = self.too_large(&nodes) {
            let skipped = || PointOutcome::Skipped {
                why: why.clone(),
                limits,
            };
            let skip = |(_, spec)| self.finish(spec, skipped(), Vec::new());
            return specs.into_iter().map(skip).collect();
        }
        let samples = self.sampled(&nodes).ok_or_else(interrupted)?;
        if self.export {
            let name = format!("{}-{}", self.name(), specs[0].1.setting());
            npz::write_samples(self.out, &name, &samples)?;
        }
        let points = specs.into_iter().zip(kept);
        let measured = |((reading, spec), kept): (_, Option<SweepPoint>)| match kept {
            Some(point) => Ok(point),
            None => self.grid(spec, reading, &samples),
        };
        points.map(measured).collect()
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
        reading: (Interpolation, NumberFormat),
        samples: &GridSamples,
    ) -> Result<SweepPoint> {
        self.check()?;
        let length = self.length();
        let grid = Grid::new(&self.grid_space, samples, length, reading);
        let (fixed, contract_ms) = timing::grid_fan(&grid, self.u)?;
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
            path_ns: timing::grid_path(fixed, length),
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
