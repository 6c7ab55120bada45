//! Paths as frames look them up beside paths read from the table one by one.

mod support;

use geofan_bundle::Bundle;
use geofan_render::{
    Ending, EventLocator, ExactTracer, GridTracer, Lookup, PathBatch, Seen, Stage,
    intersect::{seen_along, seen_from},
};
use glam::DVec3;
use std::path::Path;
use support::Place;

/// A wormhole: some paths go through it, some turn back near its throat, at an exit each.
const WORMHOLE: &str = r#"
name = "wormhole"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 1/(4*rho^2)" }
[let]
rho = "sqrt(x^2 + y^2 + z^2)"
l = "rho - 1/(4*rho)"
[domain]
inside = ["rho - 0.02"]
[[exit]]
name = "near"
when = "l - 6"
[[exit]]
name = "far"
when = "-6 - l"
[symmetry]
rotation = "origin"
[cameras]
at = ["1.7", "0.3", "-0.2"]
length = 10.0
"#;

/// Directions around one that looks past the throat, off every plane of symmetry.
fn directions() -> Vec<DVec3> {
    let aim = DVec3::new(-1.0, 0.45, 0.31);
    (0..40)
        .map(|i| {
            let [a, b] = [0.618, 0.755].map(|step| (f64::from(i) * step).fract() - 0.5);
            (aim + DVec3::new(0.0, 0.6 * a, 0.6 * b)).normalize()
        })
        .collect()
}

