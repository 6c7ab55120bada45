//! Pictures of a table's errors.
//!
//! In: a fan, and a part of a picture. Out: for each pixel the screen error at the end of its path, in mrad, and the colour
//! of its class. Classes with a legend can be told apart and read off, also by people who do not see all colours, where a
//! gradient cannot. One mrad is about one pixel of a 1920-wide view of 90°.

use geofan_bundle::{
    Fan,
    measure::{Probed, probe, settings},
};
use geofan_core::parallel::*;
use geofan_render::{View, picture::srgb_decode};
use glam::DVec3;

/// Upper ends of the classes in mrad, their colours in sRGB, dark to light (the steps of the colour map
/// *inferno*, even in lightness); the last is for paths that the table gave up on, which are integrated.
pub const LEGEND: [(f32, [u8; 3]); 7] = [
    (0.03, [0, 0, 4]),
    (0.1, [50, 10, 94]),
    (0.3, [120, 28, 109]),
    (1.0, [188, 55, 84]),
    (3.0, [237, 105, 37]),
    (f32::INFINITY, [251, 180, 26]),
    (f32::NAN, [90, 120, 160]),
];

/// Local tolerance of the exact paths that a table is held against: far below the errors of tables.
const ERROR_TOLERANCE: f64 = 1e-9;

/// Rays probed by one thread at a time: more keep all lanes busy for longer, but the steps of each stay in memory until
/// the last has ended, a tenth of a megabyte a ray.
const PROBED_AT_ONCE: usize = 64;

/// Computes the screen errors of the paths through the middles of the pixels of `view`; NaN where the table
/// gave up on the path.
pub(crate) fn screen_errors(fan: &Fan, view: &View, length: f64) -> Vec<f32> {
    let (width, height) = view.size;
    let pixels: Vec<usize> = (0..width * height).collect();
    let block = |pixels: &[usize]| -> Vec<f32> {
        let at = |i: &usize| ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let directions: Vec<DVec3> = pixels
            .iter()
            .map(|i| view.direction(at(i).0, at(i).1))
            .collect();
        errors_of(fan, view.u, &directions, length)
    };
    pixels
        .par_chunks(PROBED_AT_ONCE)
        .flat_map_iter(block)
        .collect()
}

fn errors_of(fan: &Fan, u: DVec3, directions: &[DVec3], length: f64) -> Vec<f32> {
    let rays: Vec<(DVec3, DVec3)> = directions.iter().map(|d| (u, *d)).collect();
    let manifold = fan.space().manifold();
    let exact = probe(
        manifold,
        settings(ERROR_TOLERANCE),
        length,
        &rays,
        |_, end| vec![end],
    );
    let error = |(direction, probed): (&DVec3, &Probed)| {
        let exact = probed.probes.first()?;
        let (at, _) = fan.path(*direction).at(exact.s)?;
        Some(exact.deviation(at, None).screen_mrad as f32)
    };
    let all = directions.iter().zip(&exact);
    all.map(|pair| error(pair).unwrap_or(f32::NAN)).collect()
}

/// Returns the linear light of an error's class.
pub(crate) fn error_colour(error: f32) -> [f32; 3] {
    let given_up = LEGEND.len() - 1;
    let class = match error.is_nan() {
        true => given_up,
        false => LEGEND[..given_up]
            .iter()
            .position(|(most, _)| error <= *most)
            .unwrap_or(given_up - 1),
    };
    LEGEND[class]
        .1
        .map(|code| srgb_decode(f32::from(code) / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::bundle;
    use geofan_core::quantiles::Quantiles;
    use geofan_render::Camera;

    #[test]
    fn errors_on_the_screen_are_those_that_the_certificate_tells_of() {
        let bundle = bundle("s3");
        let region = bundle.manifold.cameras.clone().unwrap();
        let u = region.at(&region.lerp(&[0.37]));
        let camera = Camera::looking(u, DVec3::new(0.2, 1.0, 0.3).normalize(), DVec3::Z);
        let view = View::of_camera(&camera, 100.0, (24, 16));
        let fan = bundle.fan(u).unwrap();
        let errors = screen_errors(&fan, &view, bundle.table.length);
        let mut known: Vec<f64> = errors
            .iter()
            .filter(|e| !e.is_nan())
            .map(|e| f64::from(*e))
            .collect();
        assert!(known.len() > 300);
        let found = Quantiles::of(&mut known);
        let certificate = bundle.header.certificate.as_ref().unwrap();
        assert!(found.p95 <= 2.0 * certificate.screen_mrad.p99, "{found:?}");
        assert!(found.max > 0.0);
    }

    #[test]
    fn every_error_has_its_class() {
        assert_eq!(error_colour(0.0), error_colour(0.03));
        assert_ne!(error_colour(0.03), error_colour(0.04));
        assert_eq!(error_colour(5.0), error_colour(f32::INFINITY));
        assert_ne!(error_colour(f32::NAN), error_colour(5.0));
    }
}
