//! A scene made ready: its manifold loaded, its world placed, its cameras known.
//!
//! In: a scene file, parameter settings, perhaps a bundle. Out: a [`Stage`].

use super::{
    panels::{Panels, Part},
    scene::{CameraEntry, SceneFile},
    view::{View, camera_point},
    world::World,
};
use crate::{
    error::{Error, Result},
    manifold::Manifold,
};
use std::{path::Path, sync::Arc};

/// A scene with everything it names.
pub struct Stage {
    /// The file.
    pub scene: SceneFile,
    /// What can be seen.
    pub world: World,
}

impl Stage {
    /// Loads the scene at `path`; `settings` replace parameters of its manifold.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(path: &Path, settings: &[(String, f64)]) -> Result<Self> {
        let scene = SceneFile::load(path)?;
        let manifold = Manifold::load(&scene.manifold, settings).map_err(|e| match e {
            // A missing file is the scene's fault, and the scene says where it is named.
            Error::Input { message, .. } if !scene.manifold.exists() => {
                crate::diagnostic::Diagnostic::new(
                    &scene.source,
                    scene.manifold_span.clone(),
                    format!("{}: {message}", scene.manifold.display()),
                )
                .with_hint("paths are relative to the scene file")
                .into()
            }
            other => other,
        })?;
        let world = World::new(&scene, Arc::new(manifold))?;
        Ok(Self { scene, world })
    }

    /// The camera called `name`, or the main one.
    ///
    /// # Errors
    /// There is no such camera.
    pub fn camera(&self, name: Option<&str>) -> Result<&CameraEntry> {
        let Some(name) = name else {
            return Ok(&self.scene.camera);
        };
        self.scene.view(name).ok_or_else(|| {
            let known: Vec<&str> = self
                .scene
                .views
                .iter()
                .filter_map(|v| v.name.as_deref())
                .collect();
            let known = match known.is_empty() {
                true => "none".into(),
                false => known.join(", "),
            };
            Error::input(
                "--view",
                format!("the scene has no view `{name}`; it has: {known}"),
            )
        })
    }

    /// The view of a camera of this scene.
    ///
    /// # Errors
    /// The camera is outside the domain, or draws several pictures.
    pub fn view(&self, camera: &CameraEntry, size: (usize, usize)) -> Result<View> {
        self.panels(camera, size, None)?.single()
    }

    /// The parts of the picture of a camera of this scene; of `crop` alone, if there is one.
    ///
    /// # Errors
    /// The camera is outside the domain, or the picture cannot be divided as its lens asks.
    pub fn panels(
        &self,
        camera: &CameraEntry,
        size: (usize, usize),
        crop: Option<Part>,
    ) -> Result<Panels> {
        let u = camera_point(&self.world.manifold, &self.scene.source, camera)?;
        Panels::new(&self.world.manifold, (camera, u), size, crop)
    }
}
