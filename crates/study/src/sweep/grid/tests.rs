//! Grids of a mild lens against exact rays.

use crate::sweep::exact_rays::{ExactFan, TableErrors, exact_fans};
use crate::sweep::{Spacing, grid::*};
use geofan_bundle::rays::RaySpace;
use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use std::sync::Arc;

/// A mild lens without its symmetry, seen from a segment: four axes.
const LENS: &str = r#"
name = "lens"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.1*exp(-(x^2 + y^2 + z^2)/2))" }
[cameras]
parameters = { c = [1.0, 2.0] }
at = ["c", "0.2", "0.1"]
length = 3.0
"#;

const LENGTH: f64 = 3.0;

const TOLERANCE: f64 = 1e-10;

fn space() -> RaySpace {
    let source = SourceText::new("lens", LENS);
    RaySpace::new(Arc::new(Manifold::from_source(source, &[]).unwrap())).unwrap()
}

fn samples(space: &RaySpace, cells: usize) -> GridSamples {
    let nodes = vec![cells + 1; space.cameras().len() + space.directions() + 1];
    let axes = GridAxes::new(space, LENGTH, &nodes, Spacing::Uniform);
    GridSamples::new(space, axes, TOLERANCE, slope_channels(space), || false).unwrap()
}

fn errors(
    exact: &[ExactFan],
    cells: usize,
    interpolation: Interpolation,
    format: NumberFormat,
) -> TableErrors {
    let space = space();
    let samples = samples(&space, cells);
    let grid = Grid::new(&space, &samples, LENGTH, (interpolation, format));
    TableErrors::new(&grid, exact).unwrap()
}

fn exact() -> Vec<ExactFan> {
    exact_fans(&space(), LENGTH, (800, 5), &geofan_core::Unobserved).unwrap()
}

#[test]
fn errors_fall_with_the_orders_of_the_interpolations() {
    let exact = exact();
    for (interpolation, order) in [
        (Interpolation::Multilinear, 2.0),
        (Interpolation::Cubic, 4.0),
    ] {
        let of = |cells| errors(&exact, cells, interpolation, NumberFormat::F32);
        let (coarse, fine) = (of(8), of(16));
        let slope = |pick: fn(&TableErrors) -> f64| (pick(&coarse) / pick(&fine)).log2();
        let screen = slope(|e| e.screen.p99);
        assert!((screen - order).abs() < 0.7, "{interpolation:?} {screen}");
        let sky = slope(|e| e.sky.p99);
        assert!((sky - order).abs() < 0.9, "{interpolation:?} {sky}");
        let rotation = slope(|e| e.rotation.unwrap().p99);
        assert!(
            (rotation - order).abs() < 0.9,
            "{interpolation:?} {rotation}"
        );
        assert_eq!(fine.flagged, 0.0);
    }
}

#[test]
fn sixteen_bits_halve_the_bytes_and_err_by_their_rounding() {
    let exact = exact();
    let float = errors(&exact, 16, Interpolation::Cubic, NumberFormat::F32);
    let rounded = errors(&exact, 16, Interpolation::Cubic, NumberFormat::U16);
    // Channels of this lens span less than one, so a step is at most 1/65.535 mrad.
    assert!((rounded.screen.p99 - float.screen.p99).abs() < 0.02);
    assert!(rounded.screen != float.screen);
    let space = space();
    let bytes = |format| {
        let samples = samples(&space, 4);
        Grid::new(&space, &samples, LENGTH, (Interpolation::Cubic, format)).bytes()
    };
    assert!(bytes(NumberFormat::U16) < bytes(NumberFormat::F32) * 51 / 100);
}

#[test]
fn fixing_the_camera_changes_no_path() {
    let space = space();
    let samples = samples(&space, 6);
    let u = glam::DVec3::new(1.37, 0.2, 0.1);
    for format in [NumberFormat::F32, NumberFormat::U16] {
        let grid = Grid::new(&space, &samples, LENGTH, (Interpolation::Cubic, format));
        let (fixed, place) = grid.contracted(u).unwrap();
        let (whole, fixed) = (grid.fan(u).unwrap(), fixed.fixed_fan(place));
        for d in [glam::DVec3::X, glam::DVec3::new(-0.6, 0.64, 0.48)] {
            let (a, b) = (whole.path(d), fixed.path(d));
            let turned = a
                .rotation(2.1)
                .unwrap()
                .angle_between(b.rotation(2.1).unwrap());
            assert!(turned < 1e-5);
            assert!((a.at(2.1).1 - b.at(2.1).1).length() < 1e-5);
            assert!((a.at(2.1).0 - b.at(2.1).0).length() < 1e-5);
        }
    }
}

#[test]
fn sampling_can_be_stopped() {
    let space = space();
    let axes = GridAxes::new(&space, LENGTH, &[4; 4], Spacing::Uniform);
    let channels = slope_channels(&space);
    assert!(GridSamples::new(&space, axes, TOLERANCE, channels, || true).is_none());
}

#[test]
fn axes_that_bend_more_get_more_cells() {
    let relative = balanced(&samples(&space(), 8));
    assert_eq!(relative.len(), 4);
    assert!((relative.iter().product::<f64>() - 1.0).abs() < 1e-9);
    // One unit of the camera parameter bends paths less than half a turn of the direction.
    assert!(relative[0] < relative[1] && relative[0] < relative[2]);
    let cells = cells(10.0, &relative, 3);
    assert!((mean(&cells) - 10.0).abs() < 1.0 && cells.iter().all(|n| *n >= 3));
}

#[test]
fn rounding_to_16_bits_errs_by_at_most_half_a_step() {
    let values: Vec<f32> = (0..400)
        .map(|i| (i as f32 * 0.37).sin() * [1.0, 30.0][i % 2])
        .collect();
    let exact = GridNumbers::new(values.clone(), 2, NumberFormat::F32);
    let rounded = GridNumbers::new(values, 2, NumberFormat::U16);
    assert_eq!((exact.bytes(), rounded.bytes()), (1600, 816));
    let rows = [(3, 0.25), (40, 0.75)];
    let (mut a, mut b) = ([0.0; 4], [0.0; 4]);
    exact.sum(&rows, &mut a);
    rounded.sum(&rows, &mut b);
    for (c, (a, b)) in a.iter().zip(b).enumerate() {
        let step = [2.0, 60.0][c % 2] / 65535.0;
        assert!((a - b).abs() <= 0.51 * step, "{a} {b}");
    }
}

#[test]
fn a_constant_channel_keeps_its_number() {
    let stored = GridNumbers::new(vec![2.5; 6], 1, NumberFormat::U16);
    let mut sum = [0.0; 2];
    stored.sum(&[(0, 0.5), (2, 0.5)], &mut sum);
    assert_eq!(sum, [2.5; 2]);
}
