//! Bundles of one manifold.

use crate::sweep::subject::Subject;
use crate::sweep::{
    frames::Stage,
    patches::{Attempt, Baked, Refinement, bake},
    point::{Key, Measured, Outcome, Point, What, load},
    rival::{Rival, equal},
    speed,
};
use geofan_bundle::Table;
use geofan_core::{Error, Result};
use std::path::PathBuf;

impl Subject<'_> {
    /// The bundle at a promise.
    pub(super) fn patches(
        &self,
        promise: f64,
        refinement: Refinement,
        rivals: &[Rival],
    ) -> Result<Point> {
        let key = self.basis.of(What::Patches {
            promise,
            refinement,
        });
        if let Some(kept) = self.store.point(&key, self.effort.limits) {
            return Ok(kept);
        }
        self.check()?;
        let path = self.bundle_path(&key)?;
        let (space, limits) = (self.space.clone(), self.effort.limits);
        let asked = (promise, refinement);
        match bake(
            space,
            self.basis.length,
            asked,
            limits,
            &path,
            self.observer,
        )? {
            Attempt::Skipped(why) => {
                let skipped = Outcome::Skipped { why, limits };
                self.finish(key, skipped, Vec::new())
            }
            Attempt::Baked(baked) => {
                let measured = self.bundle(&baked, promise, rivals)?;
                let mapped =
                    refinement == Refinement::Adaptive && self.effort.middle() == Some(promise);
                let maps = match mapped {
                    true => self.mapped(&baked.bundle.table)?,
                    false => Vec::new(),
                };
                self.finish(key, Outcome::Measured(Box::new(measured)), maps)
            }
        }
    }

    /// A promise below one that met a limit: it would take longer still.
    pub(super) fn beyond(&self, promise: f64) -> Result<Point> {
        let key = self.basis.of(What::Patches {
            promise,
            refinement: Refinement::Adaptive,
        });
        let limits = self.effort.limits;
        if let Some(kept) = self.store.point(&key, limits) {
            return Ok(kept);
        }
        let why = "skipped: a looser promise met the limit".into();
        self.finish(key, Outcome::Skipped { why, limits }, Vec::new())
    }

    fn bundle(&self, baked: &Baked, promise: f64, rivals: &[Rival]) -> Result<Measured> {
        let table = &baked.bundle.table;
        let errors = self.truth()?.errors(table)?;
        let times = speed::patches(table, self.u)?;
        Ok(Measured {
            disk: baked.bytes,
            memory: baked.memory()?,
            errors,
            bake: baked.spent,
            baked_rays: baked.rays,
            contract_ms: times.contract_ms,
            path_ns: times.path_ns,
            frame_ms: self.frame(table, promise)?,
            rival_frame_ms: self.rival_frame(rivals, errors.screen.p99)?,
            load: load(),
        })
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

    /// Processor milliseconds of a frame by `table`.
    fn frame(&self, table: &Table, promise: f64) -> Result<Option<f64>> {
        let stage = self.stage()?;
        stage
            .map(|stage| stage.by_table(table, promise))
            .transpose()
    }

    /// Processor milliseconds of a frame by the rival that is no worse than `p99`.
    fn rival_frame(&self, rivals: &[Rival], p99: f64) -> Result<Option<f64>> {
        let frame = self.stage()?.zip(equal(rivals, p99));
        Ok(frame.map(|(stage, rival)| stage.by_steps(self.basis.length, rival.steps)))
    }
}
