//! One view by table and by exact integration: pictures, errors and times from the same run.
//!
//! In: a stage, a camera, a bundle's table. Out: a [`Comparison`]. The rivals are the adaptive
//! integrator in double precision, and *equal-error exact* (`rival`): equal steps in single
//! precision, the fewest whose 99th percentile of screen error is no worse than the table's on the
//! same rays. Steps after the paths are the same code for all. The table's frame is drawn from a
//! camera that moves and turns a little each time, and its times are medians (`times`).

mod errors;
mod report;
mod rival;
mod times;

pub use report::{LatticeReport, PathTimes, Report, Rival, Times};

use super::{
    drawing::draw,
    frame::Paths,
    lookup::Lookup,
    picture::{Picture, error_picture, flip, flip::DEFAULT_PIXELS_PER_DEGREE, psnr, write_png},
    shade::Footprints,
    tracer::ExactTracer,
    view::View,
    world::World,
};
use crate::{
    bundle::Table,
    error::{Error, Result},
    quantiles::Quantiles,
};
use ndarray::Array2;
use std::path::Path;

/// What to compare, and how.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Samples for each pixel.
    pub samples: usize,
    /// The table's promise, mrad.
    pub promise: f64,
    /// Largest error of the lattice, mrad.
    pub error: f64,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// From how many cameras the table's frame is drawn: its times are medians.
    pub frames: usize,
}

/// A comparison with its pictures.
pub struct Comparison {
    /// The numbers.
    pub report: Report,
    /// The table's picture.
    pub table: Picture,
    /// The exact picture.
    pub exact: Picture,
    /// FLIP of every pixel.
    pub flip: Array2<f32>,
    /// Screen error of the table's path at every pixel, mrad; NaN where the table gave up.
    pub screen: Array2<f32>,
}

/// Compares.
///
/// # Errors
/// The camera is not in the table's region.
pub fn compare(world: &World, view: &View, table: &Table, options: Options) -> Result<Comparison> {
    if !view.is_central() {
        let message = "each pixel of an orthographic picture, and of an eye that sees all around, has a position of its own, and a table is made ready for one";
        return Err(Error::input("the camera", message));
    }
    let lookup = Lookup::new(table, 1e-3 * options.promise, options.tolerance);
    let budget = 1e-3 * options.error;
    let frames = times::moving(world, view, &lookup, options)?;
    let fan = table.fan(view.u)?;
    let tracer = lookup.tracer(&fan);
    let by = |paths: Paths<'_>| draw(world, view, paths, options.samples, Footprints::Filtered);
    let drawn = by(Paths::Lattice(&tracer, budget));
    let exact_tracer = ExactTracer::new(&world.manifold, view.u, table.length, options.tolerance);
    let exact = by(Paths::Exact(&exact_tracer));
    let probed = errors::probe_pixels(world, view, table, options);
    let errors = errors::table_errors(&fan, view, &probed);
    let goal = rival::Goal::new(view, table.length, &probed, &errors);
    let (rival, rival_drawn) = goal.meet(world, view, options);
    let screen = errors.iter().map(|e| e.map_or(f32::NAN, |e| e.1 as f32));
    let (width, height) = view.size;
    let screen = Array2::from_shape_vec((height, width), screen.collect());
    let flip = flip(&exact.picture, &drawn.picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let psnr = psnr(&exact.picture, &drawn.picture)?;
    let rival_tracer = goal.tracer(&world.manifold, view.u, rival.steps);
    let exact_times = report::times(&exact);
    let quantiles = |pick: fn(&(f64, f64)) -> f64| {
        let mut all: Vec<f64> = errors.iter().flatten().map(pick).collect();
        Quantiles::of(&mut all)
    };
    let report = Report {
        psnr: psnr.is_finite().then_some(psnr),
        flip: flip.mean,
        mrad: quantiles(|e| e.0),
        screen_mrad: quantiles(|e| e.1),
        lattice_mrad: errors::lattice_errors(world, view, &tracer, budget),
        sky_mrad: errors::sky_errors(&drawn.outcomes, &exact.outcomes),
        flagged: drawn.flagged_share(),
        paths_ns: times::paths(
            world,
            view,
            (&lookup, &fan),
            &exact_tracer,
            &rival_tracer,
            budget,
        ),
        speedup: exact_times.frame / frames.frame,
        speedup_equal_error: rival_drawn.frame / frames.frame,
        speedup_equal_error_lattice: rival.lattice_times.frame / frames.frame,
        table: frames,
        exact: exact_times,
        equal_error: rival,
        lattice: drawn.work.into(),
    };
    Ok(Comparison {
        report,
        table: drawn.picture,
        exact: exact.picture,
        flip: flip.map,
        screen: screen.expect("one error for each pixel"),
    })
}

/// Writes `table.png`, `exact.png`, `error.png` (FLIP) and `mrad.png` (screen error of the paths)
/// into `folder`, their names beginning with `prefix`.
///
/// # Errors
/// The folder cannot be written.
pub fn write_pictures(comparison: &Comparison, folder: &Path, prefix: &str) -> Result<()> {
    let error = error_picture(&comparison.flip, "FLIP", "table against exact", None);
    let screen = error_picture(
        &comparison.screen,
        "mrad",
        "screen error of the table",
        None,
    );
    let pictures = [
        ("table", &comparison.table),
        ("exact", &comparison.exact),
        ("error", &error),
        ("mrad", &screen),
    ];
    for (name, picture) in pictures {
        write_png(&folder.join(format!("{prefix}{name}.png")), picture)?;
    }
    Ok(())
}
