//! Objects that move: their places, the frames that they carry, and the pictures of them.

use assert_cmd::cargo::cargo_bin_cmd;
use geofan_render::{Stage, picture};
use glam::DVec3;
use std::{f64::consts::TAU, fs, path::PathBuf};
use tempfile::TempDir;

const ASSETS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets");

/// A scene in the three-sphere with these lines for its one object.
fn scene(object: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let text = format!(
        "manifold = \"{ASSETS}/manifolds/s3.toml\"\n[camera]\nat = [0.0, -0.1, 0.9]\nlook = [0.0, 0.05, -1.0]\nup = [0.0, 1.0, 0.0]\n\
         [[object]]\nmesh = \"{ASSETS}/meshes/letter-F.obj\"\nscale = 0.05\n{object}\n[sky]\nlength = {{ color = [0.1, 0.1, 0.2] }}\n"
    );
    fs::write(&path, text).unwrap();
    (folder, path)
}

fn refusal(object: &str) -> String {
    let (_folder, path) = scene(object);
    match Stage::load(&path, &[]) {
        Err(error) => error.report(false),
        Ok(_) => panic!("accepted: {object}"),
    }
}

/// All corners at a time.
fn corners(stage: &mut Stage, time: f64) -> Vec<DVec3> {
    stage.set_time(time).unwrap();
    stage.world.accelerator.triangles().as_flattened().to_vec()
}

/// A circle of latitude: radius θ with tan(θ/2) = 0.4.
const ROUND: &str =
    "path = [\"0.4*cos(t)\", \"0.4*sin(t)\", \"0\"]\nduring = [0, 6.283185307179586]";

#[test]
fn an_object_carried_round_a_loop_comes_back_turned_by_the_area_inside() {
    let (_folder, path) = scene(ROUND);
    let mut stage = Stage::load(&path, &[]).unwrap();
    let before = corners(&mut stage, 0.0);
    let after = corners(&mut stage, TAU);
    // 2π (1 − cos θ); the chart is conformal, so angles are its own.
    let theta = 2.0 * 0.4_f64.atan();
    let turn = glam::DQuat::from_rotation_z(TAU * (1.0 - theta.cos()));
    let at = DVec3::new(0.4, 0.0, 0.0);
    assert!(before.len() > 10 && before.len() == after.len());
    for (before, after) in before.iter().zip(&after) {
        let expected = at + turn * (*before - at);
        assert!((*after - expected).length() < 1e-8, "{after} {expected}");
    }
    // Before and after its path it stands still, and on the way it is on the curve.
    assert_eq!(corners(&mut stage, -3.0), before);
    assert_eq!(corners(&mut stage, 99.0), after);
    let middle = |corners: &[DVec3]| corners.iter().sum::<DVec3>() / corners.len() as f64;
    let quarter = corners(&mut stage, TAU / 4.0);
    assert!((middle(&quarter) - DVec3::new(0.0, 0.4, 0.0)).length() < 0.05);
}

#[test]
fn turning_is_added_in_the_axes_that_are_carried_along() {
    let (_folder, path) = scene(ROUND);
    let (_other, turning) = scene(&format!(
        "{ROUND}\nturning = {{ axis = [0, 0, 1], degrees = \"90*t/(2*pi)\" }}"
    ));
    let mut plain = Stage::load(&path, &[]).unwrap();
    let mut turned = Stage::load(&turning, &[]).unwrap();
    assert_eq!(corners(&mut plain, 0.0), corners(&mut turned, 0.0));
    let (a, b) = (corners(&mut plain, TAU), corners(&mut turned, TAU));
    let at = DVec3::new(0.4, 0.0, 0.0);
    let quarter = glam::DQuat::from_rotation_z(TAU / 4.0);
    for (a, b) in a.iter().zip(&b) {
        // All about one axis: the order of turns does not matter.
        assert!((at + quarter * (*a - at) - *b).length() < 1e-8);
    }
}

#[test]
fn an_object_may_follow_key_poses() {
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("poses.toml");
    let pose = |time: f64, at: &str| {
        format!("[[pose]]\ntime = {time}\nat = {at}\nlook = [0, 0, -1]\nup = [0, 1, 0]\n")
    };
    fs::write(
        &poses,
        pose(0.0, "[0.1, 0.2, 0.0]") + &pose(4.0, "[-0.3, 0.1, 0.1]"),
    )
    .unwrap();
    let (_folder, path) = scene(&format!("path = \"{}\"", poses.display()));
    let mut stage = Stage::load(&path, &[]).unwrap();
    let middle = |corners: &[DVec3]| corners.iter().sum::<DVec3>() / corners.len() as f64;
    assert!((middle(&corners(&mut stage, 0.0)) - DVec3::new(0.1, 0.2, 0.0)).length() < 0.05);
    assert!((middle(&corners(&mut stage, 9.0)) - DVec3::new(-0.3, 0.1, 0.1)).length() < 0.05);
}

