//! A scene with everything it names, ready for pictures.
//!
//! In: the path of a scene file, and settings of its manifold. Out: a [`Stage`]: the file and its [`World`], and the views of
//! its cameras.

use super::{
    chart_skies::sky_warnings,
    panels::{Part, PicturePanels},
    scene::{CameraEntry, SceneFile},
    view::{View, camera_point, camera_velocity},
    world::World,
};
use geofan_bundle::{
    Bundle, Contents, Table,
    container::{MAGIC, MOST_BYTES},
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    geodesic::check_point,
    manifold::Manifold,
    reading::read_file,
};
use std::{path::Path, sync::Arc};

/// Loads the manifold of a file, which may be a bundle: it has the text of its manifold in it.
fn load_manifold(path: &Path, settings: &[(String, f64)]) -> Result<Manifold> {
    // Of another file this reads the first bytes only.
    match read_file(path, MAGIC, MOST_BYTES) {
        Ok(bytes) if bytes.starts_with(MAGIC) => {
            let name = path.display().to_string();
            let contents = Contents::decode(&name, &bytes).map_err(|e| e.about(path))?;
            contents.manifold_with(&name, settings)
        }
        _ => Manifold::load(path, settings),
    }
}

/// A scene with everything it names.
pub struct Stage {
    /// The file.
    pub scene: SceneFile,
    /// Everything that can be seen.
    pub world: World,
}

impl Stage {
    /// Loads the scene at `path` as it is at the time 0; `settings` replace parameters of its manifold.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(path: &Path, settings: &[(String, f64)]) -> Result<Self> {
        Self::of_scene(SceneFile::load(path)?, settings, 0.0)
    }

    /// Loads all that `scene` names, as it is at `time`; `settings` replace parameters of its manifold.
    ///
    /// # Errors
    /// As [`Stage::load`].
    pub fn of_scene(scene: SceneFile, settings: &[(String, f64)], time: f64) -> Result<Self> {
        let manifold = load_manifold(&scene.manifold, settings).map_err(|e| match e {
            // A missing file is the scene's fault, and the scene says where it is named.
            Error::Input { message, .. } if !scene.manifold.exists() => Diagnostic::new(
                &scene.source,
                scene.manifold_span.clone(),
                format!("{}: {message}", scene.manifold.display()),
            )
            .with_hint("paths are relative to the scene file")
            .into(),
            other => other,
        })?;
        let mut world = World::new(&scene, Arc::new(manifold), time)?;
        if let Ok(u) = camera_point(&world.manifold, &scene.source, &scene.camera) {
            world.warnings.extend(sky_warnings(&world, u));
        }
        Ok(Self { scene, world })
    }

    /// Moves objects to where they are at `time`.
    ///
    /// # Errors
    /// As [`World::set_time`].
    pub fn set_time(&mut self, time: f64) -> Result<()> {
        self.world.set_time(&self.scene, time)
    }

    /// Returns the camera called `name`, or the main one.
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

    /// Refuses a bundle that was baked from another manifold than the scene's.
    ///
    /// # Errors
    /// Says what differs.
    pub fn check_bundle(&self, bundle: &Bundle) -> Result<()> {
        let own = &self.world.manifold;
        let differences = own.differences_of_covers(&bundle.manifold);
        if differences.is_empty() {
            return Ok(());
        }
        let message = format!(
            "it was baked from another manifold (`{}`) than the scene's (`{}`): {} (the scene's first); bake again, or give the same --set",
            bundle.manifold.name,
            self.world.manifold.name,
            differences.join(", ")
        );
        Err(Error::input("--bundle", message))
    }

    /// Refuses a camera of this scene of which a view is outside of the region that `table` knows; where each ray has a
    /// place of its own, only the camera's counts.
    ///
    /// # Errors
    /// Says where, at the camera's place in the scene.
    pub fn check_region<'v>(
        &self,
        table: &Table,
        camera: &CameraEntry,
        views: impl IntoIterator<Item = &'v View>,
    ) -> Result<()> {
        let source = &self.scene.source;
        let own = camera_point(&self.world.manifold, source, camera)?;
        for view in views {
            let Err(fault) = table.space.place(view.u) else {
                continue;
            };
            let complaint =
                Diagnostic::new(source, camera.position_span.clone(), fault.to_string());
            let complaint = match (view.u - own).length() > 0.0 && camera.lens.stereo.is_some() {
                true => complaint.with_label("an eye of its `stereo` pair"),
                false => complaint,
            };
            return Err(complaint
                .with_hint("draw it with --tracer exact, move the camera, or bake a larger region (`[cameras]` in the manifold file)")
                .into());
        }
        Ok(())
    }

    /// Returns the view of the camera called `name`, or of the main one, where a path can start.
    ///
    /// # Errors
    /// There is no such camera, or it is where the metric breaks down, of which the domain need not tell.
    pub fn view_of(&self, name: Option<&str>, size: (usize, usize)) -> Result<View> {
        let camera = self.camera(name)?;
        let view = self.view(camera, size)?;
        match check_point(&self.world.manifold, "the camera", view.u) {
            Err(fault) => {
                let (source, span) = (&self.scene.source, camera.position_span.clone());
                Err(Diagnostic::new(source, span, fault.to_string()).into())
            }
            Ok(()) => Ok(view),
        }
    }

    /// Returns the view of a camera of this scene.
    ///
    /// # Errors
    /// The camera is outside the domain, or draws several pictures.
    pub fn view(&self, camera: &CameraEntry, size: (usize, usize)) -> Result<View> {
        self.panels(camera, size, None)?.single()
    }

    /// Returns the parts of the picture of a camera of this scene; of `crop` alone, if there is one.
    ///
    /// # Errors
    /// The camera is outside the domain, or the picture cannot be divided as its lens asks.
    pub fn panels(
        &self,
        camera: &CameraEntry,
        size: (usize, usize),
        crop: Option<Part>,
    ) -> Result<PicturePanels> {
        let u = camera_point(&self.world.manifold, &self.scene.source, camera)?;
        let velocity = camera_velocity(&self.world.manifold, &self.scene.source, camera, u)?;
        let panels = PicturePanels::new(&self.world.manifold, (camera, u), size, crop)?;
        Ok(panels.with_velocity(velocity))
    }
}
