//! Times of work, of paths and of frames.
//!
//! In: some work; or a table, a number of steps, and a camera. Out: times by the clock and of
//! processors ([`TimeSpent`]). Processor time of all threads together does not count what other programs
//! on one machine take away, so figures from a busy machine can be compared.
//!
//! A path is timed for a random direction on one thread, the camera being fixed before. It is its chart
//! points at [`POINTS`] arc lengths; the integrator's is all its steps. A bundle's paths come with
//! tangents and are summed over vectors of arc lengths; a grid's are without and point by point, so a
//! grid could be made somewhat quicker than it is here.
//!
//! A frame has [`WIDTH`] × [`HEIGHT`] pixels, one sample each, of a world without objects and with a sky
//! behind every exit, seen from the middle of the camera region along the first axis of the standard
//! frame, by the lattice that `geofan render` uses.

use crate::sweep::grid::Grid;
use cpu_time::{ProcessTime, ThreadTime};
use geofan_bundle::{Fan, Table, rays::Place};
use geofan_core::{
    Result, diagnostic::SourceText, geodesic::fixed_steps, manifold::Manifold, random::Stream,
};
use geofan_render::{
    Camera, FixedTracer, Lookup, View, World, drawing::draw, frame::Paths, scene::SceneFile,
    shade::Footprints,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{
    hint::black_box,
    ops::{Add, Sub},
    path::Path,
    sync::{Arc, LazyLock},
    time::Instant,
};

/// Time that work took, seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeSpent {
    /// Time by the clock on the wall.
    pub wall_s: f64,
    /// Time of processors, all threads together.
    pub cpu_s: f64,
}

impl TimeSpent {
    /// Returns the time that the program has spent so far; the difference of two is that of the work
    /// between them.
    pub fn now() -> Self {
        static FIRST: LazyLock<Instant> = LazyLock::new(Instant::now);
        Self {
            wall_s: FIRST.elapsed().as_secs_f64(),
            cpu_s: ProcessTime::now().as_duration().as_secs_f64(),
        }
    }

    /// Returns the time since an earlier [`TimeSpent::now`].
    pub fn since(earlier: Self) -> Self {
        Self::now() - earlier
    }
}

impl Add for TimeSpent {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            wall_s: self.wall_s + other.wall_s,
            cpu_s: self.cpu_s + other.cpu_s,
        }
    }
}

impl Sub for TimeSpent {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            wall_s: self.wall_s - other.wall_s,
            cpu_s: self.cpu_s - other.cpu_s,
        }
    }
}

/// Arc lengths at which a path is wanted.
pub const POINTS: usize = 16;

/// Directions of one measurement.
const DIRECTIONS: usize = 8192;

/// Directions handed on at once.
const BLOCK: usize = 256;

/// Measurements, of which the quickest counts: disturbances only ever slow work down (caches and
/// clock rates are shared with other programs).
const REPEATS: usize = 3;

