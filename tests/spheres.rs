//! Bakes whose directions are held together, by the program: how they are divided, and that they keep
//! their promise.

mod support;

use geofan_bake::certify;
use geofan_bundle::{Bundle, Tree};
use glam::DVec3;
use support::Place;

/// Two lenses beside the way of the camera; the plane x = 0 is a mirror that exchanges its halves.
const PAIR: &str = r#"
name = "pair"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.3*exp(-((x - 1)^2 + (y - 1)^2 + z^2)) + 0.3*exp(-((x + 1)^2 + (y - 1)^2 + z^2)) + 0.1*exp(-(x^2 + y^2 + (z + 1)^2)))" }
[cameras]
parameters = { c = [-1, 1] }
at = ["c", "0", "0.2"]
length = 3.0
"#;

/// A ball with a sharp edge, that takes up little of what the camera sees.
const PEBBLE: &str = r#"
name = "pebble"
coordinates = ["x", "y", "z"]
metric = { conformal = "1.1 - 0.1*tanh(20*((x - 0.3)^2 + (y - 1)^2 + (z - 0.1)^2 - 0.1))" }
[cameras]
parameters = { c = [-0.1, 0.1] }
at = ["c", "0.1*c", "0.2"]
length = 2.0
"#;

fn baked(text: &str, arguments: &str) -> Bundle {
    let place = Place::with(&[("m.toml", text)]);
    let options = "m.toml -o m.fan --certify-rays 400";
    place.bake(&format!("{options} {arguments}")).success();
    Bundle::read(&place.path("m.fan")).unwrap()
}

/// How many chunks have one patch for all directions, and how many are parted into faces.
fn kinds(bundle: &Bundle) -> [usize; 2] {
    let trees = bundle
        .table
        .chunks
        .iter()
        .map(|chunk| chunk.tree().unwrap());
    trees.fold([0, 0], |[whole, parted], tree| match tree {
        Tree::Leaf(_) => [whole + 1, parted],
        Tree::Faces(_) => [whole, parted + 1],
        _ => [whole, parted],
    })
}

fn assert_kept(bundle: &Bundle, promise: f64) {
    let checked = certify(&bundle.table, 3000, 5, 1e-9, promise, |_| Ok(())).unwrap();
    let certificate = checked.certificate;
    assert!(certificate.screen_mrad.p99 < promise, "{certificate:?}");
    let sky = certificate.sky_mrad.unwrap();
    assert!(sky.p99 < promise, "{certificate:?}");
    assert!(certificate.flagged < 0.02, "{certificate:?}");
}

#[test]
fn one_patch_holds_all_directions_and_its_mirror_image() {
    let bundle = baked(PAIR, "--max-error 1 --max-sky-error 1");
    assert_eq!(bundle.header.plan.mirrors.len(), 1);
    // The mirror carries one of the two cells to the other.
    assert_eq!((bundle.table.chunks.len(), kinds(&bundle)), (1, [1, 0]));
    assert_kept(&bundle, 1.0);
    // The pole is the way of the camera.
    let [_, _, pole] = bundle.header.plan.sphere.unwrap();
    assert!(DVec3::from_array(pole).x.abs() > 0.999, "{pole:?}");
    let place = bundle
        .table
        .space
        .place(DVec3::new(-0.7, 0.0, 0.2))
        .unwrap();
    let located = bundle.table.space.locate(&place, DVec3::NEG_Y);
    let found = bundle.table.box_at(&place, &located, 1.0).unwrap();
    assert_eq!((found.chunk, found.face, found.flagged), (0, None, false));
}

#[test]
fn faces_are_parted_where_only_some_directions_are_rough() {
    let bundle = baked(PEBBLE, "--max-error 4 --max-sky-error 4");
    let parted = kinds(&bundle)[1];
    assert!(parted > 0, "{:?}", bundle.table.counts());
    assert_kept(&bundle, 4.0);
    let place = bundle.table.space.place(DVec3::new(0.0, 0.0, 0.2)).unwrap();
    let located = bundle.table.space.locate(&place, DVec3::Y);
    let found = bundle.table.box_at(&place, &located, 1.0).unwrap();
    assert_eq!(found.face, Some(2));
}
