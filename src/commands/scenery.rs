//! Scenes for the commands with pictures: their common options, and the light of lamps on surfaces.

use crate::terminal::{CommonArgs, ProgressDisplay, values};
use clap::Args;
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    diagnostic::Diagnostic,
    files,
    geodesic::{UnfinishedPaths, check_start},
    manifold::EventKind,
};
use geofan_light::cache::{self, LightmapSource};
use geofan_render::{
    DrawingOptions, Part, PicturePanels, Stage, View, World, camera_point,
    picture::PictureFormat,
    scene::{Lens, SceneFile},
    usual_size,
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
    /// Largest error of interpolation between looked-up paths, mrad [default: 0.5]
    #[arg(long, value_name = "MRAD", value_parser = values::positive)]
    pub error: Option<f64>,
    /// Local tolerance of the exact tracer, radians [default: 1e-8]
    #[arg(long, value_name = "T", value_parser = values::tolerance)]
    pub tolerance: Option<f64>,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    pub set: Vec<(String, f64)>,
    /// The time at which objects that move are shown [default: 0]
    #[arg(long, value_name = "T", value_parser = values::number)]
    pub at_time: Option<f64>,
}

impl SceneArgs {
    /// Returns the largest error of interpolation between looked-up paths, mrad.
    pub fn error(&self) -> f64 {
        self.error.unwrap_or(0.5)
    }

    /// Returns the local tolerance of the exact tracer.
    pub fn tolerance(&self) -> f64 {
        self.tolerance.unwrap_or(1e-8)
    }

    /// Returns how finely the options ask to draw.
    pub fn drawing(&self) -> DrawingOptions {
        DrawingOptions {
            samples: usize::from(self.spp),
            error: self.error(),
            tolerance: self.tolerance(),
            layers: false,
        }
    }

    /// Loads the scene, with meshes as far as paths of `length` go, or those of `bundle`; its manifold must mean the same as the
    /// one that the bundle was baked from.
    pub fn stage(&self, bundle: Option<&Bundle>, length: Option<f64>) -> Result<Stage> {
        let scene = SceneFile::load(&self.scene)?;
        if self.at_time.is_some() && !scene.moves() {
            let message = "nothing in this scene moves; leave it out, or give an object a `path`";
            return Err(Error::input("--at-time", message));
        }
        let length = length.or(bundle.map(|bundle| bundle.table.length));
        let stage = Stage::of_scene(scene, &self.set, self.at_time.unwrap_or(0.0), length)?;
        bundle.map_or(Ok(()), |bundle| stage.check_bundle(bundle))?;
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
        if let Err(fault) = check_start(manifold, "the camera", u) {
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

/// How paths are made longer: where they are integrated, and where they are in a bundle.
pub const LONGER_PATHS: &str = "give --length, or `length` under [cameras] in the manifold file";
pub const LONGER_TABLE: &str = "bake with --length";

/// What is said of a black picture of something.
pub const BLACK: &str =
    "the picture is black: no lamp, no glowing surface and no sky of the scene lights what is seen";

/// Warns where much of a picture shows nothing because paths were not followed far enough, and says how they
/// are made longer.
pub fn warn_unfinished(world: &World, found: &UnfinishedPaths, longer: &str) {
    let remedy = format!("{longer}; or give the scene a `length` sky");
    if !world.has_length_sky()
        && let Some(warning) = found.warning("this view is black in parts", &remedy)
    {
        let kinds = &world.manifold.domain.kinds;
        let has_exit = kinds.iter().any(|kind| matches!(kind, EventKind::Exit(_)));
        let ends = match !has_exit && found.enough.is_none() {
            true => {
                "; the manifold has no [[exit]], behind which there is a sky: give it one, or the scene a `length` sky"
            }
            false => "",
        };
        tracing::warn!("{warning}{ends}");
    }
}

/// Refuses an output that could not be written, before work is spent on it.
pub fn check_output(path: &Path) -> Result<()> {
    if PictureFormat::of(path).is_none() {
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
        _ => files::check_output(path),
    }
}

/// Refuses the first of some options that is given although it does nothing: its name, true if it is given to no
/// purpose, and what to do.
pub fn refuse_idle(options: &[(&str, bool, &str)]) -> Result<()> {
    match options.iter().find(|(_, is_idle, _)| *is_idle) {
        Some((option, _, remedy)) => {
            let message = format!("does nothing here: {remedy}");
            Err(Error::input(*option, message))
        }
        None => Ok(()),
    }
}

/// Puts the light of the scene's point lights, followed over `length`, on its surfaces; stores it beside
/// `bundle` if there is one.
pub fn light_up(stage: &mut Stage, bundle: Option<&Path>, length: f64, common: &CommonArgs) {
    if stage.world.lights.is_empty() || stage.world.faces.is_empty() {
        return;
    }
    let progress = ProgressDisplay::new(common, "light", 0);
    let done = |more: usize, all: usize| {
        progress.set_total(all as u64);
        progress.inc(more as u64);
    };
    let lit = cache::light_up(&mut stage.world, bundle, length, done);
    progress.finish();
    match lit {
        Some((Some(path), LightmapSource::Damaged)) => tracing::warn!(
            "{} was damaged; its light has been computed again",
            path.display()
        ),
        Some((Some(path), LightmapSource::NotKept)) => tracing::warn!(
            "the light of lamps is not kept, and will be computed again: {} is a file of another kind, or cannot be written",
            path.display()
        ),
        _ => {}
    }
}
