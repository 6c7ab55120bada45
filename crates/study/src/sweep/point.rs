//! One point of the sweep: what was measured, under which settings, and the file that keeps it.
//!
//! In: a [`Key`]. Out: its [`Point`], from the file of an earlier run or measured now. A point is one
//! small JSON file in `points/`, written whole or not at all; it counts only if everything that the
//! measurement depends on is the same.

use crate::sweep::{
    clock::Spent,
    grid::{Interpolation, Number},
    maps::ErrorMap,
    patches::{Limits, Refinement},
    truth::Errors,
};
use geofan_core::{Error, Result, files::write_atomically, manifold::Manifold};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// Counts up when measurements change their meaning.
const FORMAT: u32 = 3;

/// Which table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// A bundle.
    Patches {
        /// Its promise, mrad.
        promise: f64,
        /// How it is refined.
        refinement: Refinement,
    },
    /// A uniform grid.
    Grid {
        /// How it is read.
        interpolation: Interpolation,
        /// How its numbers are stored.
        number: Number,
        /// Cells along camera…, direction…, arc length.
        cells: Vec<usize>,
    },
}

/// What a table is called in figures and files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
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

impl What {
    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Patches { refinement, .. } => match refinement {
                Refinement::Adaptive => Kind::Patches,
                Refinement::Undivided => Kind::UndividedPatches,
            },
            Self::Grid {
                interpolation,
                number,
                ..
            } => match (interpolation, number) {
                (Interpolation::Multilinear, Number::F32) => Kind::MultilinearF32,
                (Interpolation::Multilinear, Number::U16) => Kind::MultilinearU16,
                (Interpolation::Cubic, Number::F32) => Kind::CubicF32,
                (Interpolation::Cubic, Number::U16) => Kind::CubicU16,
            },
        }
    }

    /// What sets it apart from others of its kind.
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

impl Kind {
    /// The name in figures.
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

    /// The name in files and the CSV.
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

/// What all points of a manifold depend on, besides the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    /// Version of the measurement.
    pub format: u32,
    /// Version of geofan, and of its refinement.
    pub version: String,
    /// The manifold's file, without folder and ending.
    pub manifold: String,
    /// Hash of its text and parameters.
    pub fingerprint: String,
    /// How far paths go.
    pub length: f64,
    /// The number of fresh rays.
    pub rays: usize,
    /// Their seed.
    pub seed: u64,
}

/// Everything that a measurement depends on, besides the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// What it shares with the manifold's other points.
    #[serde(flatten)]
    pub basis: Basis,
    /// The table.
    pub what: What,
}

/// What was measured of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Bytes of its file.
    pub disk: u64,
    /// Bytes in memory.
    pub memory: u64,
    /// Its errors.
    pub errors: Errors,
    /// Time of its bake.
    pub bake: Spent,
    /// Rays that the bake integrated.
    pub baked_rays: u64,
    /// Processor time for fixing the camera.
    pub contract_ms: f64,
    /// Processor time for one path.
    pub path_ns: f64,
    /// Processor time for a frame of the default view.
    pub frame_ms: Option<f64>,
    /// For the same frame by equal-error exact.
    pub rival_frame_ms: Option<f64>,
    /// The system's load over the last minute when it was measured, where it is known.
    pub load: Option<f64>,
}

/// What became of a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// It was measured.
    Measured(Box<Measured>),
    /// It was beyond a limit.
    Skipped {
        /// Which, in words.
        why: String,
        /// The limits.
        limits: Limits,
    },
}

/// A point of the sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// What it depends on.
    pub key: Key,
    /// What became of it.
    pub outcome: Outcome,
    /// Where its errors lie, if that was asked for.
    pub maps: Vec<ErrorMap>,
}

impl Basis {
    /// Of fresh rays in a manifold, by the running version.
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

    /// The key of a table.
    pub fn of(&self, what: What) -> Key {
        Key {
            basis: self.clone(),
            what,
        }
    }
}

impl Key {
    /// A name for files.
    pub fn name(&self) -> String {
        let (manifold, what) = (&self.basis.manifold, &self.what);
        format!("{manifold}-{}-{}", what.kind().name(), what.setting())
    }
}

impl Point {
    /// The measurement, if there is one.
    pub fn measured(&self) -> Option<&Measured> {
        match &self.outcome {
            Outcome::Measured(measured) => Some(measured),
            Outcome::Skipped { .. } => None,
        }
    }
}

/// Kept results in a folder.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// In the folder `points` of `out`, which is made if it is missing.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn open(out: &Path) -> Result<Self> {
        let folder = out.join("points");
        fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        Ok(Self { folder })
    }

    /// What was kept under `name`, if it can be read.
    pub fn load<T: for<'a> Deserialize<'a>>(&self, name: &str) -> Option<T> {
        let text = fs::read(self.path(name)).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// Keeps `value` under `name`.
    ///
    /// # Errors
    /// The place cannot be written.
    pub fn keep(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.path(name);
        write_atomically(&path, |out| {
            serde_json::to_writer(&mut *out, value)?;
            out.write_all(b"\n")
        })
    }

    /// The kept point of `key`, if everything that it depends on is the same; one that was skipped
    /// depends on the `limits` too.
    pub fn point(&self, key: &Key, limits: Limits) -> Option<Point> {
        let point: Point = self.load(&key.name())?;
        let skipped_for_others = match &point.outcome {
            Outcome::Measured(_) => false,
            Outcome::Skipped { limits: then, .. } => *then != limits,
        };
        (point.key == *key && !skipped_for_others).then_some(point)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }
}

/// The system's load over the last minute, where Linux tells it.
pub fn load() -> Option<f64> {
    let text = fs::read_to_string("/proc/loadavg").ok()?;
    text.split(' ').next()?.parse().ok()
}
