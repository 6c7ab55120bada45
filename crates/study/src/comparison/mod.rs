//! One view by a table or by first order, against exact integration: pictures, errors and times from
//! one run.
//!
//! In: a world, a view, a bundle's table. Out: a [`Comparison`] of its frame with those of two rivals: the adaptive
//! integrator in double precision, and *equal-error exact*. Errors, of the table's paths and of
//! the skies, are angles at the camera, mrad. Steps after the paths are the same code for all. The table's frame is
//! drawn from a camera that moves and turns a little each time, and its times are medians (`comparison_report`).
//!
//! In: a world and a view. Out: the local view and the exact one, their PSNR and FLIP, and by distance the angle between
//! where the local view puts a point and where it is seen ([`compare_local`]).
//!
//! In: exact rays, as they are compared with a table. Out: numbers of equal steps, each with the screen
//! error of the classical Runge–Kutta method in single precision over vectors of rays (`rivals`). Equal-error exact
//! takes the fewest steps whose 99th percentile is no worse than the table's on the same rays. Between steps its
//! path is the cubic through points and tangents, as the renderer draws it. It carries no rotation,
//! which a table has: that favours the rival.

mod comparison_report;
mod lattice_errors;

pub use comparison_report::{ComparisonReport, EqualErrorExact, FrameTimes, PathTimes};
pub use lattice_errors::{LatticeErrors, compare_lattice};

use crate::picture::{DEFAULT_PIXELS_PER_DEGREE, error_picture, flip, mean_flip, psnr};
use geofan_bundle::{
    Fan, PathCoefficients, Table,
    measure::{Probe, Probed, probe, settings},
};
use geofan_core::{
    error::{Error, Result},
    geodesic::{UnfinishedPaths, fixed_steps},
    manifold::Manifold,
    quantiles::Quantiles,
};
use geofan_render::{
    Cubic,
    drawing::{Drawing, draw},
    frame::{Outcomes, Paths, offsets},
    intersect::Seen,
    local::projection,
    lookup::Lookup,
    picture::{Picture, write_png},
    shade::Footprints,
    tracer::{ExactTracer, FixedTracer},
    unfinished,
    view::View,
    world::World,
};
use glam::DVec3;
use lattice_errors::{lattice_errors, lattice_picture};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;
use std::{collections::BTreeMap, fmt, path::Path};

/// Says how to compare.
#[derive(Debug, Clone, Copy)]
pub struct CompareOptions {
    /// Samples for each pixel.
    pub samples: usize,
    /// The table's promise, mrad.
    pub promise: f64,
    /// Largest error of the lattice, mrad.
    pub error: f64,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// Number of cameras from which the table's frame is drawn: its times are medians.
    pub frames: usize,
}

