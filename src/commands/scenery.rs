//! Scenes for the commands with pictures: their common options, and the light of lamps on surfaces.

use crate::terminal::{CommonArgs, ProgressDisplay, values};
use clap::Args;
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    diagnostic::Diagnostic,
    geodesic::{UnfinishedPaths, check_start},
};
use geofan_light::cache::{self, LightmapSource};
use geofan_render::{Stage, View, World, picture::Format};
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
        if let Some(bundle) = bundle {
            let differences = stage.world.manifold.differences(&bundle.manifold);
            if !differences.is_empty() {
                let message = format!(
                    "it was baked from another manifold (`{}`) than the scene's (`{}`): {} (the scene's first); bake again, or give the same --set",
                    bundle.manifold.name,
                    stage.world.manifold.name,
                    differences.join(", ")
                );
                return Err(Error::input("--bundle", message));
            }
        }
        for warning in &stage.world.warnings {
            tracing::warn!("{warning}");
        }
        Ok(stage)
    }

    /// Returns the view that the options ask for.
    pub fn view(&self, stage: &Stage) -> Result<View> {
        let camera = stage.camera(self.view.as_deref())?;
        let view = stage.view(camera, self.size)?;
        // The domain does not say where the metric breaks down.
        match check_start(&stage.world.manifold, "the camera", view.u) {
            Err(fault) => {
                let (source, span) = (&stage.scene.source, camera.position_span.clone());
                Err(Diagnostic::new(source, span, fault.to_string()).into())
            }
            Ok(()) => Ok(view),
        }
    }
}

/// How paths are made longer: where they are integrated, and where they are in a bundle.
pub const LONGER_PATHS: &str = "give --length, or `length` under [cameras] in the manifold file";
pub const LONGER_TABLE: &str = "bake with --length";

/// Warns where much of a picture shows nothing because paths were not followed far enough, and says how they
/// are made longer.
pub fn warn_unfinished(world: &World, found: &UnfinishedPaths, longer: &str) {
    let remedy = format!("{longer}; or give the scene a `length` sky");
    if !world.has_length_sky()
        && let Some(warning) = found.warning("this view is black in parts", &remedy)
    {
        tracing::warn!("{warning}");
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

/// Local tolerance of the light's geodesics: shadows and brightness are then right to a part in a
/// hundred thousand, far below what a picture shows.
const LIGHT_TOLERANCE: f64 = 1e-6;

/// Puts the light of the scene's point lights, followed over `length`, on its surfaces; stores it beside
/// `bundle` if there is one.
pub fn light_up(
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
    let path = bundle.map(light_file);
    let world = &stage.world;
    let (light, source) = cache::light(world, length, LIGHT_TOLERANCE, path.as_deref(), done)?;
    progress.finish();
    if let (Some(path), LightmapSource::Damaged) = (&path, source) {
        tracing::warn!(
            "{} was damaged; its light has been computed again",
            path.display()
        );
    }
    stage.world.light = Some(light);
    Ok(())
}

/// Returns the name of the file with the light beside a bundle.
fn light_file(bundle: &Path) -> PathBuf {
    let mut name = bundle.as_os_str().to_owned();
    name.push(".light");
    name.into()
}
