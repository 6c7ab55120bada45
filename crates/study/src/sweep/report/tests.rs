//! Figures of made-up points, of which everything is known.

use super::{
    figures::{byte_slopes, frames_to_pay, paths_to_pay, size_ratio, spacing_orders},
    page, short,
};
use crate::sweep::{
    exact_rays::TableErrors,
    grid::{Interpolation, NumberFormat},
    manifold_sweep::{ManifoldResults, Rival, equal_error},
    measurement::{
        Conditions, PointOutcome, SweepPoint, TableKind, TableMeasurement, TableSpec, TimeSpent,
    },
    tables::PatchDivision,
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
fn point(spec: TableSpec, bytes: u64, p99: f64) -> SweepPoint {
    let measured = TableMeasurement {
        disk: bytes,
        memory: bytes,
        errors: TableErrors {
            mrad: quantiles(p99),
            screen: quantiles(p99),
            sky: Quantiles::default(),
            rotation: None,
            flagged: 0.0,
        },
        bake: TimeSpent {
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
    SweepPoint {
        spec,
        outcome: PointOutcome::Measured(Box::new(measured)),
        maps: Vec::new(),
    }
}

fn patches(bytes: u64, p99: f64) -> SweepPoint {
    let spec = TableSpec::Patches {
        promise: p99,
        division: PatchDivision::Adaptive,
    };
    point(spec, bytes, p99)
}

fn grid(cells: usize, bytes: u64, p99: f64) -> SweepPoint {
    let spec = TableSpec::Grid {
        interpolation: Interpolation::Cubic,
        format: NumberFormat::U16,
        cells: vec![cells; 3],
    };
    point(spec, bytes, p99)
}

/// A fourth-order grid in three axes, and two bundles.
fn results() -> ManifoldResults {
    let rival = |steps: usize, p99: f64| Rival {
        steps,
        screen: quantiles(p99),
        path_ns: 20.0 * steps as f64,
    };
    ManifoldResults {
        title: "M & m".into(),
        conditions: Conditions {
            format: 1,
            version: "0".into(),
            manifold: "m".into(),
            fingerprint: "f".into(),
            length: 1.0,
            rays: 100,
            seed: 1,
        },
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
    let grids = results.of(TableKind::CubicU16);
    let is = |all: Vec<f64>, known: f64| {
        all.len() == 2 && all.iter().all(|found| (found - known).abs() < 1e-12)
    };
    assert!(is(spacing_orders(&grids), 4.0) && is(byte_slopes(&grids), -4.0 / 3.0));
    let bundles = results.of(TableKind::Patches);
    assert!((byte_slopes(&bundles)[0] + 100.0_f64.log2()).abs() < 1e-12);
    assert!(spacing_orders(&bundles).is_empty());
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
    let bundles = results.of(TableKind::Patches);
    let grids = results.of(TableKind::CubicU16);
    assert_eq!(size_ratio(bundles[0].1, &grids).unwrap(), "8.0");
    assert_eq!(size_ratio(bundles[1].1, &grids).unwrap(), "> 32");
    assert_eq!(size_ratio(bundles[1].1, &[]), None);
}

#[test]
fn a_bake_pays_when_its_lookups_have_saved_its_time() {
    let results = results();
    let bundles = results.of(TableKind::Patches);
    let first = bundles[0].1;
    let rival = equal_error(&results.rivals, &first.errors).unwrap();
    // Ten steps take 200 ns, the table 100 ns, the bake 2 s; its frames are slower.
    assert_eq!((rival.steps, frames_to_pay(first)), (10, None));
    assert!((paths_to_pay(first, rival).unwrap() - 2e7).abs() <= 1.0);
    assert_eq!(equal_error(&results.rivals, &bundles[1].1.errors), None);
    // Rivals are measured on rays that this one does not hold.
    let errors = TableErrors {
        flagged: 0.02,
        ..first.errors
    };
    assert_eq!(equal_error(&results.rivals, &errors), None);
}

#[test]
fn the_page_has_all_ratios_and_escapes_names() {
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
