//! Comparisons of the points of one manifold, and their figures: error against bytes, against bake time, against lookup
//! time; and error maps as pictures.
//!
//! In: [`ManifoldResults`]. Out: slopes, the Pareto front, sizes at equal error, and when baking pays; and [`Figure`]s,
//! as SVG and PNG. Only measured points are compared; nothing is extrapolated. Axes are logarithmic; colours are those
//! of Okabe and Ito, told apart by people with any colour vision; markers differ too. The rival stands in every figure:
//! as horizontal lines at the errors of some numbers of steps, each with its time for a path, and as a curve where time
//! for a path is the axis.
//!
//! In: the maps that points keep. Out: [`Figure`]s with axes and a colour bar; colours are the
//! logarithm of the error, on a scale of each map's own.

use super::short;
use crate::sweep::{
    exact_rays::{ErrorMap, MapDomain},
    grid::mean,
    manifold_sweep::{ManifoldResults, Rival},
    measurement::{SweepPoint, TableKind, TableMeasurement, TableSpec},
};
use geofan_core::{Error, Result};
use kuva::prelude::{
    ColorMap, Heatmap, Layout, LegendPosition, LinePlot, MarkerShape, Plot, PngBackend,
    ReferenceLine, ScatterPlot, SvgBackend, TickFormat, render_multiple,
};
use std::sync::Arc;

/// A measured point: the point, and its measurement.
pub type Pair<'a> = (&'a SweepPoint, &'a TableMeasurement);

impl ManifoldResults {
    /// Returns the measured points of a kind, smallest first.
    pub fn of(&self, kind: TableKind) -> Vec<Pair<'_>> {
        let all = self.points.iter().filter(|p| p.spec.kind() == kind);
        let mut found: Vec<Pair<'_>> = all.filter_map(|p| Some((p, p.measured()?))).collect();
        found.sort_by_key(|(_, m)| m.disk);
        found
    }

    /// Returns the points that no other point beats in bytes and error both, smallest first. Undivided
    /// patches stay out: most of their rays are not in the table.
    pub fn front(&self) -> Vec<Pair<'_>> {
        let kinds = TableKind::ALL
            .into_iter()
            .filter(|k| *k != TableKind::UndividedPatches);
        let mut all: Vec<Pair<'_>> = kinds.flat_map(|kind| self.of(kind)).collect();
        all.sort_by_key(|(_, m)| m.disk);
        let mut least = f64::INFINITY;
        all.retain(|(_, m)| {
            let better = m.errors.screen.p99 < least;
            least = least.min(m.errors.screen.p99);
            better
        });
        all
    }
}

