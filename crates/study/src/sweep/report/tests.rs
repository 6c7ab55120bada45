//! Figures of made-up points, of which everything is known.

use crate::sweep::report::{
    analysis::{Ratio, payoff, ratio, slopes},
    page::{page, short},
};
use crate::sweep::{
    clock::Spent,
    grid::{Interpolation, Number},
    patches::Refinement,
    point::{Basis, Key, Kind, Measured, Outcome, Point, What},
    rival::Rival,
    subject::Results,
    truth::Errors,
};
use geofan_core::quantiles::Quantiles;

fn quantiles(p99: f64) -> Quantiles {
    Quantiles {
        p50: 0.1 * p99,
        p95: 0.5 * p99,
        p99,
        max: 3.0 * p99,
    }
}

/// A table of so many bytes and such an error, baked in 2 s, read in 100 ns.
fn point(what: What, bytes: u64, p99: f64) -> Point {
    let basis = Basis {
        format: 1,
        version: "0".into(),
        manifold: "m".into(),
        fingerprint: "f".into(),
        length: 1.0,
        rays: 100,
        seed: 1,
    };
    let measured = Measured {
        disk: bytes,
        memory: bytes,
        errors: Errors {
            mrad: quantiles(p99),
            screen: quantiles(p99),
            sky: Quantiles::default(),
            rotation: None,
            flagged: 0.0,
        },
        bake: Spent {
            wall_s: 1.0,
            cpu_s: 2.0,
        },
        baked_rays: 1,
        contract_ms: 1.0,
        path_ns: 100.0,
        frame_ms: Some(50.0),
        rival_frame_ms: Some(40.0),
        load: None,
    };
    Point {
        key: Key { basis, what },
        outcome: Outcome::Measured(Box::new(measured)),
        maps: Vec::new(),
    }
}

fn patches(bytes: u64, p99: f64) -> Point {
    let what = What::Patches {
        promise: p99,
        refinement: Refinement::Adaptive,
    };
    point(what, bytes, p99)
}

fn grid(cells: usize, bytes: u64, p99: f64) -> Point {
    let what = What::Grid {
        interpolation: Interpolation::Cubic,
        number: Number::U16,
        cells: vec![cells; 3],
    };
    point(what, bytes, p99)
}

/// A fourth-order grid in three axes, and two bundles.
fn results() -> Results {
    let rival = |steps: usize, p99: f64| Rival {
        steps,
        screen: quantiles(p99),
        path_ns: 20.0 * steps as f64,
    };
    Results {
        title: "M & m".into(),
        name: "m".into(),
        cameras: 1,
        axes: 3,
        points: vec![
            patches(1_000, 1.0),
            patches(2_000, 0.01),
            grid(10, 1_000, 16.0),
            grid(20, 8_000, 1.0),
            grid(40, 64_000, 0.0625),
        ],
        rivals: vec![rival(3, 9.0), rival(10, 0.9), rival(20, 0.05)],
    }
}

#[test]
fn slopes_are_those_of_the_law_behind_the_points() {
    let results = results();
    for slope in slopes(&results.of(Kind::CubicU16)) {
        assert!((slope.order.unwrap() - 4.0).abs() < 1e-12);
        assert!((slope.bytes + 4.0 / 3.0).abs() < 1e-12);
    }
    let patches = slopes(&results.of(Kind::Patches));
    assert!((patches[0].bytes + 100.0_f64.log2()).abs() < 1e-12 && patches[0].order.is_none());
}

#[test]
fn only_points_that_nothing_beats_are_on_the_front() {
    let results = results();
    let front: Vec<u64> = results.front().iter().map(|(_, m)| m.disk).collect();
    assert_eq!(front, [1_000, 2_000]);
}

#[test]
fn sizes_are_compared_with_measured_points_only() {
    let results = results();
    let bundles = results.of(Kind::Patches);
    let grids = results.of(Kind::CubicU16);
    assert_eq!(ratio(bundles[0].1, &grids), Some(Ratio::Measured(8.0)));
    assert_eq!(ratio(bundles[1].1, &grids), Some(Ratio::More(32.0)));
    assert_eq!(ratio(bundles[1].1, &[]), None);
    assert_eq!(Ratio::More(32.0).to_string(), "> 32");
}

#[test]
fn a_bake_pays_when_its_lookups_have_saved_its_time() {
    let results = results();
    let bundles = results.of(Kind::Patches);
    let first = payoff(&results, bundles[0].1).unwrap();
    // Ten steps take 200 ns, the table 100 ns, the bake 2 s; its frames are slower.
    assert_eq!((first.steps, first.frames), (10, None));
    assert!((first.paths.unwrap() - 2e7).abs() <= 1.0);
    assert_eq!(payoff(&results, bundles[1].1), None);
}

#[test]
fn the_page_says_what_was_found_and_escapes_names() {
    let html = page(
        &[results()],
        &[Vec::new()],
        "geofan-bake sweep 'a & b.toml'",
    );
    assert!(html.contains("M &amp; m") && !html.contains("M & m"));
    assert!(html.contains("<td>&gt; 32</td>"));
    assert!(html.contains("exact never as good"));
    assert!(html.contains("a &amp; b.toml"));
}

#[test]
fn numbers_have_three_digits() {
    for (x, text) in [
        (1234.5, "1234"),
        (12.345, "12.3"),
        (0.012345, "0.0123"),
        (2.5e9, "2.50e9"),
    ] {
        assert_eq!(short(x), text);
    }
}
