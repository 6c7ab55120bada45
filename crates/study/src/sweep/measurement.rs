//! Points of the sweep: what was measured of a table, under which conditions, the files that keep it, and the times of work,
//! of paths and of frames.
//!
//! In: the [`Conditions`] of a manifold's sweep, and a [`TableSpec`]. Out: its [`SweepPoint`] from the
//! file of an earlier run. A point is one small JSON file in `points/`, written whole or not at all; it
//! counts only if everything that the measurement depends on is the same.
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

use crate::sweep::{
    exact_rays::{ErrorMap, TableErrors},
    grid::{Grid, Interpolation, NumberFormat},
    tables::PatchDivision,
};
use cpu_time::{ProcessTime, ThreadTime};
use geofan_bundle::{Fan, Table, rays::Place};
use geofan_core::{
    Result,
    diagnostic::SourceText,
    files::{make_output_folder, write_atomically},
    geodesic::fixed_steps,
    manifold::Manifold,
    random::Stream,
};
use geofan_render::{
    Camera, FixedTracer, Lookup, View, World, drawing::draw, frame::Paths, scene::SceneFile,
    shade::Footprints,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{
    fs,
    hint::black_box,
    io::Write,
    ops::{Add, Sub},
    path::{Path, PathBuf},
    sync::{Arc, LazyLock},
    time::Instant,
};

/// Counts up when measurements or their files change their meaning.
const FORMAT: u32 = 4;

/// Says which table is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TableSpec {
    /// A bundle.
    Patches {
        /// Its promise, mrad.
        promise: f64,
        /// The division of its patches.
        division: PatchDivision,
    },
    /// A uniform grid.
    Grid {
        /// The interpolation between its nodes.
        interpolation: Interpolation,
        /// The format of its numbers.
        format: NumberFormat,
        /// Cells along camera…, direction…, arc length.
        cells: Vec<usize>,
    },
}

/// Names the tables that make one curve of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableKind {
    /// Adaptive patches.
    Patches,
    /// One patch for each chunk.
    UndividedPatches,
    /// Multilinear grid in single precision.
    MultilinearF32,
    /// Multilinear grid in 16 bits.
    MultilinearU16,
    /// Cubic grid in single precision.
    CubicF32,
    /// Cubic grid in 16 bits.
    CubicU16,
}

impl TableSpec {
    /// Returns the table's kind.
    pub fn kind(&self) -> TableKind {
        match self {
            Self::Patches { division, .. } => match division {
                PatchDivision::Adaptive => TableKind::Patches,
                PatchDivision::Undivided => TableKind::UndividedPatches,
            },
            Self::Grid {
                interpolation,
                format,
                ..
            } => match (interpolation, format) {
                (Interpolation::Multilinear, NumberFormat::F32) => TableKind::MultilinearF32,
                (Interpolation::Multilinear, NumberFormat::U16) => TableKind::MultilinearU16,
                (Interpolation::Cubic, NumberFormat::F32) => TableKind::CubicF32,
                (Interpolation::Cubic, NumberFormat::U16) => TableKind::CubicU16,
            },
        }
    }

    /// Writes the setting that tells the table from others of its kind.
    pub fn setting(&self) -> String {
        match self {
            Self::Patches { promise, .. } => format!("{promise}"),
            Self::Grid { cells, .. } => {
                let cells: Vec<String> = cells.iter().map(usize::to_string).collect();
                cells.join("x")
            }
        }
    }
}

impl TableKind {
    /// All kinds that are drawn, in the order of the legend.
    pub const ALL: [Self; 6] = [
        Self::Patches,
        Self::UndividedPatches,
        Self::MultilinearF32,
        Self::MultilinearU16,
        Self::CubicF32,
        Self::CubicU16,
    ];

    /// Returns the name in figures.
    pub fn title(self) -> &'static str {
        match self {
            Self::Patches => "patches",
            Self::UndividedPatches => "patches, undivided",
            Self::MultilinearF32 => "multilinear, float",
            Self::MultilinearU16 => "multilinear, 16-bit",
            Self::CubicF32 => "cubic, float",
            Self::CubicU16 => "cubic, 16-bit",
        }
    }

    /// Returns the name in files and the CSV.
    pub fn name(self) -> &'static str {
        match self {
            Self::Patches => "patches",
            Self::UndividedPatches => "undivided-patches",
            Self::MultilinearF32 => "multilinear-f32",
            Self::MultilinearU16 => "multilinear-u16",
            Self::CubicF32 => "cubic-f32",
            Self::CubicU16 => "cubic-u16",
        }
    }
}

