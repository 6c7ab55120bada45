//! Scenes for the commands with pictures: their common options, and the light of lamps on surfaces.

use crate::terminal::{CommonArgs, ProgressDisplay, values};
use clap::Args;
use geofan_bundle::Bundle;
use geofan_core::{Error, Result};
use geofan_light::cache::{self, LightmapSource};
use geofan_render::{DrawingOptions, Stage, View, picture::Format};
use std::path::{Path, PathBuf};

/// Names a scene, one of its cameras, and how finely to look.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// The scene file
    pub scene: PathBuf,
    /// The camera: the name of one of the scene's views [default: its main camera]
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = values::picture_size)]
    pub size: (usize, usize),
    /// Samples for each pixel
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub spp: u16,
    /// Largest error of interpolation between looked-up paths, mrad
    #[arg(long, value_name = "MRAD", default_value = "0.5", value_parser = values::positive)]
    pub error: f64,
    /// Local tolerance of the exact tracer, radians
    #[arg(long, value_name = "T", default_value = "1e-8", value_parser = values::tolerance)]
    pub tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    pub set: Vec<(String, f64)>,
}

impl SceneArgs {
    /// Loads the scene; its manifold must mean the same as the one that `bundle` was baked from.
    pub fn stage(&self, bundle: Option<&Bundle>) -> Result<Stage> {
        let stage = Stage::load(&self.scene, &self.set)?;
        bundle.map_or(Ok(()), |bundle| stage.check_bundle(bundle))?;
        for warning in &stage.world.warnings {
            tracing::warn!("{warning}");
        }
        Ok(stage)
    }

    /// Returns how finely the options ask to draw.
    pub fn drawing(&self) -> DrawingOptions {
        DrawingOptions {
            samples: usize::from(self.spp),
            error: self.error,
            tolerance: self.tolerance,
        }
    }

    /// Returns the view that the options ask for.
    pub fn view(&self, stage: &Stage) -> Result<View> {
        stage.view_of(self.view.as_deref(), self.size)
    }
}

/// Refuses an output that could not be written, before work is spent on it.
pub fn check_output(path: &Path) -> Result<()> {
    if Format::of(path).is_none() {
        return Err(Error::input(
            path.display().to_string(),
            "pictures are .png or .exr",
        ));
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => Err(Error::input(
            path.display().to_string(),
            "the folder does not exist; make it first",
        )),
        _ => Ok(()),
    }
}

/// Puts the light of the scene's point lights, followed over `length`, on its surfaces; stores it beside
/// `bundle` if there is one.
pub fn light_up(
    stage: &mut Stage,
    bundle: Option<&Path>,
    length: f64,
    common: &CommonArgs,
) -> Result<()> {
    let progress = ProgressDisplay::new(common, "light", 0);
    let done = |more: usize, all: usize| {
        progress.set_total(all as u64);
        progress.inc(more as u64);
    };
    let lit = cache::light_up(&mut stage.world, bundle, length, done)?;
    progress.finish();
    if let Some((Some(path), LightmapSource::Damaged)) = lit {
        tracing::warn!(
            "{} was damaged; its light has been computed again",
            path.display()
        );
    }
    Ok(())
}
