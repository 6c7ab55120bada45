//! Options that all commands with pictures share.

use clap::Args;
use geofan::{
    Error, Result,
    bundle::Bundle,
    diagnostic::Diagnostic,
    geodesic::check_point,
    render::{Panels, Part, Stage, View, camera_point, picture::Format, scene::Lens, usual_size},
    terminal::values,
};
use std::path::{Path, PathBuf};

/// A scene, one of its cameras, and how finely to look.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// The scene file
    pub scene: PathBuf,
    /// The camera: the name of one of the scene's views [default: its main camera]
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// Picture size, of both eyes together [default: 1280x720, or what suits the projection]
    #[arg(long, value_name = "WxH", value_parser = values::picture_size)]
    pub size: Option<values::PictureSize>,
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
    /// Loads the scene; its manifold must be the one that `bundle` was baked from.
    pub fn stage(&self, bundle: Option<&Bundle>) -> Result<Stage> {
        let stage = Stage::load(&self.scene, &self.set)?;
        match bundle {
            Some(bundle) if bundle.manifold.fingerprint() != stage.world.manifold.fingerprint() => {
                Err(Error::input(
                    "--bundle",
                    format!(
                        "it was baked from another manifold (`{}`) than the scene's (`{}`), or with other parameters: bake again, or give the same --set",
                        bundle.manifold.name, stage.world.manifold.name
                    ),
                ))
            }
            _ => {
                for warning in &stage.world.warnings {
                    tracing::warn!("{warning}");
                }
                Ok(stage)
            }
        }
    }

    /// The view that the options ask for, by a camera that draws one picture.
    pub fn view(&self, stage: &Stage) -> Result<View> {
        self.panels(stage)?.single()
    }

    /// The parts of the picture that the options ask for.
    pub fn panels(&self, stage: &Stage) -> Result<Panels> {
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

    /// The size of a picture by `lens`.
    pub fn picture_size(&self, lens: &Lens) -> (usize, usize) {
        let asked = self.size.map(|size| (size.width, size.height));
        asked.unwrap_or_else(|| usual_size(lens))
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