/// Everything that all measurements of a manifold depend on, besides the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Version of the measurement.
    pub format: u32,
    /// Version of geofan, and of its refinement.
    pub version: String,
    /// The manifold's file, without folder and ending.
    pub manifold: String,
    /// Hash of its text and parameters.
    pub fingerprint: String,
    /// Arc length of the paths.
    pub length: f64,
    /// The number of fresh rays.
    pub rays: usize,
    /// Their seed.
    pub seed: u64,
}

/// The measurement of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TableMeasurement {
    /// Bytes of its file.
    pub disk: u64,
    /// Bytes in memory.
    pub memory: u64,
    /// Its errors.
    pub errors: TableErrors,
    /// Time of its bake.
    pub bake: TimeSpent,
    /// Rays that the bake integrated.
    pub baked_rays: u64,
    /// Processor time for fixing the camera.
    pub contract_ms: f64,
    /// Processor time for one path.
    pub path_ns: f64,
    /// Processor time for a frame of the default view.
    pub frame_ms: Option<f64>,
    /// Processor time for that frame by equal-error exact.
    pub rival_frame_ms: Option<f64>,
    /// The system's load over the last minute when it was measured, where it is known.
    pub load: Option<f64>,
}

/// Limits of the work for one table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TableLimits {
    /// Processor seconds for a bundle, all threads together.
    pub seconds: f64,
    /// Bytes of a grid in single precision.
    pub grid_bytes: u64,
}

/// Says whether a table was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointOutcome {
    /// It was measured.
    Measured(Box<TableMeasurement>),
    /// It was beyond a limit.
    Skipped {
        /// The limit, in words.
        why: String,
        /// The limits.
        limits: TableLimits,
    },
}

/// A point of the sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SweepPoint {
    /// The table.
    pub spec: TableSpec,
    /// Its measurement.
    pub outcome: PointOutcome,
    /// Maps of its errors, if they were asked for.
    pub maps: Vec<ErrorMap>,
}

impl Conditions {
    /// Describes measurements on fresh rays in a manifold, by the running version.
    pub fn new(name: String, manifold: &Manifold, length: f64, rays: usize, seed: u64) -> Self {
        let fingerprint = manifold.fingerprint();
        let refinement = geofan_bake::plan::REFINEMENT;
        Self {
            format: FORMAT,
            version: format!("{}+{refinement}", env!("CARGO_PKG_VERSION")),
            manifold: name,
            fingerprint: fingerprint.iter().map(|b| format!("{b:02x}")).collect(),
            length,
            rays,
            seed,
        }
    }
}

impl SweepPoint {
    /// Returns the measurement, if there is one.
    pub fn measured(&self) -> Option<&TableMeasurement> {
        match &self.outcome {
            PointOutcome::Measured(measured) => Some(measured),
            PointOutcome::Skipped { .. } => None,
        }
    }
}

/// Keeps measurements of one manifold in a folder.
#[derive(Debug, Clone)]
pub struct PointStore {
    folder: PathBuf,
    /// The measurements that are asked for.
    pub conditions: Conditions,
}

impl PointStore {
    /// Opens the folder `points` of `out`, which is made if it is missing.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn open(out: &Path, conditions: Conditions) -> Result<Self> {
        let folder = out.join("points");
        make_output_folder(&folder)?;
        Ok(Self { folder, conditions })
    }

    /// Names the files of a table.
    pub fn name(&self, spec: &TableSpec) -> String {
        let manifold = &self.conditions.manifold;
        format!("{manifold}-{}-{}", spec.kind().name(), spec.setting())
    }

    /// Loads the value kept under `name`, if it can be read and was measured under these conditions.
    pub fn load<T: for<'a> Deserialize<'a>>(&self, name: &str) -> Option<T> {
        let text = fs::read(self.path(name)).ok()?;
        let (conditions, value): (Conditions, T) = serde_json::from_slice(&text).ok()?;
        (conditions == self.conditions).then_some(value)
    }

    /// Keeps `value` under `name`.
    ///
    /// # Errors
    /// The place cannot be written.
    pub fn keep(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.path(name);
        write_atomically(&path, |out| {
            serde_json::to_writer(&mut *out, &(&self.conditions, value))?;
            out.write_all(b"\n")
        })
    }

    /// Loads the point of a table; one that was skipped depends on the `limits` too.
    pub fn point(&self, spec: &TableSpec, limits: TableLimits) -> Option<SweepPoint> {
        let point: SweepPoint = self.load(&self.name(spec))?;
        let skipped_for_others = match &point.outcome {
            PointOutcome::Measured(_) => false,
            PointOutcome::Skipped { limits: then, .. } => *then != limits,
        };
        (point.spec == *spec && !skipped_for_others).then_some(point)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }
}

/// Reads the system's load over the last minute, where Linux tells it.
pub fn load() -> Option<f64> {
    let text = fs::read_to_string("/proc/loadavg").ok()?;
    text.split(' ').next()?.parse().ok()
}

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
        fan.prepare(&view.spread());
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
