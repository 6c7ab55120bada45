//! The sweep as a table: one row for each point, units in the header.

use crate::sweep::{
    grid::mean,
    point::{Key, Measured, Outcome, Point, What},
    rival::equal,
    subject::Results,
    truth::Errors,
};
use geofan_core::{Error, Result, files::write_atomically, quantiles::Quantiles};
use serde::Serialize;
use std::{io::Write, path::Path};

/// A row of the CSV, whose columns are the fields of all parts. Empty cells are what was not measured
/// or does not exist.
type Row<'a> = (Subject<'a>, Size, ErrorCells, Costs, Equal, Check);

/// The table.
#[derive(Debug, Clone, Serialize)]
struct Subject<'a> {
    manifold: &'a str,
    fingerprint: &'a str,
    version: &'a str,
    camera_parameters: usize,
    axes: usize,
    length: f64,
    representation: &'a str,
    promise_mrad: Option<f64>,
    cells: Option<String>,
    mean_spacing_share_of_axis: Option<f64>,
    outcome: &'a str,
}

/// What it takes up.
#[derive(Debug, Clone, Serialize)]
struct Size {
    disk_bytes: Option<u64>,
    memory_bytes: Option<u64>,
}

/// How exact it is.
#[derive(Debug, Clone, Serialize)]
struct ErrorCells {
    screen_p50_mrad: Option<f64>,
    screen_p95_mrad: Option<f64>,
    screen_p99_mrad: Option<f64>,
    screen_max_mrad: Option<f64>,
    position_p50_mrad: Option<f64>,
    position_p95_mrad: Option<f64>,
    position_p99_mrad: Option<f64>,
    position_max_mrad: Option<f64>,
    sky_p50_mrad: Option<f64>,
    sky_p95_mrad: Option<f64>,
    sky_p99_mrad: Option<f64>,
    sky_max_mrad: Option<f64>,
    rotation_p50_mrad: Option<f64>,
    rotation_p95_mrad: Option<f64>,
    rotation_p99_mrad: Option<f64>,
    rotation_max_mrad: Option<f64>,
    flagged_fraction: Option<f64>,
}

/// What making and reading it costs.
#[derive(Debug, Clone, Serialize)]
struct Costs {
    bake_wall_s: Option<f64>,
    bake_cpu_s: Option<f64>,
    baked_rays: Option<u64>,
    contract_cpu_ms: Option<f64>,
    lookup_cpu_ns_per_path: Option<f64>,
    frame_cpu_ms: Option<f64>,
}

/// Equal steps that are as exact.
#[derive(Debug, Clone, Serialize)]
struct Equal {
    exact_steps: Option<usize>,
    exact_screen_p99_mrad: Option<f64>,
    exact_cpu_ns_per_path: Option<f64>,
    exact_frame_cpu_ms: Option<f64>,
}

/// How it was measured.
#[derive(Debug, Clone, Serialize)]
struct Check {
    check_rays: usize,
    seed: u64,
    load_1min: Option<f64>,
}

/// Writes all points to the CSV file `path`.
///
/// # Errors
/// The place cannot be written.
pub fn write(path: &Path, all: &[Results]) -> Result<()> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::Environment {
        path: path.display().to_string(),
        source: std::io::Error::other(e),
    };
    for results in all {
        for point in &results.points {
            csv.serialize(row(results, point)).map_err(failed)?;
        }
    }
    let bytes = csv
        .into_inner()
        .map_err(|e| failed(e.into_error().into()))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

fn row<'a>(results: &'a Results, point: &'a Point) -> Row<'a> {
    let (measured, basis) = (point.measured(), &point.key.basis);
    let size = Size {
        disk_bytes: measured.map(|m| m.disk),
        memory_bytes: measured.map(|m| m.memory),
    };
    let check = Check {
        check_rays: basis.rays,
        seed: basis.seed,
        load_1min: measured.and_then(|m| m.load),
    };
    (
        Subject::new(results, point),
        size,
        ErrorCells::new(measured.map(|m| m.errors)),
        Costs::new(measured),
        Equal::new(results, measured),
        check,
    )
}

impl<'a> Subject<'a> {
    fn new(results: &'a Results, point: &'a Point) -> Self {
        let Key { basis, what } = &point.key;
        let (promise, cells) = match what {
            What::Patches { promise, .. } => (Some(*promise), None),
            What::Grid { cells, .. } => (None, Some(cells)),
        };
        Self {
            manifold: &basis.manifold,
            fingerprint: &basis.fingerprint[..16.min(basis.fingerprint.len())],
            version: &basis.version,
            camera_parameters: results.cameras,
            axes: results.axes,
            length: basis.length,
            representation: what.kind().name(),
            promise_mrad: promise,
            cells: cells.map(|_| what.setting()),
            mean_spacing_share_of_axis: cells.map(|cells| 1.0 / mean(cells)),
            outcome: match &point.outcome {
                Outcome::Measured(_) => "measured",
                Outcome::Skipped { why, .. } => why,
            },
        }
    }
}

impl ErrorCells {
    fn new(errors: Option<Errors>) -> Self {
        // A table that gave up on every ray has no errors.
        let known = errors.filter(|e| e.flagged < 1.0);
        let screen = four(known.map(|e| e.screen));
        let position = four(known.map(|e| e.mrad));
        let sky = four(known.map(|e| e.sky));
        let rotation = four(known.and_then(|e| e.rotation));
        Self {
            screen_p50_mrad: screen[0],
            screen_p95_mrad: screen[1],
            screen_p99_mrad: screen[2],
            screen_max_mrad: screen[3],
            position_p50_mrad: position[0],
            position_p95_mrad: position[1],
            position_p99_mrad: position[2],
            position_max_mrad: position[3],
            sky_p50_mrad: sky[0],
            sky_p95_mrad: sky[1],
            sky_p99_mrad: sky[2],
            sky_max_mrad: sky[3],
            rotation_p50_mrad: rotation[0],
            rotation_p95_mrad: rotation[1],
            rotation_p99_mrad: rotation[2],
            rotation_max_mrad: rotation[3],
            flagged_fraction: errors.map(|e| e.flagged),
        }
    }
}

impl Costs {
    fn new(measured: Option<&Measured>) -> Self {
        Self {
            bake_wall_s: measured.map(|m| m.bake.wall_s),
            bake_cpu_s: measured.map(|m| m.bake.cpu_s),
            baked_rays: measured.map(|m| m.baked_rays),
            contract_cpu_ms: measured.map(|m| m.contract_ms),
            lookup_cpu_ns_per_path: measured.map(|m| m.path_ns),
            frame_cpu_ms: measured.and_then(|m| m.frame_ms),
        }
    }
}

impl Equal {
    fn new(results: &Results, measured: Option<&Measured>) -> Self {
        let rival = measured.and_then(|m| equal(&results.rivals, m.errors.screen.p99));
        Self {
            exact_steps: rival.map(|r| r.steps),
            exact_screen_p99_mrad: rival.map(|r| r.screen.p99),
            exact_cpu_ns_per_path: rival.map(|r| r.path_ns),
            exact_frame_cpu_ms: measured.and_then(|m| m.rival_frame_ms),
        }
    }
}

/// Median, 95th and 99th percentile, largest.
fn four(quantiles: Option<Quantiles>) -> [Option<f64>; 4] {
    let pick = |of: fn(Quantiles) -> f64| quantiles.map(of);
    [
        pick(|q| q.p50),
        pick(|q| q.p95),
        pick(|q| q.p99),
        pick(|q| q.max),
    ]
}
