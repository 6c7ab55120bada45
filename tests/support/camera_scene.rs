//! Scenes with one camera, in a space whose light is bent beside the camera's axes.

use geofan_render::{PicturePanels, Stage};
use std::path::Path;

/// The metric exp(2φ) δ of a lens off the camera's axes.
pub const LENS_SPACE: &str = "name = 'lens'
coordinates = ['x', 'y', 'z']
metric = { conformal = 'exp(0.4*exp(-((x-0.6)^2+(y-0.3)^2+(z+0.2)^2)/2))' }
[[exit]]
name = 'sky'
when = 'x^2 + y^2 + z^2 - 25'
[cameras]
length = 30
";

/// Writes a scene of the manifold `space` into `folder`: `camera` is added to its camera, `rest` after it.
pub fn write_scene(folder: &Path, space: &str, camera: &str, rest: &str) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write("space.toml", space);
    write(
        "square.obj",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n",
    );
    let scene = format!(
        "manifold = 'space.toml'\n[camera]\nat = [-0.7, 0.4, 0.3]\nlook = [1, 0.2, -0.3]\n\
         up = [0.1, -0.2, 1]\n{camera}\n[sky]\nsky = {{ pattern = 'grid' }}\n{rest}"
    );
    write("scene.toml", &scene);
}

/// Loads such a scene.
pub fn stage(space: &str, camera: &str, rest: &str) -> Stage {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), space, camera, rest);
    Stage::load(&folder.path().join("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// The panels of its picture.
pub fn panels(stage: &Stage, size: (usize, usize)) -> PicturePanels {
    stage.panels(&stage.scene.camera, size, None).unwrap()
}