#[test]
fn paths_of_a_frame_are_those_of_the_table_at_knots_between_them_and_at_their_ends() {
    let place = Place::with(&[("wormhole.toml", WORMHOLE)]);
    place
        .bake("wormhole.toml -o w.fan --max-error 0.2 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("w.fan")).unwrap();
    let table = &bundle.table;
    let lookup = Lookup::new(table, 2e-4, 1e-8);
    let u = DVec3::new(1.7, 0.3, -0.2);
    let fan = table.fan(u).unwrap();
    let tracer = lookup.tracer(&fan);
    let manifold = table.space.manifold();
    let mut endings = EventLocator::new(manifold);
    let mut strands = PathBatch::new(tracer.knots().clone());
    tracer.add(&directions(), &mut endings, &mut strands);
    let mut exits = [0, 0];
    for (i, d) in directions().into_iter().enumerate() {
        let strand = strands.path(i);
        let Some(Ending::Exit { exit, s: end, .. }) = strand.ending else {
            // One that winds around the throat.
            continue;
        };
        exits[exit] += 1;
        let path = fan.path(d);
        // Ends and starts of intervals between knots, and between.
        let s: Vec<f64> = (1..=33).map(|k| end * f64::from(k) / 33.0).collect();
        let mut rows = vec![0.0; 6 * s.len()];
        tracer.refine(strand, &s, &mut rows);
        for (k, s) in s.iter().enumerate() {
            let (u, v) = path.at(*s).unwrap();
            let found =
                [0, 3].map(|c| DVec3::from_array([0, 1, 2].map(|j| rows[(c + j) * 33 + k])));
            let angle = (found[0] - u).length() / (s * v.length());
            let turn = (found[1] - v).length() / v.length();
            assert!(angle < 1e-4 && turn < 4e-4, "{d} at {s}: {angle} {turn}");
        }
        let (_, exact) = path.first_event(table.length).unwrap();
        assert!((end - exact).abs() < 1e-3, "{d}: {end} {exact}");
    }
    assert!(exits.iter().all(|count| *count > 3), "{exits:?}");

    sixteen_are_as_each(&tracer, &strands);
}

/// Refined together, paths through the throat and those that turn back are what they are one by one.
fn sixteen_are_as_each(tracer: &impl GridTracer, strands: &PathBatch) {
    let ends = |i: usize| matches!(strands.path(i).ending, Some(Ending::Exit { .. }));
    let leaving: Vec<usize> = (0..40).filter(|i| ends(*i)).collect();
    let groups = leaving.chunks_exact(16);
    assert!(groups.len() > 0, "{leaving:?}");
    for group in groups {
        let sixteen = std::array::from_fn(|l| strands.path(group[l]));
        let ends = sixteen.iter().map(|strand| match strand.ending {
            Some(Ending::Exit { s, .. }) => s,
            _ => unreachable!(),
        });
        let end = ends.fold(f64::INFINITY, f64::min);
        let s: Vec<f64> = (0..=33).map(|k| end * f64::from(k) / 33.0).collect();
        let together = tracer.refine_sixteen(&sixteen, &s);
        assert_eq!(together.len(), s.len());
        let mut rows = vec![0.0; 6 * s.len()];
        for (l, strand) in sixteen.into_iter().enumerate() {
            tracer.refine(strand, &s, &mut rows);
            for (k, state) in together.iter().enumerate() {
                for c in 0..6 {
                    let (found, one) = (state[c / 3][c % 3][l], rows[c * s.len() + k]);
                    assert!(
                        (found - one).abs() < 1e-12 * (1.0 + one.abs()),
                        "{l} {k} {c}"
                    );
                }
            }
        }
    }
}

/// Schwarzschild's hole; paths that fall in are slow in the chart where they end.
const HOLE: &str = r#"
name = "hole"
coordinates = ["x", "y", "z"]
metric = { conformal = "(1 + 1/(2*rho))^3/(1 - 1/(2*rho))" }
[let]
rho = "sqrt(x^2 + y^2 + z^2)"
[domain]
inside = ["rho - 0.5005"]
[[exit]]
name = "horizon"
when = "0.51 - rho"
[[exit]]
name = "sky"
when = "rho - 10"
[symmetry]
rotation = "origin"
[cameras]
at = ["5.7", "0.3", "-0.2"]
length = 50.0
"#;

#[test]
fn the_ends_of_paths_that_fall_into_a_hole_are_known_without_the_paths() {
    let place = Place::with(&[("hole.toml", HOLE)]);
    place
        .bake("hole.toml -o h.fan --max-error 0.5 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("h.fan")).unwrap();
    let lookup = Lookup::new(&bundle.table, 5e-4, 1e-8);
    let fan = bundle.table.fan(DVec3::new(5.7, 0.3, -0.2)).unwrap();
    let tracer = lookup.tracer(&fan);
    let mut events = EventLocator::new(bundle.table.space.manifold());
    // All around the middle of the shadow.
    let inward: Vec<DVec3> = directions()
        .into_iter()
        .map(|d| (d - DVec3::new(0.0, 0.45, 0.31)).normalize())
        .collect();
    let known = tracer.endings(&inward, &mut events);
    let (mut found, mut away) = (0, 0);
    for (d, known) in inward.iter().zip(known) {
        let path = fan.path(*d);
        let Some((_, s)) = path.first_event(bundle.table.length) else {
            continue;
        };
        let falls = path.at(s).is_some_and(|(u, _)| u.length() < 1.0);
        match known {
            Some(Ending::Exit { exit, s: end, .. }) => {
                assert!((end - s).abs() < 1e-3 * s, "{d}: {end} {s}");
                assert_eq!(exit == 0, falls, "{d}");
                (found, away) = (found + usize::from(falls), away + usize::from(!falls));
            }
            other => assert!(other.is_none(), "{d}: {other:?}"),
        }
    }
    assert!(found > 10, "{found} that fall in, {away} others");
}

#[test]
fn exact_rays_that_end_at_what_they_meet_see_what_whole_ones_do() {
    for scene in [
        "wormhole-gallery",
        "poincare-letters",
        "three-bumps-gallery",
    ] {
        let file = Path::new("assets/scenes")
            .join(scene)
            .with_extension("toml");
        let stage = Stage::load(&file, &[]).unwrap();
        let view = stage.view(&stage.scene.camera, (24, 13)).unwrap();
        let (world, u) = (&stage.world, view.u);
        let tracer = ExactTracer::new(&world.manifold, u, 6.0, 1e-7);
        let points = (0..13).flat_map(|y| (0..24).map(move |x| (x, y)));
        let local = world.manifold.local_frame(u);
        let starts: Vec<(DVec3, DVec3)> = points
            .map(|(x, y)| view.address(f64::from(x) + 0.37, f64::from(y) + 0.61))
            .map(|d| (u, local.tangent(d)))
            .collect();
        let seen = seen_from(world, &tracer, &starts);
        let whole = tracer.trace_from(&starts);
        let met = seen.iter().filter(|seen| matches!(seen, Seen::Surface(_)));
        assert!(met.count() > 10, "{scene}");
        for (i, (seen, curve)) in seen.iter().zip(&whole).enumerate() {
            assert_eq!(*seen, seen_along(world, curve), "{scene} {i}");
        }
    }
}
