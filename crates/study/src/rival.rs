//! Equal-error exact: the integrator that a table must beat.
//!
//! In: exact rays, as they are compared with a table. Out: numbers of equal steps, each with the screen
//! error of the classical Runge–Kutta method in single precision over vectors of rays. The rival of a
//! table takes the fewest steps whose 99th percentile is no worse than the table's. Between steps its
//! path is the cubic through points and tangents, as the renderer draws it. It carries no rotation,
//! which a table has: that favours the rival.

use geofan_bundle::measure::Probe;
use geofan_core::{geodesic::fixed_steps, manifold::Manifold, quantiles::Quantiles};
use geofan_render::Cubic;
use glam::DVec3;
use rayon::prelude::*;

/// Steps tried.
const STEPS: [usize; 21] = [
    3, 4, 6, 8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64, 96, 128, 192, 256, 384, 512, 1024,
];

/// A camera's chart point, and exact states of rays from it, by their directions in the standard frame.
pub(crate) type ProbedFan = (DVec3, Vec<(DVec3, Probe)>);

/// Integrates the rays of `fans` with more and more equal steps over `length`; returns, as long as it
/// is asked, the number of steps and the screen errors, mrad.
pub(crate) fn rivals<'a>(
    manifold: &'a Manifold,
    fans: &'a [ProbedFan],
    length: f64,
) -> impl Iterator<Item = (usize, Quantiles)> + 'a {
    let measured = move |steps| (steps, screen_errors(manifold, fans, length, steps));
    STEPS.into_iter().map(measured)
}

/// Measures the screen errors of `steps` equal steps.
fn screen_errors(manifold: &Manifold, fans: &[ProbedFan], length: f64, steps: usize) -> Quantiles {
    let errors = fans.par_iter().flat_map_iter(|(camera, probes)| {
        let local = manifold.local_frame(*camera);
        let rays: Vec<_> = probes
            .iter()
            .map(|(d, _)| (*camera, local.tangent(*d)))
            .collect();
        let paths = fixed_steps::<f32>(manifold, &rays, length, steps);
        let errors = probes.iter().zip(paths).map(|((_, probe), path)| {
            let u = position(&path, length, probe.s);
            finite(probe.screen_mrad(u - probe.u))
        });
        errors.collect::<Vec<f64>>()
    });
    let mut errors: Vec<f64> = errors.collect();
    Quantiles::of(&mut errors)
}

/// Bounds an error so that it can be written: JSON has no infinity, and beyond this nothing is worse.
pub(crate) fn finite(mrad: f64) -> f64 {
    mrad.min(1e6)
}

/// Returns the chart point at `s` on the cubics between the steps.
fn position((u, v): &(Vec<DVec3>, Vec<DVec3>), length: f64, s: f64) -> DVec3 {
    let steps = u.len() - 1;
    let place = s / length * steps as f64;
    let k = (place as usize).min(steps - 1);
    let at = |k: usize| length * k as f64 / steps as f64;
    let piece = Cubic {
        s: [at(k), at(k + 1)],
        u: [u[k], u[k + 1]],
        v: [v[k], v[k + 1]],
    };
    piece.position(place - k as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_bundle::measure::{probe, settings};
    use geofan_core::{diagnostic::SourceText, random::Stream};

    #[test]
    fn errors_fall_with_the_fourth_power_of_the_steps_until_single_precision_ends_it() {
        let text = "name = 'lens'\ncoordinates = ['x', 'y', 'z']\n\
                    metric = { conformal = 'exp(0.3*exp(-(x^2 + y^2 + z^2)/2))' }";
        let manifold = Manifold::from_source(SourceText::new("lens", text), &[]).unwrap();
        let (camera, length) = (DVec3::new(1.2, 0.3, 0.1), 4.0);
        let mut stream = Stream::new(&[3]);
        let rays: Vec<_> = (0..200).map(|_| (camera, stream.direction())).collect();
        let probed = probe(&manifold, settings(1e-11), length, &rays, |_, end| {
            vec![0.97 * end]
        });
        let probes = rays
            .iter()
            .zip(&probed)
            .map(|((_, d), p)| (*d, p.probes[0]));
        let fans = [(camera, probes.collect())];
        let all: Vec<(usize, Quantiles)> = rivals(&manifold, &fans, length).take(12).collect();
        let p99 = |steps: usize| all.iter().find(|(n, _)| *n == steps).unwrap().1.p99;
        let order = (p99(6) / p99(12)).log2();
        assert!((order - 4.0).abs() < 0.8, "{order}");
        assert!(all.last().unwrap().1.p99 < 0.05);
    }
}
