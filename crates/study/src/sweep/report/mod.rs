//! The report of a sweep: for people, and as a CSV file.
//!
//! In: [`ManifoldResults`] of all manifolds. Out: figures as SVG and PNG in `figures/`, and `index.html`,
//! which stands alone: its pictures are inside it; or `sweep.csv`, one row for each point, units in the header, in which
//! empty cells are values that were not measured or do not exist.

mod figures;
#[cfg(test)]
mod tests;

use crate::sweep::{
    grid::mean,
    manifold_sweep::{MOST_FLAGGED, ManifoldResults, equal_error},
    measurement::{
        HEIGHT, POINTS, PointOutcome, SweepPoint, TableKind, TableMeasurement, TableSpec, WIDTH,
    },
};
use base64::{Engine, prelude::BASE64_STANDARD};
use csv::Writer;
use figures::{Figure, byte_slopes, frames_to_pay, paths_to_pay, size_ratio, spacing_orders};
use geofan_core::{
    Error, Result,
    files::{make_output_folder, write_atomically},
    quantiles::Quantiles,
};
use serde_json::Value;
use std::{fmt::Write as _, io::Write as _, path::Path};

/// Writes the figures and the page about `all` into `out`; `command` is what repeats it.
///
/// # Errors
/// A figure cannot be drawn, or the place cannot be written.
pub fn write(out: &Path, all: &[ManifoldResults], command: &str) -> Result<()> {
    let folder = out.join("figures");
    make_output_folder(&folder)?;
    let mut figures: Vec<Vec<Figure>> = Vec::new();
    for results in all {
        let mut own = figures::figures(results)?;
        own.extend(figures::pictures(results)?);
        for figure in &own {
            save(&folder, figure)?;
        }
        figures.push(own);
    }
    let html = page(all, &figures, command);
    write_atomically(&out.join("index.html"), |file| {
        file.write_all(html.as_bytes())
    })
}