/// Returns the slopes between neighbours of `points`: the logarithm of the error by that of the bytes,
/// negative. Neighbours of equal size have none.
pub fn byte_slopes(points: &[Pair<'_>]) -> Vec<f64> {
    let bytes = |(_, m): &Pair<'_>| m.disk as f64;
    let slope = |pair: &[Pair<'_>]| log_ratio(pair, error) / log_ratio(pair, bytes);
    let pairs = points.windows(2);
    pairs.map(slope).filter(|slope| slope.is_finite()).collect()
}

/// Returns the orders between neighbours of `points`, grids only: the logarithm of the error by that of
/// the mean spacing.
pub fn spacing_orders(points: &[Pair<'_>]) -> Vec<f64> {
    let cells = |(point, _): &Pair<'_>| match &point.spec {
        TableSpec::Grid { cells, .. } => mean(cells),
        TableSpec::Patches { .. } => 1.0,
    };
    let order = |pair: &[Pair<'_>]| {
        let finer = log_ratio(pair, cells);
        (finer > 0.0).then(|| -log_ratio(pair, error) / finer)
    };
    points.windows(2).filter_map(order).collect()
}

/// Keeps the points that logarithmic axes can show.
fn on_log_axes(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.retain(|(x, y)| *x > 0.0 && *y > 0.0 && x.is_finite() && y.is_finite());
    points
}

/// Returns a point's error: the 99th percentile of the screen error.
fn error((_, m): &Pair<'_>) -> f64 {
    m.errors.screen.p99
}

fn log_ratio(pair: &[Pair<'_>], of: impl Fn(&Pair<'_>) -> f64) -> f64 {
    (of(&pair[1]) / of(&pair[0])).ln()
}

/// Writes how many times larger than `table` the smallest of `others` is that is as accurate; or, after
/// `>`, the largest that is not; `None` if there are no others.
pub fn size_ratio(table: &TableMeasurement, others: &[Pair<'_>]) -> Option<String> {
    let goal = table.errors.screen.p99;
    let good = others.iter().find(|other| error(other) <= goal);
    let (sign, (_, other)) = match good {
        Some(other) => ("", other),
        None => ("> ", others.last()?),
    };
    let times = other.disk as f64 / table.disk as f64;
    Some(match times < 10.0 {
        true => format!("{sign}{times:.1}"),
        false => format!("{sign}{times:.0}"),
    })
}

/// Returns the number of paths after which bake and lookups of `table` took less processor time than the
/// rival; `None` if they never do.
pub fn paths_to_pay(table: &TableMeasurement, rival: &Rival) -> Option<f64> {
    uses_to_pay(table, 1e-9 * (rival.path_ns - table.path_ns))
}

/// Returns the number of frames of the default view after which bake and frames took less than the
/// rival's frames; `None` if they never do.
pub fn frames_to_pay(table: &TableMeasurement) -> Option<f64> {
    let (own, rival) = table.frame_ms.zip(table.rival_frame_ms)?;
    uses_to_pay(table, 1e-3 * (rival - own))
}

/// Returns the number of uses, each of which saves so many seconds, that pay for a bake.
fn uses_to_pay(table: &TableMeasurement, saved_s: f64) -> Option<f64> {
    (saved_s > 0.0).then(|| (table.bake.cpu_s / saved_s).ceil())
}

/// A picture of the report.
#[derive(Debug, Clone)]
pub struct Figure {
    /// The name of its files, without ending.
    pub name: String,
    /// The text under it.
    pub caption: String,
    /// As SVG; none for pictures of many cells.
    pub svg: Option<String>,
    /// As PNG.
    pub png: Vec<u8>,
}

/// Pixels of a PNG for each unit of the SVG.
const SCALE: f32 = 1.5;

const BLACK: &str = "#000000";

fn colour(kind: TableKind) -> &'static str {
    match kind {
        TableKind::Patches => "#D55E00",
        TableKind::UndividedPatches => "#CC79A7",
        TableKind::MultilinearF32 => "#56B4E9",
        TableKind::MultilinearU16 => "#0072B2",
        TableKind::CubicF32 => "#E69F00",
        TableKind::CubicU16 => "#009E73",
    }
}

fn marker(kind: TableKind) -> MarkerShape {
    match kind {
        TableKind::Patches => MarkerShape::Circle,
        TableKind::UndividedPatches => MarkerShape::Cross,
        TableKind::MultilinearF32 => MarkerShape::Diamond,
        TableKind::MultilinearU16 => MarkerShape::Square,
        TableKind::CubicF32 => MarkerShape::TriangleDown,
        TableKind::CubicU16 => MarkerShape::Triangle,
    }
}

impl Figure {
    /// Draws a kuva plot as SVG and PNG.
    ///
    /// # Errors
    /// It cannot be drawn.
    pub fn draw(name: String, caption: String, plots: Vec<Plot>, layout: Layout) -> Result<Self> {
        let scene = render_multiple(plots, layout);
        let png = PngBackend::new().with_scale(SCALE).render_scene(&scene);
        Ok(Self {
            svg: Some(SvgBackend.render_scene(&scene)),
            png: png.map_err(|e| Error::input(&name, e))?,
            name,
            caption,
        })
    }
}

/// Draws the figures of `results`.
///
/// # Errors
/// One cannot be drawn.
pub fn figures(results: &ManifoldResults) -> Result<Vec<Figure>> {
    Ok(vec![
        error_by_bytes(results)?,
        error_by_bake(results)?,
        error_by_path(results)?,
    ])
}

/// Collects the plots of a figure, and the points that its axes must hold.
struct Chart {
    plots: Vec<Plot>,
    /// Everything drawn, for the ranges of the axes.
    points: Vec<(f64, f64)>,
}

impl Chart {
    fn new() -> Self {
        Self {
            plots: Vec::new(),
            points: Vec::new(),
        }
    }

    /// Adds points joined by a line.
    fn series(&mut self, data: Vec<(f64, f64)>, colour: &str, shape: MarkerShape, label: String) {
        let data = on_log_axes(data);
        if data.is_empty() {
            return;
        }
        self.points.extend(&data);
        let line = LinePlot::new().with_data(data.clone()).with_color(colour);
        self.plots.push(line.with_stroke_width(1.2).into());
        let marks = ScatterPlot::new().with_data(data).with_color(colour);
        let marks = marks.with_size(4.0).with_marker(shape).with_legend(label);
        self.plots.push(marks.into());
    }

    /// Adds rings around points.
    fn rings(&mut self, data: Vec<(f64, f64)>) {
        let rings = ScatterPlot::new().with_data(on_log_axes(data));
        let rings = rings.with_color(BLACK);
        let rings = rings.with_size(8.0).with_marker_opacity(0.0);
        self.plots.push(rings.with_marker_stroke_width(1.2).into());
    }

    /// Returns the range of a coordinate of all points.
    fn range(&self, of: fn(&(f64, f64)) -> f64) -> [f64; 2] {
        let values = self.points.iter().map(of);
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(a, b), x| (a.min(x), b.max(x)));
        match low <= high {
            true => [low, high],
            false => [1.0, 1.0],
        }
    }

    /// Makes axes over all points, with `room` decades on the right for labels.
    fn layout(&self, title: [&str; 2], x: &str, room: f64) -> Layout {
        let [left, right] = self.range(|p| p.0).map(f64::log10);
        let [low, high] = self.range(|p| p.1).map(f64::log10);
        let tidy = |x: f64| 10.0_f64.powf(x);
        let exponent = |v: f64| power_of_ten(v);
        Layout::auto_from_plots(&self.plots)
            .with_width(620.0)
            .with_height(430.0)
            .with_log_scale()
            .with_title(title[0])
            .with_subtitle(title[1])
            .with_x_label(x)
            .with_y_label("screen error, 99th percentile (mrad)")
            .with_x_axis_min(tidy(left - 0.15))
            .with_x_axis_max(tidy(right + room))
            .with_y_axis_min(tidy(low - 0.2))
            .with_y_axis_max(tidy(high + 0.2))
            .with_tick_format(TickFormat::Custom(Arc::new(exponent)))
            .with_title_size(15)
            .with_subtitle_size(11)
            .with_label_size(13)
            .with_tick_size(11)
            .with_body_size(11)
            .with_legend_position(LegendPosition::OutsideRightTop)
    }
}

/// Writes a tick's number: plain near one, else a power of ten.
fn power_of_ten(value: f64) -> String {
    let exponent = value.abs().max(f64::MIN_POSITIVE).log10();
    match (-3.0..4.0).contains(&exponent) {
        true => format!("{value}"),
        false => format!("{value:e}"),
    }
}

/// Writes the slope between the two largest tables, for legends: order in the spacing for grids, power
/// of the bytes for patches.
fn law(points: &[Pair<'_>]) -> String {
    let last = &points[points.len().saturating_sub(2)..];
    match (spacing_orders(last).first(), byte_slopes(last).first()) {
        (Some(order), _) => format!(" (h^{order:.1})"),
        (None, Some(slope)) => format!(" (bytes^{slope:.1})"),
        (None, None) => String::new(),
    }
}

/// Writes the share of rays that a table leaves to the integrator.
fn flagged(points: &[Pair<'_>]) -> String {
    points.last().map_or(String::new(), |(_, m)| {
        format!(" ({:.0} % flagged)", 100.0 * m.errors.flagged)
    })
}

/// Writes the legend's remark about a kind.
fn remark(kind: TableKind, points: &[Pair<'_>]) -> String {
    match kind {
        TableKind::UndividedPatches => flagged(points),
        _ => law(points),
    }
}

/// Writes the legend's remark about a kind in figures of times, which know no slope.
fn share(kind: TableKind, points: &[Pair<'_>]) -> String {
    match kind {
        TableKind::UndividedPatches => flagged(points),
        _ => String::new(),
    }
}

/// Adds the points of all kinds at `x`, named by their kind and a remark.
fn all_kinds(
    chart: &mut Chart,
    results: &ManifoldResults,
    x: impl Fn(&TableMeasurement) -> f64,
    remark: impl Fn(TableKind, &[Pair<'_>]) -> String,
) {
    for kind in TableKind::ALL {
        let points = results.of(kind);
        let data = points.iter().map(|(_, m)| (x(m), m.errors.screen.p99));
        let label = format!("{}{}", kind.title(), remark(kind, &points));
        chart.series(data.collect(), colour(kind), marker(kind), label);
    }
}

/// Lines of rivals closer than this many decades would run into each other.
const APART: f64 = 0.55;

/// Chooses rivals spread over a range of errors.
fn some_rivals(rivals: &[Rival], [low, high]: [f64; 2]) -> Vec<Rival> {
    let mut chosen: Vec<Rival> = Vec::new();
    for rival in rivals {
        let p99 = rival.screen.p99;
        let apart = chosen
            .last()
            .is_none_or(|last| (last.screen.p99 / p99).log10() > APART);
        if p99 >= low && p99 <= high && apart {
            chosen.push(*rival);
        }
    }
    chosen
}

/// Explains the dashed lines.
const DASHED: &str = "dashed: exact by equal steps, time for a path";

/// Returns the decades on the right for the names of the dashed lines: a third of the width.
fn room(chart: &Chart) -> f64 {
    let [left, right] = chart.range(|p| p.0).map(f64::log10);
    0.15 + 0.5 * (right - left)
}

/// Adds a dashed line for some rivals.
fn with_rivals(mut layout: Layout, chart: &Chart, results: &ManifoldResults) -> Layout {
    for rival in some_rivals(&results.rivals, chart.range(|p| p.1)) {
        let micros = 1e-3 * rival.path_ns;
        let label = format!("{} steps, {micros:.2} µs", rival.steps);
        let line = ReferenceLine::horizontal(rival.screen.p99);
        layout = layout.with_reference_line(line.with_color("#888888").with_label(label));
    }
    layout
}

fn error_by_bytes(results: &ManifoldResults) -> Result<Figure> {
    let mut chart = Chart::new();
    all_kinds(&mut chart, results, |m| m.disk as f64, remark);
    let front = results.front();
    let front = front
        .iter()
        .map(|(_, m)| (m.disk as f64, m.errors.screen.p99));
    chart.rings(front.collect());
    let title = format!("{}: error against size", results.title);
    let room = room(&chart);
    let rings = format!("rings: Pareto front; {DASHED}");
    let layout = chart.layout([&title, &rings], "file (bytes)", room);
    let layout = with_rivals(layout, &chart, results);
    let caption = "Every point is a measured table. In brackets the slope between the two largest \
        tables of a kind: the order in the mean spacing h for grids, the power of the bytes for \
        patches. Rings mark the Pareto front. Undivided patches leave the flagged share of rays to the integrator. \
        Dashed: the integrator at so many steps, with its time for a path.";
    let name = format!("{}-error-bytes", results.conditions.manifold);
    Figure::draw(name, caption.into(), chart.plots, layout)
}

fn error_by_bake(results: &ManifoldResults) -> Result<Figure> {
    let mut chart = Chart::new();
    all_kinds(&mut chart, results, |m| m.bake.cpu_s, share);
    let title = format!("{}: error against bake time", results.title);
    let layout = chart.layout([&title, DASHED], "bake (s of processor time)", room(&chart));
    let layout = with_rivals(layout, &chart, results);
    let caption = "Processor time of the bake, all threads together, sampling included. \
        Dashed: the integrator, which needs no bake.";
    let name = format!("{}-error-bake", results.conditions.manifold);
    Figure::draw(name, caption.into(), chart.plots, layout)
}

fn error_by_path(results: &ManifoldResults) -> Result<Figure> {
    let mut chart = Chart::new();
    all_kinds(&mut chart, results, |m| m.path_ns, share);
    let [best, worst] = chart.range(|p| p.1);
    let within = 0.3 * best..=3.0 * worst;
    let rivals = results.rivals.iter();
    let rivals = rivals.filter(|r| within.contains(&r.screen.p99));
    let exact: Vec<(f64, f64)> = rivals.map(|r| (r.path_ns, r.screen.p99)).collect();
    chart.series(exact, BLACK, MarkerShape::Plus, "exact, equal steps".into());
    let title = format!("{}: error against lookup time", results.title);
    let subtitle = "exact: equal steps in single precision";
    let layout = chart.layout([&title, subtitle], "time for a path (ns of one core)", 0.15);
    let caption = "Processor time for one path in a random direction, the camera fixed before: \
        16 chart points from a table, all steps of the integrator.";
    let name = format!("{}-error-lookup", results.conditions.manifold);
    Figure::draw(name, caption.into(), chart.plots, layout)
}

/// Decades shown below the largest error: smaller errors get the darkest colour.
const DECADES: f64 = 3.0;

/// Draws the maps of `results`: those of its patches, and of its largest mapped grid.
///
/// # Errors
/// One cannot be drawn.
pub fn pictures(results: &ManifoldResults) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for over in [MapDomain::Direction, MapDomain::Camera] {
        for (point, map) in chosen(results, over) {
            figures.push(picture(results, point, map)?);
        }
    }
    Ok(figures)
}

/// Chooses the maps over one thing: of every bundle that has them, and of the largest grid.
fn chosen(results: &ManifoldResults, over: MapDomain) -> Vec<(&SweepPoint, &ErrorMap)> {
    let with = |point: &'_ SweepPoint| point.maps.iter().any(|map| map.over == over);
    let is_grid = |point: &SweepPoint| matches!(point.spec, TableSpec::Grid { .. });
    let grid = results.points.iter().rev().find(|p| is_grid(p) && with(p));
    let bundles = results.points.iter().filter(|p| !is_grid(p));
    let points = bundles.chain(grid);
    points
        .flat_map(|point| point.maps.iter().map(move |map| (point, map)))
        .filter(|(_, map)| map.over == over)
        .collect()
}

fn largest(map: &ErrorMap) -> f64 {
    let cells = map.rows.iter().flatten().flatten();
    cells.copied().fold(0.0, f64::max)
}

fn picture(results: &ManifoldResults, point: &SweepPoint, map: &ErrorMap) -> Result<Figure> {
    let kind = point.spec.kind();
    let plots: Vec<Plot> = vec![heatmap(map).into()];
    let title = format!("{}: {} {}", results.title, kind.title(), unit(point));
    let layout = layout(&plots, &title, map);
    let (over, caption) = match map.over {
        MapDomain::Direction => (
            "direction",
            "Screen error at the end of each path, over the direction from the middle of the camera region.",
        ),
        MapDomain::Camera => (
            "camera",
            "Screen error at the end of paths, over the camera's position.",
        ),
    };
    let name = format!("{}-map-{over}-{}", results.conditions.manifold, kind.name());
    let png = kuva::render_to_png(plots, layout, 1.0).map_err(|e| Error::input(&name, e))?;
    Ok(Figure {
        name,
        caption: caption.into(),
        svg: None,
        png,
    })
}

/// Colours the cells by the logarithm of their error.
fn heatmap(map: &ErrorMap) -> Heatmap {
    let top = largest(map).max(1e-9).log10();
    let bottom = top - DECADES;
    let cell = |c: &Option<f64>| c.map_or(f64::NAN, |e| e.max(1e-12).log10().clamp(bottom, top));
    // Where an axis has a range, kuva's first row is the lowest, as here.
    let rows = map.rows.iter();
    let data: Vec<Vec<f64>> = rows.map(|row| row.iter().map(cell).collect()).collect();
    let [x, y] = map.ranges;
    Heatmap::new()
        .with_data(data)
        .with_color_map(ColorMap::Viridis)
        .with_x_range(x[0], x[1])
        .with_y_range(y[0], y[1])
        .with_cell_size(1.0)
}

fn layout(plots: &[Plot], title: &str, map: &ErrorMap) -> Layout {
    let [x, y] = map.ranges;
    let mrad = |v: f64| short(10.0_f64.powf(v));
    Layout::auto_from_plots(plots)
        .with_width(560.0)
        .with_height(360.0)
        .with_title(title)
        .with_subtitle("screen error (mrad)")
        .with_subtitle_size(11)
        .with_x_axis_min(x[0])
        .with_x_axis_max(x[1])
        .with_y_axis_min(y[0])
        .with_y_axis_max(y[1])
        .with_x_label(&map.labels[0])
        .with_y_label(&map.labels[1])
        .with_show_grid(false)
        .with_title_size(14)
        .with_label_size(12)
        .with_tick_size(11)
        .with_body_size(11)
        .with_colorbar_tick_format(TickFormat::Custom(Arc::new(mrad)))
}

/// Writes the table's setting.
fn unit(point: &SweepPoint) -> String {
    let setting = point.spec.setting();
    match point.spec {
        TableSpec::Patches { .. } => format!("at {setting} mrad"),
        TableSpec::Grid { .. } => format!("of {setting} cells"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first rectangle of `colour` in an SVG: its upper edge.
    fn upper_edge(svg: &str, colour: &str) -> f64 {
        let rect = svg.split("<rect").find(|rect| rect.contains(colour));
        let rect = rect.unwrap_or_else(|| panic!("no {colour} in {svg}"));
        let y = rect.split(" y=\"").nth(1).unwrap();
        y.split('"').next().unwrap().parse().unwrap()
    }

    #[test]
    fn the_first_row_of_a_map_is_the_lowest_of_its_picture() {
        let map = ErrorMap {
            over: MapDomain::Camera,
            labels: ["across".into(), "up".into()],
            ranges: [[0.0, 1.0], [2.0, 3.0]],
            rows: vec![vec![Some(1.0)], vec![Some(1e-3)]],
        };
        let plots: Vec<Plot> = vec![heatmap(&map).into()];
        let layout = layout(&plots, "title", &map);
        let svg = kuva::render_to_svg(plots, layout);
        let viridis = |t: f64| ColorMap::Viridis.map(t);
        assert!(upper_edge(&svg, &viridis(1.0)) > upper_edge(&svg, &viridis(0.0)));
    }
}
