//! The space of a session.
//!
//! In: a scene, its manifold and perhaps a bundle. Out: what a session must know of them: where cameras may be,
//! and where the scene's are. Meshes and skies are the drawing's matter.

use crate::protocol::Pose;
use geofan_bundle::{Bundle, Table};
use geofan_core::{Result, geodesic::check_point, manifold::Manifold};
use geofan_render::{
    Camera, camera_point,
    scene::{CameraEntry, CameraMotion, Lens, SceneFile},
};
use glam::DVec3;
use std::sync::Arc;

/// A table and what it promises.
#[derive(Debug, Clone)]
pub struct TablePromise {
    /// The table.
    pub table: Table,
    /// Its promise in mrad.
    pub mrad: f64,
    /// Its certificate, in words.
    pub certificate: Option<String>,
}

impl TablePromise {
    /// Takes it from a bundle.
    pub fn of(bundle: &Bundle) -> Self {
        let certificate = bundle.header.certificate.as_ref();
        Self {
            table: bundle.table.clone(),
            mrad: bundle.header.plan.max_error,
            certificate: certificate.map(|certificate| certificate.lines()),
        }
    }
}

/// A space to look around in.
#[derive(Debug, Clone)]
pub struct SessionSpace {
    /// The manifold.
    pub manifold: Arc<Manifold>,
    /// Its table, if there is one.
    pub table: Option<TablePromise>,
    /// The scene's cameras: the main one, then those with names.
    pub cameras: Vec<(String, Pose)>,
    /// Arc length over which paths are followed.
    pub length: f64,
    /// What the scene's camera asks for that a viewer's does not do, in words.
    pub unshown: Option<String>,
}

impl SessionSpace {
    /// Takes it from a scene.
    ///
    /// # Errors
    /// A camera of the scene is where none can be.
    pub fn new(
        scene: &SceneFile,
        manifold: &Arc<Manifold>,
        bundle: Option<&Bundle>,
        length: f64,
    ) -> Result<Self> {
        let pose = |entry: &CameraEntry| -> Result<(String, Pose)> {
            let u = camera_point(manifold, &scene.source, entry)?;
            check_point(manifold, "the camera", u)?;
            let camera = Camera::looking(u, entry.look, entry.up);
            let name = entry.name.clone().unwrap_or_default();
            Ok((name, Pose::of(&camera, entry.fov_degrees)))
        };
        let cameras = std::iter::once(&scene.camera).chain(&scene.views);
        Ok(Self {
            manifold: manifold.clone(),
            table: bundle.map(TablePromise::of),
            cameras: cameras.map(pose).collect::<Result<_>>()?,
            length,
            unshown: unshown(&scene.camera),
        })
    }

    /// Returns the scene's main camera and its angle of view.
    pub(crate) fn home(&self) -> (Camera, f64) {
        let home = self.cameras.first().map(|(_, pose)| *pose);
        let camera = home.and_then(|pose| Some((pose.camera()?, pose.fov)));
        camera.unwrap_or((Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z), 90.0))
    }

    /// Tells whether the table knows all paths from `u`.
    pub(crate) fn knows(&self, u: DVec3) -> bool {
        let table = self.table.as_ref();
        table.is_some_and(|promise| promise.table.space.place(u).is_ok())
    }
}

/// Says what `camera` asks for that a viewer's camera, which is the normal observer's and sees in perspective, does not do.
fn unshown(camera: &CameraEntry) -> Option<String> {
    let name = match camera {
        camera if camera.motion != CameraMotion::Normal => "`rest` or `velocity`",
        camera if camera.lens != Lens::default() => "`projection`, `stereo` or `crop`",
        _ => return None,
    };
    Some(format!(
        "the scene's camera has {name}, which `geofan render` shows and a viewer does not"
    ))
}