/// A comparison's numbers and pictures.
pub struct Comparison<R> {
    /// The numbers.
    pub report: R,
    /// FLIP of every pixel.
    pub flip: Array2<f32>,
    /// The pictures, by the names of their files.
    pub pictures: Vec<(&'static str, Picture)>,
}

/// Writes the pictures of a comparison into `folder` as PNG, their names beginning with `prefix`.
///
/// # Errors
/// The folder cannot be written.
pub fn write_pictures<R>(comparison: &Comparison<R>, folder: &Path, prefix: &str) -> Result<()> {
    for (name, picture) in &comparison.pictures {
        write_png(&folder.join(format!("{prefix}{name}.png")), picture)?;
    }
    Ok(())
}

/// Compares the picture of a table with the exact one. The comparison has the pictures `table`,
/// `exact`, `error` (FLIP), `mrad` (screen error of the paths) and `lattice` (what the lattice adds to it).
///
/// # Errors
/// The camera is not in the table's region, or rays of the view start elsewhere.
pub fn compare(
    world: &World,
    view: &View,
    table: &Table,
    options: CompareOptions,
) -> Result<Comparison<ComparisonReport>> {
    refuse_many_positions(view)?;
    // Both pictures.
    let lookup = Lookup::new(table, 1e-3 * options.promise, options.tolerance);
    let budget = 1e-3 * options.error;
    let views = comparison_report::views(world, view, table, options.frames);
    let table_times = comparison_report::moving(world, &views, &lookup, options)?;
    let fan = table.fan(view.u)?;
    fan.prepare(&view.spread());
    let tracer = lookup.tracer(&fan);
    let drawn = drawn_by(world, view, Paths::Lattice(&tracer, budget), options);
    let exact_tracer = ExactTracer::new(&world.manifold, view.u, table.length, options.tolerance);
    let exact = drawn_by(world, view, Paths::Exact(&exact_tracer), options);
    // The table's errors, and the rival that has no larger ones.
    let probed = probe_pixels(world, view, table, options);
    let errors = table_errors(&fan, view, &probed);
    let [mrad, screen_mrad] = error_quantiles(&errors);
    let equal_error = rival_goal(view, &probed, &errors)
        .map(|goal| equal_error_exact(world, &views, goal, table.length, options));
    let equal = equal_error.filter(|rival| rival.equal);
    let rival_tracer = equal_error
        .map(|rival| FixedTracer::new(&world.manifold, view.u, table.length, rival.steps));
    // The differences.
    let (lattice_errors, lattice_map) = lattice_errors(world, view, &tracer, budget);
    let flip = flip(&exact.picture, &drawn.picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let exact_times = comparison_report::times_of(&exact);
    let tracers = (&lookup, &fan, &exact_tracer, rival_tracer.as_ref());
    let seen = [(view.clone(), exact.outcomes.clone())];
    let report = ComparisonReport {
        psnr: Some(psnr(&exact.picture, &drawn.picture)?).filter(|x| x.is_finite()),
        flip: mean_flip(&flip),
        mrad,
        screen_mrad,
        lattice_errors,
        sky_mrad: sky_errors(world, &drawn.outcomes, &exact.outcomes),
        compared: errors.iter().flatten().count() as f64 / errors.len() as f64,
        flagged: drawn.flagged_share(),
        unfinished: unfinished(world, &seen, (table.length, options.tolerance)),
        paths_ns: comparison_report::paths(world, view, tracers, budget),
        speedup: exact_times.frame / table_times.frame,
        speedup_equal_error: equal.map(|rival| rival.times.frame / table_times.frame),
        speedup_equal_error_lattice: equal
            .map(|rival| rival.lattice_times.frame / table_times.frame),
        table: table_times,
        exact: exact_times,
        equal_error,
        lattice: drawn.work,
    };
    let screen = screen_map(view, &errors);
    let error = error_picture(&flip, "FLIP", "table against exact");
    let mrad = error_picture(&screen, "mrad", "screen error of the table");
    Ok(Comparison {
        report,
        flip,
        pictures: vec![
            ("table", drawn.picture),
            ("exact", exact.picture),
            ("error", error),
            ("mrad", mrad),
            ("lattice", lattice_picture(&lattice_map)),
        ],
    })
}

/// Refuses a view whose rays start at several places.
fn refuse_many_positions(view: &View) -> Result<()> {
    if view.is_central() {
        return Ok(());
    }
    let message = "each pixel of an orthographic picture, and of an eye that sees all around, has a position of its own, and a table is made ready for one";
    Err(Error::input("the camera", message))
}

/// Draws the view along `paths`.
fn drawn_by(world: &World, view: &View, paths: Paths<'_>, options: CompareOptions) -> Drawing {
    let filter = Footprints::Filtered;
    draw(world, view, paths, options.samples, filter, &crate::clock)
}

/// Pixels on which the rival's steps are chosen: every so many along both sides.
const STRIDE: usize = 8;

/// Returns exact rays through some pixels where the table has an error, and the 99th percentile of
/// screen error there, mrad: the rival must reach it. `None` if the table gives up everywhere. At pixels of which it gives
/// up a part nothing is asked of the rival.
fn rival_goal(
    view: &View,
    probed: &[Probed],
    errors: &[Option<(f64, f64)>],
) -> Option<(ProbedFan, f64)> {
    let (width, height) = view.size;
    let pixels = (0..height)
        .step_by(STRIDE)
        .flat_map(|y| (0..width).step_by(STRIDE).map(move |x| (x, y)));
    let (mut probes, mut screen) = (Vec::new(), Vec::new());
    for (x, y) in pixels {
        let i = y * width + x;
        if let (Some(error), Some(probe)) = (errors[i], probed[i].probes.first()) {
            probes.push((pixel_middle(view, x, y), *probe));
            screen.push(error.1);
        }
    }
    let goal = quantiles(&mut screen)?.p99;
    Some(((view.u, probes), goal))
}

/// Returns the quantiles of values; `None` of none.
fn quantiles(values: &mut [f64]) -> Option<Quantiles> {
    (!values.is_empty()).then(|| Quantiles::of(values))
}

/// Number of the rival's frames: of views spread evenly over those of the table's, because frames ahead may show more.
const RIVAL_FRAMES: usize = 5;

/// Finds the fewest steps whose error on `rays` is at most `goal` (the most tried if none reach it), and
/// measures the frames that they give: every sample by itself, and with the lattice.
fn equal_error_exact(
    world: &World,
    views: &[View],
    (rays, goal): (ProbedFan, f64),
    length: f64,
    options: CompareOptions,
) -> EqualErrorExact {
    let (mut steps, mut screen_mrad) = (0, Quantiles::default());
    for tried in rivals(&world.cover, &[rays], length) {
        (steps, screen_mrad) = tried;
        if screen_mrad.p99 <= goal {
            break;
        }
    }
    let last = (RIVAL_FRAMES - 1).min(views.len() - 1);
    let drawn = (0..=last).map(|i| &views[i * (views.len() - 1) / last.max(1)]);
    let [times, lattice_times] = [false, true].map(|lattice| {
        let times = drawn.clone().map(|view| {
            let tracer = FixedTracer::new(&world.manifold, view.u, length, steps);
            let paths = match lattice {
                true => Paths::Lattice(&tracer, 1e-3 * options.error),
                false => Paths::Direct(&tracer),
            };
            comparison_report::times_of(&drawn_by(world, view, paths, options))
        });
        comparison_report::median_times(times)
    });
    EqualErrorExact {
        steps,
        equal: screen_mrad.p99 <= goal,
        screen_mrad,
        times,
        lattice_times,
    }
}

/// Measures the angles between sky directions of samples that leave through the same exit, mrad; of exits behind which
/// all directions show the same, as horizons do, there is nothing to measure.
fn sky_errors(world: &World, a: &Outcomes, b: &Outcomes) -> Option<Quantiles> {
    let angle = |(a, b): (&Seen, &Seen)| match (*a, *b) {
        (
            Seen::Sky {
                exit, direction, ..
            },
            Seen::Sky {
                exit: other,
                direction: d,
                ..
            },
        ) if exit == other && !world.has_one_colour(exit as usize) => {
            Some(1e3 * f64::from((direction - d).length()))
        }
        _ => None,
    };
    let mut angles: Vec<f64> = a.iter().zip(b).filter_map(angle).collect();
    quantiles(&mut angles)
}

/// Computes the exact state where the ray through the middle of every pixel ends (surfaces left out: paths
/// go on behind them), row by row.
fn probe_pixels(world: &World, view: &View, table: &Table, options: CompareOptions) -> Vec<Probed> {
    let (width, height) = view.size;
    // A table holds the paths of the space that covers a glued one.
    let cover = &world.cover;
    let rows: Vec<Vec<Probed>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let rays: Vec<(DVec3, DVec3)> = (0..width)
                .map(|x| (view.u, pixel_middle(view, x, y)))
                .collect();
            let tolerance = options.tolerance;
            probe(cover, settings(tolerance), table.length, &rays, |_, end| {
                vec![end]
            })
        })
        .collect();
    rows.into_iter().flatten().collect()
}

