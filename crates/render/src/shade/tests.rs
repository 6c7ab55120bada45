use super::*;
use crate::{Stage, filter::Film, frame::offsets, picture::Picture};
use glam::DVec2;
use ndarray::Array3;

const MANIFOLD: &str = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 100"
"#;

const SCENE: &str = r#"
manifold = "flat.toml"
[camera]
at = [0.0, 0.0, 0.0]
look = [0.0, -1.0, 0.2]
up = [0.0, 0.0, 1.0]
fov = 40.0
[sky]
sky = { pattern = "stars" }
"#;

fn stage() -> Stage {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("flat.toml"), MANIFOLD).unwrap();
    let scene = folder.path().join("scene.toml");
    std::fs::write(&scene, SCENE).unwrap();
    Stage::load(&scene, &[]).unwrap()
}

/// The sky as it is seen in flat space, where directions need no tracing.
fn sky(stage: &Stage, view: &View, samples: usize, footprints: Footprints) -> Picture {
    let (width, height) = view.size;
    let mut film = Film::new(view.size, samples);
    for offset in offsets(samples).chunks(16) {
        let outcomes = Array3::from_shape_fn((height, width, offset.len()), |(y, x, k)| {
            let at = DVec2::new(x as f64, y as f64) + offset[k];
            Seen::Sky {
                exit: 0,
                s: 10.0,
                direction: view.direction(at.x, at.y).as_vec3(),
            }
        });
        let colours = shade(&stage.world, view, outcomes.view(), samples, footprints);
        film.add(colours, offset);
    }
    film.develop()
}

/// The root mean square over pixels and colours of the standard deviation in time.
fn flicker(differences: &[Array3<f32>]) -> f64 {
    let n = differences.len() as f64;
    let mean = differences
        .iter()
        .fold(Array3::<f64>::zeros(differences[0].dim()), |sum, d| {
            sum + d.mapv(f64::from)
        })
        / n;
    let squares = differences.iter().map(|d| {
        let off = d.mapv(f64::from) - &mean;
        off.mapv(|x| x * x).sum()
    });
    (squares.sum::<f64>() / n / mean.len() as f64).sqrt()
}

#[test]
fn a_slow_pan_over_stars_flickers_at_least_five_times_less_when_filtered() {
    let stage = stage();
    let view = stage.view(&stage.scene.camera, (96, 54)).unwrap();
    let mut off = [Vec::new(), Vec::new()];
    for frame in 0..8 {
        // A tenth of a pixel and a bit, so that no frame repeats another.
        let view = view.turned(0.137 * view.pixel_angle() * f64::from(frame));
        let reference = sky(&stage, &view, 256, Footprints::Points).rgb;
        for (off, footprints) in off
            .iter_mut()
            .zip([Footprints::Filtered, Footprints::Points])
        {
            off.push(sky(&stage, &view, 1, footprints).rgb - &reference);
        }
    }
    let [filtered, points] = off.map(|off| flicker(&off));
    println!(
        "flicker: filtered {filtered:.5}, points {points:.5}, ratio {:.1}",
        points / filtered
    );
    assert!(points >= 5.0 * filtered, "{points} {filtered}");
}
