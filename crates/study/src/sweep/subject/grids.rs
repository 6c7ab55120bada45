//! Grids of one manifold: one sampled grid is read in four ways.
//!
//! Discrete symmetries of a space, which a bundle takes out, would serve a grid just as well. They are
//! not taken out of the grids here, but their bytes count only by the share of cells and faces that a
//! bundle stores.

use crate::sweep::subject::Subject;
use crate::sweep::{
    grid::{Grid, Interpolation, Number, Samples, Stored},
    npz,
    patches::interrupted,
    point::{Key, Measured, Outcome, Point, What, load},
    speed,
};
use geofan_core::{Error, Result};

/// The four ways to read one sampled grid.
const READINGS: [(Interpolation, Number); 4] = [
    (Interpolation::Multilinear, Number::F32),
    (Interpolation::Multilinear, Number::U16),
    (Interpolation::Cubic, Number::F32),
    (Interpolation::Cubic, Number::U16),
];

impl Subject<'_> {
    /// The four readings of one sampled grid.
    pub(super) fn grids(&self, cells: &[usize]) -> Result<Vec<Point>> {
        let limits = self.effort.limits;
        let keys = READINGS.map(|reading| self.grid_key(reading, cells));
        let kept = keys.iter().map(|key| self.store.point(key, limits));
        let kept: Vec<Option<Point>> = kept.collect();
        if kept.iter().all(Option::is_some) && !self.export {
            return Ok(kept.into_iter().flatten().collect());
        }
        self.check()?;
        let nodes: Vec<usize> = cells.iter().map(|n| n + 1).collect();
        if let Some(why) = self.too_large(&nodes) {
            let why = || why.clone();
            let skip = |key| self.finish(key, Outcome::Skipped { why: why(), limits }, Vec::new());
            return keys.into_iter().map(skip).collect();
        }
        let samples = self.sampled(&nodes).ok_or_else(interrupted)?;
        if self.export {
            let name = format!("{}-{}", self.name(), keys[0].what.setting());
            npz::write(self.out, &name, &samples)?;
        }
        let read = |(key, kept): (Key, Option<Point>)| match kept {
            Some(point) => Ok(point),
            None => self.grid(key, &samples),
        };
        keys.into_iter().zip(kept).map(read).collect()
    }

    fn grid_key(&self, (interpolation, number): (Interpolation, Number), cells: &[usize]) -> Key {
        self.basis.of(What::Grid {
            interpolation,
            number,
            cells: cells.to_vec(),
        })
    }

    /// Why a grid of so many nodes is not made, if it is not.
    fn too_large(&self, nodes: &[usize]) -> Option<String> {
        let channels = Stored::Slope.channels(&self.grid_space).len();
        let factors = nodes
            .iter()
            .copied()
            .chain([self.grid_space.faces(), channels]);
        let bytes = factors.fold(4, |n: u64, factor| n.saturating_mul(factor as u64));
        let most = self.effort.limits.grid_bytes;
        (bytes > most).then(|| format!("skipped: {bytes} bytes, the limit is {most}"))
    }

    fn grid(&self, key: Key, samples: &Samples) -> Result<Point> {
        self.check()?;
        let What::Grid {
            interpolation,
            number,
            ..
        } = key.what
        else {
            return Err(Error::input("sweep", "a grid is needed"));
        };
        let length = self.basis.length;
        let grid = Grid::new(&self.grid_space, samples, length, interpolation, number);
        let times = speed::grid(&grid, self.u, length)?;
        // All of it is sampled, but only what a bundle would store is charged: the other samples are
        // the same up to signs.
        let bytes = (grid.bytes() as f64 * self.grid_share).ceil() as u64;
        let measured = Measured {
            disk: bytes,
            memory: bytes,
            errors: self.truth()?.errors(&grid)?,
            bake: grid.spent,
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
}
