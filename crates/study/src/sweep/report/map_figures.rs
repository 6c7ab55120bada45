//! Error maps as pictures.
//!
//! In: the maps that points keep. Out: [`Figure`]s with axes and a colour bar; colours are the
//! logarithm of the error, on a scale of each map's own.

use super::{figures::Figure, short};
use crate::sweep::{
    error_maps::{ErrorMap, MapDomain},
    manifold_sweep::ManifoldResults,
    point::{SweepPoint, TableSpec},
};
use geofan_core::{Error, Result};
use kuva::prelude::{ColorMap, Heatmap, Layout, Plot, TickFormat};
use std::sync::Arc;

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
