//! Scenes that take their manifold out of a bundle.

use geofan_core::{Result, manifold::Manifold};
use geofan_render::Stage;
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden");
    Path::new(folder).join(name)
}

/// Loads a scene whose manifold is the file `manifold`.
fn stage(manifold: &Path, settings: &[(String, f64)]) -> Result<Stage> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let scene = format!(
        "manifold = '{}'\ncamera = {{ at = [1, 0.3, 0.2], look = [-1, 0, 0], up = [0, 0, 1] }}\n",
        manifold.display()
    );
    std::fs::write(&path, scene).unwrap();
    Stage::load(&path, settings)
}

fn refusal(manifold: &Path, settings: &[(String, f64)]) -> String {
    match stage(manifold, settings) {
        Ok(_) => panic!("{} is accepted", manifold.display()),
        Err(error) => error.report(false),
    }
}

#[test]
fn the_manifold_is_that_of_the_file_that_was_baked() {
    for name in ["three-bumps-rail", "s3", "nil"] {
        let known = Manifold::load(&golden(&format!("{name}.toml")), &[]).unwrap();
        let stage = stage(&golden(&format!("{name}.fan")), &[]).unwrap();
        assert_eq!(stage.world.manifold.differences(&known), [""; 0], "{name}");
    }
}

#[test]
fn its_parameters_may_be_replaced() {
    let set = [(String::from("h2"), 0.5)];
    let known = Manifold::load(&golden("three-bumps-rail.toml"), &set).unwrap();
    let bundle = golden("three-bumps-rail.fan");
    let stage = stage(&bundle, &set).unwrap();
    assert_eq!(stage.world.manifold.differences(&known), [""; 0]);
    let unknown = refusal(&bundle, &[(String::from("h9"), 0.5)]);
    assert!(unknown.contains("no parameter `h9`"), "{unknown}");
}

#[test]
fn a_damaged_bundle_is_refused_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.fan");
    let bytes = std::fs::read(golden("s3.fan")).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let message = refusal(&path, &[]);
    assert!(message.contains("cut.fan"), "{message}");
}
