//! The light of a scene's lamps on its surfaces, for the commands that show it.

use crate::terminal::{CommonArgs, ProgressDisplay};
use geofan_core::Result;
use geofan_light::cache::{self, Source};
use geofan_render::Stage;
use std::path::{Path, PathBuf};

/// Local tolerance of the light's geodesics: shadows and brightness are then right to a part in a
/// hundred thousand, far below what a picture shows.
const TOLERANCE: f64 = 1e-6;

/// Puts the light of the scene's point lights, followed over `length`, on its surfaces; keeps it
/// beside `bundle` if there is one.
pub fn bake(
    stage: &mut Stage,
    bundle: Option<&Path>,
    length: f64,
    common: &CommonArgs,
) -> Result<()> {
    if stage.world.lights.is_empty() || stage.world.faces.is_empty() {
        return Ok(());
    }
    let progress = ProgressDisplay::new(common, "light", 0);
    let done = |more: usize, all: usize| {
        progress.set_total(all as u64);
        progress.inc(more as u64);
    };
    let path = bundle.map(beside);
    let (light, source) = cache::light(&stage.world, length, TOLERANCE, path.as_deref(), done)?;
    progress.finish();
    if let (Some(path), Source::Damaged) = (&path, source) {
        tracing::warn!(
            "{} was damaged; its light has been computed again",
            path.display()
        );
    }
    stage.world.light = Some(light);
    Ok(())
}

/// The name of the file with the light beside a bundle.
fn beside(bundle: &Path) -> PathBuf {
    let mut name = bundle.as_os_str().to_owned();
    name.push(".light");
    name.into()
}
