//! Glued spaces from file to table: the table is that of the covering space, whatever is glued.

mod support;

use geofan_bundle::Bundle;
use glam::DVec3;
use support::{Place, asset};

/// The three-sphere with a small camera region, and the same with the faces of a catalogue's file.
fn sphere_and_quotient() -> [String; 2] {
    let sphere = "name = 'sphere'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2/(1 + r2)' }\n[let]\nr2 = 'x^2 + y^2 + z^2'\n[symmetry]\nrotation = 'origin'\n[cameras]\nparameters = { c = [0.0, 0.2] }\nat = ['c', '0', '0']\nlength = 2.5\n";
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/poincare.toml"
    );
    let text = std::fs::read_to_string(file).unwrap();
    let (from, to) = (
        text.find("[[glue]]").unwrap(),
        text.find("[domain]").unwrap(),
    );
    [sphere.to_string(), format!("{sphere}{}", &text[from..to])]
}

#[test]
fn the_table_of_a_quotient_is_that_of_its_cover() {
    let [sphere, quotient] = sphere_and_quotient();
    let place = Place::with(&[("sphere.toml", &sphere), ("quotient.toml", &quotient)]);
    place.bake("sphere.toml -o sphere.fan --quiet").success();
    place
        .bake("quotient.toml -o quotient.fan --quiet")
        .success();
    let [a, b] =
        ["sphere.fan", "quotient.fan"].map(|name| Bundle::read(&place.path(name)).unwrap());
    assert_eq!(a.contents().chunks, b.contents().chunks);
    assert_eq!(a.manifold.differences(&b.manifold.cover()), [""; 0]);
    assert!(!a.manifold.differences(&b.manifold).is_empty());
    assert!(b.manifold.gluing().is_some() && b.table.space.manifold().gluing().is_none());
    // Paths of the table end where exact ones do, inside the domain.
    let (u, d) = (
        DVec3::new(0.05, -0.03, 0.02),
        DVec3::new(0.3, 0.8, -0.5).normalize(),
    );
    let traced = geofan_bundle::trace(&b.table, u, d, 2.5, 6, 1e-10).unwrap();
    let space = asset("poincare");
    let ray = geofan_core::geodesic::Ray::new(&space, u, d, 2.5);
    let path =
        geofan_core::geodesic::paths(&space, support::settings(1e-12, true), [ray]).remove(0);
    for sample in &traced.samples {
        let exact = geofan_core::geodesic::sample(&space, &ray, &path, sample.s);
        assert!(
            (sample.u - exact.u).length() < 1e-3 * sample.s.max(0.1),
            "{sample:?} {exact:?}"
        );
        assert!((sample.v - exact.v).length() < 2e-3);
        let off = sample.frame.unwrap() - exact.frame.unwrap();
        assert!(off.to_cols_array().iter().all(|x| x.abs() < 3e-3));
        assert_eq!(sample.crossings, exact.crossings);
    }
    assert!(traced.samples.last().unwrap().crossings > 2);
}