/// Returns the direction through the middle of a pixel.
fn pixel_middle(view: &View, x: usize, y: usize) -> DVec3 {
    view.direction(x as f64 + 0.5, y as f64 + 0.5)
}

/// Measures the table's error at every pixel, (mrad, screen mrad); `None` where it gives up or nothing
/// is known.
fn table_errors(fan: &Fan, view: &View, probed: &[Probed]) -> Vec<Option<(f64, f64)>> {
    let width = view.size.0;
    probed
        .par_iter()
        .enumerate()
        .map(|(i, probed)| {
            let probe = probed.probes.first()?;
            // As the renderer looks it up.
            let mut coefficients = PathCoefficients::default();
            let number = fan.add(
                fan.locate(pixel_middle(view, i % width, i / width)),
                &mut coefficients,
            );
            let path = fan.among(&coefficients, number);
            if path.flagged_from() < probe.s {
                return None;
            }
            let deviation = probe.deviation(path.at(probe.s)?.0, None);
            Some((deviation.mrad, deviation.screen_mrad))
        })
        .collect()
}

/// Returns the quantiles of both errors of [`table_errors`]; `None` where nothing is known.
fn error_quantiles(errors: &[Option<(f64, f64)>]) -> [Option<Quantiles>; 2] {
    let of = |pick: fn(&(f64, f64)) -> f64| {
        let mut all: Vec<f64> = errors.iter().flatten().map(pick).collect();
        quantiles(&mut all)
    };
    [of(|e| e.0), of(|e| e.1)]
}

