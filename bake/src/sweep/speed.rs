//! Times for one path.
//!
//! In: a table, or a number of steps, and a camera. Out: processor time for the path of a random
//! direction on one thread, the camera being fixed before. A path is its chart points at [`POINTS`]
//! arc lengths; the integrator's is all its steps. A bundle's paths come with tangents and are summed
//! over vectors of arc lengths; a grid's are without and point by point, so a grid could be made
//! somewhat quicker than it is here.

use super::{clock::Clock, grid::Grid};
use cpu_time::ThreadTime;
use geofan::{Result, bundle::Table, geodesic::fixed_steps, manifold::Manifold, random::Stream};
use glam::DVec3;
use std::hint::black_box;

/// Arc lengths at which a path is wanted.
pub const POINTS: usize = 16;

/// Directions of one measurement.
const DIRECTIONS: usize = 8192;

/// Directions handed on at once.
const BLOCK: usize = 256;

/// Measurements, of which the quickest counts: what disturbs only ever slows down (caches and
/// clock rates are shared with other programs).
const REPEATS: usize = 3;

/// Times of a table at one camera.
#[derive(Debug, Clone, Copy)]
pub struct Times {
    /// For a path, nanoseconds.
    pub path_ns: f64,
    /// For fixing the camera, milliseconds.
    pub contract_ms: f64,
}

/// Nanoseconds for each direction of `work` on blocks of them.
fn each(work: impl Fn(&[DVec3])) -> f64 {
    let mut stream = Stream::new(&[0x73_7065_6564]);
    let directions: Vec<DVec3> = (0..DIRECTIONS).map(|_| stream.direction()).collect();
    let run = || {
        let began = ThreadTime::now();
        directions.chunks(BLOCK).for_each(&work);
        began.elapsed().as_secs_f64() * 1e9 / DIRECTIONS as f64
    };
    (0..REPEATS).map(|_| run()).fold(f64::INFINITY, f64::min)
}

fn lengths(length: f64) -> [f64; POINTS] {
    std::array::from_fn(|i| length * (i + 1) as f64 / POINTS as f64)
}

/// Processor milliseconds of the quickest of a few runs, and what the last one made.
fn quickest<T>(work: impl Fn() -> Result<T>) -> Result<(T, f64)> {
    let mut least = f64::INFINITY;
    let run = || {
        let clock = Clock::start();
        work().map(|found| (found, 1e3 * clock.spent().cpu_s))
    };
    // The first run decodes; later frames do not.
    let mut found = run()?.0;
    for _ in 0..REPEATS {
        let (again, time) = run()?;
        (found, least) = (again, least.min(time));
    }
    Ok((found, least))
}

/// The times of a bundle's table at `u`.
///
/// # Errors
/// `u` is not in its region.
pub fn patches(table: &Table, u: DVec3) -> Result<Times> {
    let (fan, contract_ms) = quickest(|| table.fan(u))?;
    let s = lengths(table.length);
    let path_ns = each(|directions| {
        let mut rows = [0.0; 6 * POINTS];
        for d in directions {
            black_box(fan.path(*d).sample(&s, &mut rows));
            black_box(&rows);
        }
    });
    Ok(Times {
        path_ns,
        contract_ms,
    })
}

/// The times of a grid at `u`.
///
/// # Errors
/// `u` is not in its region.
pub fn grid(grid: &Grid, u: DVec3, length: f64) -> Result<Times> {
    let ((fixed, place), contract_ms) = quickest(|| grid.contracted(u))?;
    let fan = fixed.fixed_fan(place);
    let s = lengths(length);
    let path_ns = each(|directions| {
        for d in directions {
            let path = fan.path(*d);
            black_box(s.map(|s| path.at(s)));
        }
    });
    Ok(Times {
        path_ns,
        contract_ms,
    })
}

/// Nanoseconds for a path over `length` by `steps` equal steps from `u`.
pub fn exact(manifold: &Manifold, u: DVec3, length: f64, steps: usize) -> f64 {
    let observer = manifold.observer(u);
    each(|directions| {
        let rays: Vec<_> = directions
            .iter()
            .map(|d| (u, observer.tangent(*d)))
            .collect();
        black_box(fixed_steps::<f32>(manifold, &rays, length, steps));
    })
}
