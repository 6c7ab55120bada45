//! Scenes for the commands with pictures: their common options, and the light of lamps on surfaces.

use crate::terminal::{CommonArgs, ProgressDisplay, values};
use clap::Args;
use geofan_bundle::Bundle;
use geofan_core::{Error, Result, diagnostic::Diagnostic, geodesic::check_point};
use geofan_light::cache::{self, LightmapSource};
use geofan_render::{
    Part, PicturePanels, Stage, View, camera_point, picture::Format, scene::Lens, usual_size,
};
use std::path::{Path, PathBuf};

/// Names a scene, one of its cameras, and how finely to look.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// The scene file
    pub scene: PathBuf,
    /// The camera: the name of one of the scene's views [default: its main camera]
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// Picture size, of both eyes together [default: 1280x720, or what suits the projection]
    #[arg(long, value_name = "WxH", value_parser = values::picture_size)]
    pub size: Option<(usize, usize)>,
    /// Draw only this part of the picture, in pixels from its upper left corner [default: the camera's]
    #[arg(long, value_name = "X,Y,W,H", value_parser = part)]
    pub crop: Option<Part>,
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

    /// Returns the view that the options ask for, by a camera that draws one picture.
    pub fn view(&self, stage: &Stage) -> Result<View> {
        self.panels(stage)?.single()
    }

    /// Returns the parts of the picture that the options ask for.
    pub fn panels(&self, stage: &Stage) -> Result<PicturePanels> {
        let camera = stage.camera(self.view.as_deref())?;
        let (source, manifold) = (&stage.scene.source, &stage.world.manifold);
        let u = camera_point(manifold, source, camera)?;
        // The domain does not say where the metric breaks down.
        if let Err(fault) = check_point(manifold, "the camera", u) {
            let span = camera.position_span.clone();
            return Err(Diagnostic::new(source, span, fault.to_string()).into());
        }
        let size = self.picture_size(&camera.lens);
        let panels = stage.panels(camera, size, self.crop.clone())?;
        if let Some(warning) = panels.warning() {
            tracing::warn!("{warning}");
        }
        Ok(panels)
    }

    /// Returns the size of a picture by `lens`.
    pub fn picture_size(&self, lens: &Lens) -> (usize, usize) {
        self.size.unwrap_or_else(|| usual_size(lens))
    }
}

/// Reads the part of a picture: `x,y,width,height` in pixels.
fn part(text: &str) -> std::result::Result<Part, String> {
    let wrong = || format!("`{text}` is not a part of a picture: write x,y,width,height in pixels");
    let numbers = text.split(',').map(|n| n.trim().parse::<u32>());
    let numbers: Vec<u32> = numbers
        .collect::<std::result::Result<_, _>>()
        .map_err(|_| wrong())?;
    let [x, y, width, height] = numbers.try_into().map_err(|_| wrong())?;
    let range = |start: u32, length: u32| start as usize..start as usize + length as usize;
    match width > 0 && height > 0 {
        true => Ok((range(x, width), range(y, height))),
        false => Err("a part of a picture needs at least one pixel".into()),
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