/// Arranges the screen errors as a picture; NaN where there is none.
fn screen_map(view: &View, errors: &[Option<(f64, f64)>]) -> Array2<f32> {
    let (width, height) = view.size;
    Array2::from_shape_fn((height, width), |(y, x)| {
        errors[y * width + x].map_or(f32::NAN, |e| e.1 as f32)
    })
}

/// Tells the errors of the local view at a distance.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DistanceErrors {
    /// Arc lengths from this to twice this.
    pub from: f64,
    /// Number of pixels that show something there.
    pub pixels: usize,
    /// Angle between where the local view puts it and where it is seen, mrad.
    pub mrad: Quantiles,
    /// Median of that angle over the arc length: equal at all distances where the error is of first
    /// order.
    pub mrad_per_length: f64,
}

/// Tells the outcome of a comparison of the local view.
#[derive(Debug, Clone, Serialize)]
pub struct LocalReport {
    /// PSNR of the local picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Time of the local picture without shading, seconds.
    pub local: f64,
    /// Time of the exact one.
    pub exact: f64,
    /// Paths of the exact picture that end by their length or where the metric ends.
    pub unfinished: UnfinishedPaths,
    /// The errors, nearest first.
    pub distances: Vec<DistanceErrors>,
}

/// Compares the local view with the exact one, light followed over `length`. The comparison has the
/// pictures `local`, `exact` and `error` (FLIP).
///
/// # Errors
/// Rays of the view start elsewhere than at its camera, so that nothing has one direction from there.
pub fn compare_local(
    world: &World,
    view: &View,
    samples: usize,
    length: f64,
    tolerance: f64,
) -> Result<Comparison<LocalReport>> {
    if !view.is_central() {
        let message = "errors are told as angles at the camera, and rays of an orthographic picture, or of an eye that sees all around, start elsewhere";
        return Err(Error::input("the camera", message));
    }
    let tracer = ExactTracer::new(&world.manifold, view.u, length, tolerance);
    let by = |paths: Paths<'_>| {
        draw(
            world,
            view,
            paths,
            samples,
            Footprints::Filtered,
            &crate::clock,
        )
    };
    let (local, exact) = (by(Paths::Straight(length)), by(Paths::Exact(&tracer)));
    let flip = flip(&exact.picture, &local.picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let psnr = psnr(&exact.picture, &local.picture)?;
    let report = LocalReport {
        psnr: psnr.is_finite().then_some(psnr),
        flip: mean_flip(&flip),
        local: local.paths.as_secs_f64(),
        exact: exact.paths.as_secs_f64(),
        distances: distance_errors(world, view, samples, &exact.outcomes),
        unfinished: unfinished(
            world,
            &[(view.clone(), exact.outcomes)],
            (length, tolerance),
        ),
    };
    let error = error_picture(&flip, "FLIP", "local against exact");
    Ok(Comparison {
        report,
        flip,
        pictures: vec![
            ("local", local.picture),
            ("exact", exact.picture),
            ("error", error),
        ],
    })
}

/// Measures by distance how far the local view puts the points that the exact one shows from where
/// they are seen.
fn distance_errors(
    world: &World,
    view: &View,
    samples: usize,
    exact: &Outcomes,
) -> Vec<DistanceErrors> {
    // Angles and their rates, by the octave of the distance.
    let mut errors: BTreeMap<i32, Vec<(f64, f64)>> = BTreeMap::new();
    let offset = offsets(samples)[0];
    for ((y, x, k), seen) in exact.indexed_iter() {
        if let (0, Seen::Surface(hit)) = (k, *seen) {
            let p = projection(world, view, world.point(&hit));
            let seen = view.direction(x as f64 + offset.x, y as f64 + offset.y);
            let put = (view.camera().rotation * p).normalize_or_zero();
            let angle = 1e3 * seen.cross(put).length().atan2(seen.dot(put));
            let octave = hit.s.log2().floor() as i32;
            errors
                .entry(octave)
                .or_default()
                .push((angle, angle / f64::from(hit.s)));
        }
    }
    let at_distance = |(octave, errors): (i32, Vec<(f64, f64)>)| {
        let (mut angles, mut rates): (Vec<f64>, Vec<f64>) = errors.into_iter().unzip();
        DistanceErrors {
            from: 2.0_f64.powi(octave),
            pixels: angles.len(),
            mrad: Quantiles::of(&mut angles),
            mrad_per_length: Quantiles::of(&mut rates).p50,
        }
    };
    errors.into_iter().map(at_distance).collect()
}