/// Runs `work` on blocks of directions; returns the nanoseconds for each direction.
fn each_direction(work: impl Fn(&[DVec3])) -> f64 {
    let mut stream = Stream::new(&[0x73_7065_6564]);
    let directions: Vec<DVec3> = (0..DIRECTIONS).map(|_| stream.direction()).collect();
    let run = || {
        let began = ThreadTime::now();
        directions.chunks(BLOCK).for_each(&work);
        began.elapsed().as_secs_f64() * 1e9 / DIRECTIONS as f64
    };
    (0..REPEATS).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Returns the equally spaced arc lengths at which a path is wanted.
fn arc_lengths(length: f64) -> [f64; POINTS] {
    std::array::from_fn(|i| length * (i + 1) as f64 / POINTS as f64)
}

/// Runs `work` a few times; returns its last result and the processor milliseconds of the quickest.
fn quickest<T>(work: impl Fn() -> T) -> (T, f64) {
    let run = || {
        let began = TimeSpent::now();
        (work(), 1e3 * TimeSpent::since(began).cpu_s)
    };
    let (mut found, mut least) = run();
    for _ in 1..REPEATS {
        let (again, time) = run();
        (found, least) = (again, least.min(time));
    }
    (found, least)
}

/// Fixes the camera of a bundle's table at `u`; returns the fan and the processor milliseconds.
///
/// # Errors
/// `u` is not in its region.
pub fn bundle_fan(table: &Table, u: DVec3) -> Result<(Fan, f64)> {
    // The first look-up decodes; later frames do not.
    table.fan(u)?;
    let (fan, time) = quickest(|| table.fan(u));
    Ok((fan?, time))
}

/// Measures the nanoseconds for one path of a bundle's fan.
pub fn bundle_path(fan: &Fan, length: f64) -> f64 {
    let s = arc_lengths(length);
    each_direction(|directions| {
        let mut rows = [0.0; 6 * POINTS];
        for d in directions {
            black_box(fan.path(*d).sample_into(&s, &mut rows));
            black_box(&rows);
        }
    })
}

/// Fixes the camera of a grid at `u`; returns the smaller grid with the camera's place, and the
/// processor milliseconds.
///
/// # Errors
/// `u` is not in its region.
pub fn grid_fan(grid: &Grid, u: DVec3) -> Result<((Grid, Place), f64)> {
    let (fixed, time) = quickest(|| grid.contracted(u));
    Ok((fixed?, time))
}

/// Measures the nanoseconds for one path of a grid with a fixed camera.
pub fn grid_path((fixed, place): (Grid, Place), length: f64) -> f64 {
    let fan = fixed.fixed_fan(place);
    let s = arc_lengths(length);
    each_direction(|directions| {
        for d in directions {
            let path = fan.path(*d);
            black_box(s.map(|s| path.at(s)));
        }
    })
}

/// Measures the nanoseconds for a path over `length` by `steps` equal steps from `u`.
pub fn fixed_steps_path(manifold: &Manifold, u: DVec3, length: f64, steps: usize) -> f64 {
    let local = manifold.local_frame(u);
    each_direction(|directions| {
        let rays: Vec<_> = directions.iter().map(|d| (u, local.tangent(*d))).collect();
        black_box(fixed_steps::<f32>(manifold, &rays, length, steps));
    })
}

/// Columns of a frame.
pub const WIDTH: usize = 640;

/// Rows of a frame.
pub const HEIGHT: usize = 360;

/// Largest error of the lattice, radians.
const LATTICE_ERROR: f64 = 1e-3 * 0.25;

/// Local tolerance of rays that a table gave up on.
const TOLERANCE: f64 = 1e-8;

/// Makes the default view of `manifold`; `None` without a camera region.
///
/// # Errors
/// The view cannot be made.
pub fn default_view(manifold: &Arc<Manifold>) -> Result<Option<(World, View)>> {
    let Some(region) = &manifold.cameras else {
        return Ok(None);
    };
    let u = region.at(&region.lerp(&[0.5; 3]));
    let camera = Camera::looking(u, -DVec3::X, DVec3::Z);
    // A scene with nothing but skies.
    let skies = manifold.exits.iter().map(|exit| {
        let name = serde_json::Value::from(exit.name.as_str());
        format!("{name} = {{ pattern = \"grid\" }}\n")
    });
    let skies: String = skies.collect();
    let text = format!(
        "manifold = \"-\"\n[camera]\nat = [0, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n[sky]\n{skies}"
    );
    let scene = SceneFile::parse(SourceText::new("default view", text), Path::new("."))?;
    let world = World::new(&scene, manifold.clone(), 0.0)?;
    let view = View::of_camera(&camera, 90.0, (WIDTH, HEIGHT));
    Ok(Some((world, view)))
}

/// Measures the processor milliseconds of a frame by `table`, whose promise is `promise` mrad, the
/// camera fixed anew.
///
/// # Errors
/// The view's camera is not in the table's region.
pub fn bundle_frame((world, view): &(World, View), table: &Table, promise: f64) -> Result<f64> {
    let lookup = Lookup::new(table, 1e-3 * promise, TOLERANCE);
    let frame = || {
        let fan = table.fan(view.u)?;
        let tracer = lookup.tracer(&fan);
        draw_frame(world, view, Paths::Lattice(&tracer, LATTICE_ERROR));
        Ok(())
    };
    let (drawn, time) = quickest(frame);
    drawn.map(|()| time)
}

/// Measures the processor milliseconds of a frame by `steps` equal steps over `length`, by the same
/// lattice.
pub fn fixed_steps_frame((world, view): &(World, View), length: f64, steps: usize) -> f64 {
    let tracer = FixedTracer::new(&world.manifold, view.u, length, steps);
    quickest(|| draw_frame(world, view, Paths::Lattice(&tracer, LATTICE_ERROR))).1
}

fn draw_frame(world: &World, view: &View, paths: Paths<'_>) {
    black_box(draw(
        world,
        view,
        paths,
        1,
        Footprints::Filtered,
        &geofan_render::no_clock,
    ));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_in_two_parts_takes_the_time_of_both() {
        let began = TimeSpent::now();
        let mut sum = 0.0;
        for i in 0..2_000_000 {
            sum += f64::from(black_box(i)).sqrt();
        }
        black_box(sum);
        let middle = TimeSpent::now();
        let both = (middle - began) + TimeSpent::since(middle);
        assert!(both.wall_s >= (middle - began).wall_s && both.cpu_s > 0.0);
    }
}
