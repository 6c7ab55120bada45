//! The sweep as a CSV file: one row for each point, units in the header. Empty cells are values that
//! were not measured or do not exist.

use crate::sweep::{
    grid::mean,
    manifold_sweep::{ManifoldResults, equal_error},
    point::{PointOutcome, SweepPoint, TableSpec},
};
use csv::Writer;
use geofan_core::{Error, Result, files::write_atomically, quantiles::Quantiles};
use serde_json::Value;
use std::{io::Write, path::Path};

/// The cells of a row, with their columns' names.
type CsvRow = Vec<(String, Value)>;

/// Writes all points to the CSV file `path`.
///
/// # Errors
/// The place cannot be written.
pub fn write(path: &Path, all: &[ManifoldResults]) -> Result<()> {
    let mut csv = Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::Environment {
        path: path.display().to_string(),
        source: std::io::Error::other(e),
    };
    let points = all
        .iter()
        .flat_map(|results| results.points.iter().map(move |point| (results, point)));
    for (i, (results, point)) in points.enumerate() {
        let row = row(results, point);
        if i == 0 {
            csv.write_record(row.iter().map(|(column, _)| column))
                .map_err(failed)?;
        }
        csv.write_record(row.iter().map(|(_, value)| text(value)))
            .map_err(failed)?;
    }
    let bytes = csv
        .into_inner()
        .map_err(|e| failed(e.into_error().into()))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// Writes a cell: text without quotation marks, numbers as in JSON.
fn text(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        number => number.to_string(),
    }
}

/// Adds a cell; an `Option` may be empty.
fn put(row: &mut CsvRow, column: &str, value: impl Into<Value>) {
    row.push((column.into(), value.into()));
}

/// Adds the cells of one kind of error.
fn put_quantiles(row: &mut CsvRow, error: &str, q: Option<Quantiles>) {
    put(row, &format!("{error}_p50_mrad"), q.map(|q| q.p50));
    put(row, &format!("{error}_p95_mrad"), q.map(|q| q.p95));
    put(row, &format!("{error}_p99_mrad"), q.map(|q| q.p99));
    put(row, &format!("{error}_max_mrad"), q.map(|q| q.max));
}

fn row(results: &ManifoldResults, point: &SweepPoint) -> CsvRow {
    let mut row = CsvRow::new();
    put_table(&mut row, results, point);
    put_measurement(&mut row, point);
    put_rival(&mut row, results, point);
    let m = point.measured();
    put(&mut row, "check_rays", results.conditions.rays);
    put(&mut row, "seed", results.conditions.seed);
    put(&mut row, "load_1min", m.and_then(|m| m.load));
    row
}

/// Adds the cells that say which table it is.
fn put_table(row: &mut CsvRow, results: &ManifoldResults, point: &SweepPoint) {
    let (conditions, spec) = (&results.conditions, &point.spec);
    let (promise, cells) = match spec {
        TableSpec::Patches { promise, .. } => (Some(*promise), None),
        TableSpec::Grid { cells, .. } => (None, Some(cells)),
    };
    let fingerprint: String = conditions.fingerprint.chars().take(16).collect();
    put(row, "manifold", conditions.manifold.clone());
    put(row, "fingerprint", fingerprint);
    put(row, "version", conditions.version.clone());
    put(row, "camera_parameters", results.cameras);
    put(row, "axes", results.axes);
    put(row, "length", conditions.length);
    put(row, "representation", spec.kind().name());
    put(row, "promise_mrad", promise);
    put(row, "cells", cells.map(|_| spec.setting()));
    let spacing = cells.map(|cells| 1.0 / mean(cells));
    put(row, "mean_spacing_share_of_axis", spacing);
    let outcome = match &point.outcome {
        PointOutcome::Measured(_) => "measured",
        PointOutcome::Skipped { why, .. } => why,
    };
    put(row, "outcome", outcome);
}

/// Adds sizes, errors and costs.
fn put_measurement(row: &mut CsvRow, point: &SweepPoint) {
    let m = point.measured();
    put(row, "disk_bytes", m.map(|m| m.disk));
    put(row, "memory_bytes", m.map(|m| m.memory));
    // A table that gave up on every ray has no errors.
    let errors = m.map(|m| m.errors);
    let known = errors.filter(|e| e.flagged < 1.0);
    put_quantiles(row, "screen", known.map(|e| e.screen));
    put_quantiles(row, "position", known.map(|e| e.mrad));
    put_quantiles(row, "sky", known.map(|e| e.sky));
    put_quantiles(row, "rotation", known.and_then(|e| e.rotation));
    put(row, "flagged_fraction", errors.map(|e| e.flagged));
    put(row, "bake_wall_s", m.map(|m| m.bake.wall_s));
    put(row, "bake_cpu_s", m.map(|m| m.bake.cpu_s));
    put(row, "baked_rays", m.map(|m| m.baked_rays));
    put(row, "contract_cpu_ms", m.map(|m| m.contract_ms));
    put(row, "lookup_cpu_ns_per_path", m.map(|m| m.path_ns));
    put(row, "frame_cpu_ms", m.and_then(|m| m.frame_ms));
}

/// Adds the cells about equal steps that are as exact.
fn put_rival(row: &mut CsvRow, results: &ManifoldResults, point: &SweepPoint) {
    let m = point.measured();
    let rival = m.and_then(|m| equal_error(&results.rivals, m.errors.screen.p99));
    put(row, "exact_steps", rival.map(|r| r.steps));
    put(row, "exact_screen_p99_mrad", rival.map(|r| r.screen.p99));
    put(row, "exact_cpu_ns_per_path", rival.map(|r| r.path_ns));
    let frame = m.and_then(|m| m.rival_frame_ms);
    put(row, "exact_frame_cpu_ms", frame);
}