impl fmt::Display for LocalReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.psnr {
            Some(psnr) => writeln!(f, "PSNR {psnr:.1} dB, FLIP {:.5}", self.flip)?,
            None => writeln!(f, "PSNR infinite: the pictures are equal")?,
        }
        writeln!(
            f,
            "local {:.1} ms, exact {:.1} ms",
            1e3 * self.local,
            1e3 * self.exact
        )?;
        writeln!(f, "{}", self.unfinished)?;
        writeln!(
            f,
            "distance          pixels  error, mrad (p50 / p99)  over distance"
        )?;
        for d in &self.distances {
            writeln!(
                f,
                "{:7.3} to {:7.3} {:7}  {:9.2} / {:9.2}    {:8.2}",
                d.from,
                2.0 * d.from,
                d.pixels,
                d.mrad.p50,
                d.mrad.p99,
                d.mrad_per_length
            )?;
        }
        Ok(())
    }
}

/// Steps tried.
const STEPS: [usize; 21] = [
    3, 4, 6, 8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64, 96, 128, 192, 256, 384, 512, 1024,
];

/// A camera's chart point, and exact states of rays from it, by their directions in the standard frame.
pub(crate) type ProbedFan = (DVec3, Vec<(DVec3, Probe)>);

/// Integrates the rays of `fans` with more and more equal steps over `length`; returns, as long as it
/// is asked, the number of steps and the screen errors, mrad.
pub(crate) fn rivals<'a>(
    manifold: &'a Manifold,
    fans: &'a [ProbedFan],
    length: f64,
) -> impl Iterator<Item = (usize, Quantiles)> + 'a {
    let measured = move |steps| (steps, screen_errors(manifold, fans, length, steps));
    STEPS.into_iter().map(measured)
}

/// Measures the screen errors of `steps` equal steps.
fn screen_errors(manifold: &Manifold, fans: &[ProbedFan], length: f64, steps: usize) -> Quantiles {
    let errors = fans.par_iter().flat_map_iter(|(camera, probes)| {
        let local = manifold.local_frame(*camera);
        let rays: Vec<_> = probes
            .iter()
            .map(|(d, _)| (*camera, local.tangent(*d)))
            .collect();
        let paths = fixed_steps::<f32>(manifold, &rays, length, steps);
        let errors = probes.iter().zip(paths).map(|((_, probe), path)| {
            let u = position(&path, length, probe.s);
            finite(probe.screen_mrad(u - probe.u))
        });
        errors.collect::<Vec<f64>>()
    });
    let mut errors: Vec<f64> = errors.collect();
    Quantiles::of(&mut errors)
}

/// Bounds an error so that it can be written: JSON has no infinity, and beyond this nothing is worse.
pub(crate) fn finite(mrad: f64) -> f64 {
    mrad.min(1e6)
}

/// Returns the chart point at `s` on the cubics between the steps.
fn position((u, v): &(Vec<DVec3>, Vec<DVec3>), length: f64, s: f64) -> DVec3 {
    let steps = u.len() - 1;
    let place = s / length * steps as f64;
    let k = (place as usize).min(steps - 1);
    let at = |k: usize| length * k as f64 / steps as f64;
    let piece = Cubic {
        s: [at(k), at(k + 1)],
        u: [u[k], u[k + 1]],
        v: [v[k], v[k + 1]],
    };
    piece.position(place - k as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, random::Stream};

    #[test]
    fn errors_fall_with_the_fourth_power_of_the_steps_until_single_precision_ends_it() {
        let text = "name = 'lens'\ncoordinates = ['x', 'y', 'z']\n\
                    metric = { conformal = 'exp(0.3*exp(-(x^2 + y^2 + z^2)/2))' }";
        let manifold = Manifold::from_source(SourceText::new("lens", text), &[]).unwrap();
        let (camera, length) = (DVec3::new(1.2, 0.3, 0.1), 4.0);
        let mut stream = Stream::new(&[3]);
        let rays: Vec<_> = (0..200).map(|_| (camera, stream.direction())).collect();
        let probed = probe(&manifold, settings(1e-11), length, &rays, |_, end| {
            vec![0.97 * end]
        });
        let probes = rays
            .iter()
            .zip(&probed)
            .map(|((_, d), p)| (*d, p.probes[0]));
        let fans = [(camera, probes.collect())];
        let all: Vec<(usize, Quantiles)> = rivals(&manifold, &fans, length).take(12).collect();
        let p99 = |steps: usize| all.iter().find(|(n, _)| *n == steps).unwrap().1.p99;
        let order = (p99(6) / p99(12)).log2();
        assert!((order - 4.0).abs() < 0.8, "{order}");
        assert!(all.last().unwrap().1.p99 < 0.05);
    }
}
