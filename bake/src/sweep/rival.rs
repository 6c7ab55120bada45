//! Equal-error exact: the integrator that a table must beat.
//!
//! In: exact rays. Out: [`Rival`]s: classical Runge–Kutta in single precision over vectors of rays,
//! with more and more equal steps, each with its error on those rays and its time for a path. The
//! rival of a table is the one with the fewest steps whose 99th percentile of screen error is no
//! worse. Between steps its path is the cubic through points and tangents. It carries no rotation,
//! which a table has: that favours the rival.

use super::{
    speed,
    truth::{Truth, tellable},
};
use geofan::{geodesic::fixed_steps, manifold::Manifold, quantiles::Quantiles, render::Piece};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Steps tried.
const STEPS: [usize; 20] = [
    3, 4, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 96, 128, 192, 256, 384, 512, 1024,
];

/// An error, mrad, below which no table is.
const FLOOR: f64 = 1e-3;

/// An error, mrad, below which more steps that do not help mean that rounding of single precision
/// has been reached.
const ROUNDING: f64 = 1e-2;

/// An integrator with a fixed number of steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rival {
    /// Equal steps over the length.
    pub steps: usize,
    /// Screen errors, mrad.
    pub screen: Quantiles,
    /// Processor nanoseconds for a path.
    pub path_ns: f64,
}

/// The rivals on `truth`, timed from the camera `u`, fewest steps first, until their errors are small enough.
pub fn rivals(manifold: &Manifold, truth: &Truth, u: DVec3) -> Vec<Rival> {
    let mut found: Vec<Rival> = Vec::new();
    for steps in STEPS {
        let rival = measure(manifold, truth, u, steps);
        let p99 = rival.screen.p99;
        let before = found.last().map_or(f64::INFINITY, |last| last.screen.p99);
        found.push(rival);
        if p99 < FLOOR || (before < ROUNDING && p99 >= before) {
            break;
        }
    }
    found
}

/// The quickest of them whose error is no worse than `p99` mrad.
pub fn equal(rivals: &[Rival], p99: f64) -> Option<&Rival> {
    rivals.iter().find(|rival| rival.screen.p99 <= p99)
}

fn measure(manifold: &Manifold, truth: &Truth, u: DVec3, steps: usize) -> Rival {
    let cameras = truth.cameras.par_iter();
    let errors = cameras.flat_map_iter(|camera| {
        let observer = manifold.observer(camera.u);
        let rays: Vec<_> = camera
            .probes()
            .map(|(d, _)| (camera.u, observer.tangent(d)))
            .collect();
        let paths = fixed_steps::<f32>(manifold, &rays, truth.length, steps);
        let pairs = camera.probes().zip(paths);
        let errors = pairs.map(|((_, probe), path)| {
            let u = position(&path, truth.length, probe.s);
            tellable(probe.screen_mrad(u - probe.u))
        });
        errors.collect::<Vec<f64>>()
    });
    let mut errors: Vec<f64> = errors.collect();
    Rival {
        steps,
        screen: Quantiles::of(&mut errors),
        path_ns: speed::exact(manifold, u, truth.length, steps),
    }
}

/// The chart point at `s` on the cubics between the steps.
fn position((u, v): &(Vec<DVec3>, Vec<DVec3>), length: f64, s: f64) -> DVec3 {
    let steps = u.len() - 1;
    let place = s / length * steps as f64;
    let k = (place as usize).min(steps - 1);
    let at = |k: usize| length * k as f64 / steps as f64;
    let piece = Piece {
        s: [at(k), at(k + 1)],
        u: [u[k], u[k + 1]],
        v: [v[k], v[k + 1]],
    };
    piece.position(place - k as f64)
}
