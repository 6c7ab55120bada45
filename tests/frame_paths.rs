//! Paths as frames look them up beside paths read from the table one by one.

mod support;

use geofan_bundle::Bundle;
use geofan_render::{Ending, EventLocator, GridTracer, Lookup, PathBatch};
use glam::DVec3;
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
