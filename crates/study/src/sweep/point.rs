//! Points of the sweep: what was measured of a table, under which conditions, and the files that keep
//! it.
//!
//! In: the [`Conditions`] of a manifold's sweep, and a [`TableSpec`]. Out: its [`SweepPoint`] from the
//! file of an earlier run. A point is one small JSON file in `points/`, written whole or not at all; it
//! counts only if everything that the measurement depends on is the same.

use crate::sweep::{
    exact_rays::{ErrorMap, TableErrors},
    grid::{Interpolation, NumberFormat},
    tables::PatchDivision,
    timing::TimeSpent,
};
use geofan_core::{
    Result,
    files::{make_output_folder, write_atomically},
    manifold::Manifold,
};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
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