#[test]
fn paths_that_cannot_be_are_refused_with_their_place() {
    let cases = [
        (
            "path = [\"0.4*cos(t)\", \"q\", \"0\"]\nduring = [0, 1]",
            "unknown name `q`",
        ),
        ("path = [\"t\", \"0\", \"0\"]", "needs `during`"),
        (
            "path = [\"t\", \"0\", \"0\"]\nduring = [1, 0]",
            "earlier time first",
        ),
        (
            "path = [\"t\", \"0\", \"0\"]\nduring = [0, 1]\nat = [0, 0, 0]",
            "both `at` and `path`",
        ),
        (
            "at = [0, 0, 0]\nturning = { axis = [0, 0, 1], degrees = 3 }",
            "stands still",
        ),
        ("path = \"nowhere.toml\"", "no such file"),
        (
            "path = [\"1/(1 - t)\", \"0\", \"0\"]\nduring = [0, 2]",
            "the object's path at t = 1",
        ),
    ];
    for (object, message) in cases {
        let report = refusal(object);
        assert!(
            report.contains(message) && report.contains('^'),
            "{object}\n{report}"
        );
    }
}

#[test]
fn a_path_that_leaves_the_domain_is_refused_where_it_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let text = format!(
        "manifold = \"{ASSETS}/manifolds/schwarzschild.toml\"\n[camera]\nat = [9.0, 0.0, 0.0]\nlook = [-1.0, 0.0, 0.0]\nup = [0.0, 0.0, 1.0]\n\
         [[object]]\nmesh = \"{ASSETS}/meshes/letter-F.obj\"\nscale = 0.05\npath = [\"6 - t\", \"0.1\", \"0\"]\nduring = [0, 8]\n"
    );
    fs::write(&path, text).unwrap();
    let report = Stage::load(&path, &[]).err().unwrap().report(false);
    assert!(report.contains("the object's path at t = 5.5"), "{report}");
    assert!(report.contains("path = "), "{report}");
}

#[test]
fn pictures_show_objects_at_their_time_alone_and_in_animations() {
    let (folder, path) = scene(ROUND);
    let file = |name: &str| folder.path().join(name);
    let render = |more: &[&str]| {
        let mut command = cargo_bin_cmd!("geofan");
        command.args([
            "render",
            &path.display().to_string(),
            "--size",
            "64x36",
            "--length",
            "2",
        ]);
        command.args(more).arg("--quiet");
        command
    };
    let name = |name: &str| file(name).display().to_string();
    render(&["-o", &name("start.png")]).assert().success();
    render(&["--at-time", "3.0", "-o", &name("half.png")])
        .assert()
        .success();
    let poses = file("still.toml");
    let pose = |time: f64| {
        format!(
            "[[pose]]\ntime = {time}\nat = [0.0, -0.1, 0.9]\nlook = [0.0, 0.05, -1.0]\nup = [0.0, 1.0, 0.0]\n"
        )
    };
    fs::write(&poses, pose(0.0) + &pose(3.0)).unwrap();
    let camera = poses.display().to_string();
    let frames = [
        "--camera-path",
        &camera,
        "--frames",
        "2",
        "-o",
        &name("f-%d.png"),
    ];
    render(&frames).assert().success();
    let pixels = |name: &str| picture::read(&file(name)).unwrap().bytes();
    let (start, half) = (pixels("start.png"), pixels("half.png"));
    assert!(start != half);
    assert!(start == pixels("f-0.png") && half == pixels("f-1.png"));
    let idle = "a_still_scene.toml";
    let still = fs::read_to_string(&path)
        .unwrap()
        .replace(ROUND, "at = [0.4, 0, 0]");
    fs::write(file(idle), still).unwrap();
    let refused = cargo_bin_cmd!("geofan")
        .args([
            "render",
            &name(idle),
            "--at-time",
            "1",
            "-o",
            &name("x.png"),
        ])
        .assert()
        .code(2);
    assert!(
        String::from_utf8_lossy(&refused.get_output().stderr)
            .contains("nothing in this scene moves")
    );
}