/// Saves a figure in its formats.
fn save(folder: &Path, figure: &Figure) -> Result<()> {
    let path = |ending: &str| folder.join(format!("{}.{ending}", figure.name));
    if let Some(svg) = &figure.svg {
        write_atomically(&path("svg"), |file| file.write_all(svg.as_bytes()))?;
    }
    write_atomically(&path("png"), |file| file.write_all(&figure.png))
}

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:72em;margin:2em auto;padding:0 1em}\
    table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:.2em .6em;\
    text-align:right}td:first-child,th:first-child{text-align:left}figure{display:inline-block;\
    margin:.5em;vertical-align:top;max-width:620px}figcaption{font-size:13px;color:#333}\
    img,svg{max-width:100%;height:auto}code{background:#eee;padding:.1em .3em}";

/// Writes the page about `all`, whose pictures are `figures`, made by `command`.
fn page(all: &[ManifoldResults], figures: &[Vec<Figure>], command: &str) -> String {
    let mut html = format!(
        "<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\">\
         <title>geofan sweep</title><style>{STYLE}</style></head><body>\n\
         <h1>Accuracy against table size</h1>\n\
         <p>Made by geofan {} with <code>{}</code>. Run it again to repeat it; points already \
         measured are kept in <code>points/</code> unless that folder is removed.</p>\n",
        env!("CARGO_PKG_VERSION"),
        escaped(command)
    );
    html += &definitions(all);
    html += &when_to_bake(all);
    html += &at_equal_error(all);
    for (results, figures) in all.iter().zip(figures) {
        html += &section(results, figures);
    }
    html + "</body></html>\n"
}

/// Explains the words of the tables.
fn definitions(all: &[ManifoldResults]) -> String {
    let rays = all.iter().map(|r| r.conditions.rays).max().unwrap_or(0);
    format!(
        "<p><i>Screen error</i>: distance across the ray between table and exact position, divided \
         by arc length and by the ray's magnification (taken as at least 0.25); one mrad is about a \
         pixel of a 1920-wide view of 90°. Errors are quantiles over up to {rays} fresh random rays \
         that no table was made from; a largest error is the largest of those, not a bound. \
         Of grids, only the share of bytes counts that a space's mirrors leave to a bundle. \
         <i>Exact</i> is classical Runge–Kutta in single precision over vectors of rays, with the \
         fewest equal steps whose 99th percentile is no worse than the table's; it is measured on all rays, and a table \
         that gives up more than {:.0} % of them is not held against it. A path from a table \
         is its chart points at {POINTS} arc lengths. Times are processor time, all threads together, which other \
         programs on the machine disturb less than the clock.</p>\n",
        100.0 * MOST_FLAGGED
    )
}

/// Writes a row of cells, the first to the left.
fn row(cells: &[String], tag: &str) -> String {
    let cells: Vec<String> = cells
        .iter()
        .map(|c| format!("<{tag}>{c}</{tag}>"))
        .collect();
    format!("<tr>{}</tr>\n", cells.join(""))
}

fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let head: Vec<String> = head.iter().map(|h| (*h).to_string()).collect();
    let body: String = rows.map(|cells| row(&cells, "td")).collect();
    format!("<table>{}{body}</table>\n", row(&head, "th"))
}

/// Writes three significant digits.
fn short(x: f64) -> String {
    let decimals = (2 - x.abs().max(1e-9).log10().floor() as i32).clamp(0, 6) as usize;
    match x.abs() >= 1e6 || x.abs() < 1e-4 {
        true => format!("{x:.2e}"),
        false => format!("{x:.decimals$}"),
    }
}

fn after(count: Option<f64>) -> String {
    count.map_or("never".into(), short)
}

const PAYOFF_HEAD: [&str; 12] = [
    "manifold",
    "promise, mrad",
    "p99, mrad",
    "bytes",
    "bake, s",
    "table, ns/path",
    "table, ms/frame",
    "exact steps",
    "exact, ns/path",
    "exact, ms/frame",
    "pays after paths",
    "pays after frames",
];

/// Tells after how many paths and frames a bake pays.
fn when_to_bake(all: &[ManifoldResults]) -> String {
    let rows = all.iter().flat_map(|results| {
        let points = results.of(TableKind::Patches).into_iter();
        points.map(|(point, m)| {
            let mut cells = vec![
                escaped(&results.title),
                point.spec.setting(),
                short(m.errors.screen.p99),
                m.disk.to_string(),
                short(m.bake.cpu_s),
                short(m.path_ns),
                m.frame_ms.map_or("–".into(), short),
            ];
            cells.extend(payoff_cells(results, m));
            cells
        })
    });
    format!(
        "<h2>When to bake</h2><p>Bake and lookups against equal-error exact. Frames are \
         {WIDTH} × {HEIGHT} pixels of an empty scene by the same lattice of paths, the camera \
         fixed anew for each; <i>never</i>: the integrator is as quick.</p>\n{}",
        table(&PAYOFF_HEAD, rows)
    )
}

fn payoff_cells(results: &ManifoldResults, m: &TableMeasurement) -> Vec<String> {
    let Some(rival) = equal_error(&results.rivals, &m.errors) else {
        let mut cells = vec!["–".to_string(); 3];
        let why = match m.errors.flagged > MOST_FLAGGED {
            true => "–",
            false => "exact never as good",
        };
        cells.extend([why.into(), why.into()]);
        return cells;
    };
    vec![
        rival.steps.to_string(),
        short(rival.path_ns),
        m.rival_frame_ms.map_or("–".into(), short),
        after(paths_to_pay(m, rival)),
        after(frames_to_pay(m)),
    ]
}

const RATIO_HEAD: [&str; 9] = [
    "manifold",
    "camera parameters",
    "promise, mrad",
    "p99, mrad",
    "bytes of patches",
    "multilinear, float",
    "multilinear, 16-bit",
    "cubic, float",
    "cubic, 16-bit",
];

/// The last columns of [`RATIO_HEAD`].
const OTHERS: [TableKind; 4] = [
    TableKind::MultilinearF32,
    TableKind::MultilinearU16,
    TableKind::CubicF32,
    TableKind::CubicU16,
];

/// Compares the sizes of grids with those of bundles.
fn at_equal_error(all: &[ManifoldResults]) -> String {
    let rows = all.iter().flat_map(|results| {
        let points = results.of(TableKind::Patches).into_iter();
        points.map(move |(point, m)| {
            let mut cells = vec![
                escaped(&results.title),
                results.cameras.to_string(),
                point.spec.setting(),
                short(m.errors.screen.p99),
                m.disk.to_string(),
            ];
            let ratios = OTHERS.map(|kind| size_ratio(m, &results.of(kind)));
            let text = |r: Option<String>| r.map_or("–".into(), |r| escaped(&r));
            cells.extend(ratios.map(text));
            cells
        })
    });
    format!(
        "<h2>Size at equal error</h2><p>How many times larger the smallest measured grid is that \
         is at least as accurate (99th percentile of the screen error). <i>&gt;</i>: the largest \
         grid measured is so many times larger and not yet as accurate.</p>\n{}",
        table(&RATIO_HEAD, rows)
    )
}

/// Writes the figures and tables of one manifold.
fn section(results: &ManifoldResults, figures: &[Figure]) -> String {
    let mut html = format!("<h2>{}</h2>\n", escaped(&results.title));
    for figure in figures {
        let picture = match &figure.svg {
            Some(svg) => svg.clone(),
            None => format!(
                "<img alt=\"{}\" src=\"data:image/png;base64,{}\">",
                escaped(&figure.name),
                BASE64_STANDARD.encode(&figure.png)
            ),
        };
        let caption = escaped(&figure.caption);
        let _ = writeln!(
            html,
            "<figure>{picture}<figcaption>{caption}</figcaption></figure>"
        );
    }
    html += &slopes_table(results);
    html + &skipped(results)
}

fn slopes_table(results: &ManifoldResults) -> String {
    let joined = |values: Vec<f64>| -> String {
        let values: Vec<String> = values.iter().map(|x| format!("{x:.1}")).collect();
        values.join(", ")
    };
    let divided = |kind: &TableKind| *kind != TableKind::UndividedPatches;
    let rows = TableKind::ALL.into_iter().filter(divided).map(|kind| {
        let points = results.of(kind);
        vec![
            kind.title().to_string(),
            joined(byte_slopes(&points)),
            joined(spacing_orders(&points)),
        ]
    });
    let head = [
        "slopes from size to size",
        "by bytes",
        "order in the spacing",
    ];
    table(&head, rows)
}

/// Lists the points that were not measured.
fn skipped(results: &ManifoldResults) -> String {
    let points = results.points.iter().filter_map(|p| match &p.outcome {
        PointOutcome::Skipped { why, .. } => Some(format!(
            "<li>{} {}: {}</li>",
            p.spec.kind().title(),
            p.spec.setting(),
            escaped(why)
        )),
        PointOutcome::Measured(_) => None,
    });
    let list: String = points.collect();
    match list.is_empty() {
        true => list,
        false => format!("<ul>{list}</ul>\n"),
    }
}

/// Escapes text for HTML.
fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

/// The cells of a row, with their columns' names.
type CsvRow = Vec<(String, Value)>;

/// Writes all points to the CSV file `path`.
///
/// # Errors
/// The place cannot be written.
pub fn write_csv(path: &Path, all: &[ManifoldResults]) -> Result<()> {
    let mut csv = Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::Environment {
        path: path.display().to_string(),
        source: std::io::Error::other(e),
    };
    let points = all
        .iter()
        .flat_map(|results| results.points.iter().map(move |point| (results, point)));
    for (i, (results, point)) in points.enumerate() {
        let row = csv_row(results, point);
        if i == 0 {
            csv.write_record(row.iter().map(|(column, _)| column))
                .map_err(failed)?;
        }
        csv.write_record(row.iter().map(|(_, value)| csv_cell(value)))
            .map_err(failed)?;
    }
    let bytes = csv
        .into_inner()
        .map_err(|e| failed(e.into_error().into()))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// Writes a cell: text without quotation marks, numbers as in JSON.
fn csv_cell(value: &Value) -> String {
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

fn csv_row(results: &ManifoldResults, point: &SweepPoint) -> CsvRow {
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
    let rival = m.and_then(|m| equal_error(&results.rivals, &m.errors));
    put(row, "exact_steps", rival.map(|r| r.steps));
    put(row, "exact_screen_p99_mrad", rival.map(|r| r.screen.p99));
    put(row, "exact_cpu_ns_per_path", rival.map(|r| r.path_ns));
    let frame = m.and_then(|m| m.rival_frame_ms);
    put(row, "exact_frame_cpu_ms", frame);
}
