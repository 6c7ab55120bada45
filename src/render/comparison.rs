//! One view by table and by exact integration: pictures, errors and times from the same run.
//!
//! In: a stage, a camera, a bundle's table. Out: a [`Comparison`]. The rivals are the adaptive
//! integrator in double precision, and *equal-error exact*: equal steps in single precision, the
//! fewest whose 99th percentile of screen error is no worse than the table's on the same rays
//! (DESIGN §7). Steps after the paths are the same code for all three.

use super::{
    frame::{Outcomes, Paths, Traced, Work, offsets, trace},
    lookup::Lookup,
    outcome::{Outcome, Seen},
    picture::{Picture, error_picture, flip, flip::DEFAULT_PIXELS_PER_DEGREE, psnr, write_png},
    shade::shade,
    endings::EndingFinder,
    strands::{Strand, Strands},
    tracer::{ExactTracer, FixedTracer, GridTracer},
    view::View,
    world::World,
};
use crate::{
    bundle::{
        Fan, Table,
        measure::{Probed, probe},
    },
    error::Result,
    quantiles::Quantiles,
};
use glam::DVec3;
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;
use std::{
    fmt,
    path::Path,
    time::{Duration, Instant},
};

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
    /// How often the table's frame is drawn: its times are medians.
    pub repeats: usize,
}

/// Times of one tracer's frame, seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Times {
    /// Fixing the camera: contraction of the table; zero for integrators.
    pub contract: f64,
    /// Paths and their intersection.
    pub paths: f64,
    /// Shading.
    pub shade: f64,
    /// All of it.
    pub frame: f64,
}

/// The rival at equal error.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Rival {
    /// Its steps; the most tried if none sufficed.
    pub steps: usize,
    /// Whether its error is no worse than the table's.
    pub equal: bool,
    /// Its screen error.
    pub screen_mrad: Quantiles,
    /// Its frame.
    pub times: Times,
}

/// How the lattice worked.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct LatticeReport {
    /// Paths looked up for it.
    pub curves: usize,
    /// Samples interpolated from them.
    pub interpolated: usize,
    /// Samples traced by themselves.
    pub traced: usize,
    /// Time for curves and checks, summed over threads, seconds.
    pub lattice: f64,
    /// Time for tubes and chords, summed over threads, seconds.
    pub tiles: f64,
    /// Time for samples, summed over threads, seconds.
    pub pixels: f64,
    /// Time for the rays that the table gave up on, by the clock, seconds.
    pub pending: f64,
}

impl From<Work> for LatticeReport {
    fn from(work: Work) -> Self {
        Self {
            curves: work.tally.paths,
            interpolated: work.tally.interpolated,
            traced: work.tally.traced,
            lattice: work.tally.lattice.as_secs_f64(),
            tiles: work.tally.tiles.as_secs_f64(),
            pixels: work.tally.pixels.as_secs_f64(),
            pending: work.pending_time.as_secs_f64(),
        }
    }
}

/// The outcome of a comparison, without its pictures.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Of the table's picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Error of the table's paths at the middle of every pixel, where its ray ends.
    pub mrad: Quantiles,
    /// The same as seen.
    pub screen_mrad: Quantiles,
    /// Angle between the directions in which the two pictures' samples look up the same sky.
    pub sky_mrad: Quantiles,
    /// Share of samples that the table gave up on.
    pub flagged: f64,
    /// The table's frame.
    pub table: Times,
    /// The exact frame.
    pub exact: Times,
    /// The rival's.
    pub equal_error: Rival,
    /// How the lattice worked.
    pub lattice: LatticeReport,
    /// Exact frame over table frame.
    pub speedup: f64,
    /// Equal-error frame over table frame.
    pub speedup_equal_error: f64,
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

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let quantiles =
            |q: &Quantiles| format!("{:.3} / {:.3} / {:.3} / {:.3}", q.p50, q.p95, q.p99, q.max);
        match self.psnr {
            Some(psnr) => writeln!(
                f,
                "PSNR                 {psnr:.1} dB, FLIP {:.5}",
                self.flip
            )?,
            None => writeln!(f, "PSNR                 infinite: the pictures are equal")?,
        }
        writeln!(
            f,
            "error, mrad          {} (p50 / p95 / p99 / max)",
            quantiles(&self.mrad)
        )?;
        writeln!(f, "screen error, mrad   {}", quantiles(&self.screen_mrad))?;
        writeln!(f, "sky direction, mrad  {}", quantiles(&self.sky_mrad))?;
        writeln!(
            f,
            "given up by table    {:.2} % of samples, integrated instead",
            1e2 * self.flagged
        )?;
        let rival = &self.equal_error;
        let equal = if rival.equal {
            ""
        } else {
            ", still worse than the table"
        };
        let rows = [
            ("table".to_string(), &self.table),
            ("exact".to_string(), &self.exact),
            (
                format!("equal-error exact ({} steps{equal})", rival.steps),
                &rival.times,
            ),
        ];
        for (name, t) in rows {
            let [contract, paths, shade, frame] =
                [t.contract, t.paths, t.shade, t.frame].map(|s| 1e3 * s);
            writeln!(
                f,
                "frame {frame:8.1} ms  = contract {contract:.1} + paths {paths:.1} + shade {shade:.1}: {name}"
            )?;
        }
        writeln!(
            f,
            "the table's frame is {:.1} times faster than exact, {:.1} times than equal-error exact",
            self.speedup, self.speedup_equal_error
        )
    }
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

/// Steps tried for the rival.
const RIVAL_STEPS: [usize; 13] = [8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512];

/// Rays on which the rival's steps are chosen: every so many pixels along both sides.
const RIVAL_STRIDE: usize = 8;

/// Compares.
///
/// # Errors
/// The camera is not in the table's region.
pub fn compare(world: &World, view: &View, table: &Table, options: Options) -> Result<Comparison> {
    let (table_frame, outcomes, tally, fan) = table_frame(world, view, table, options)?;
    let exact = ExactTracer::new(&world.manifold, view.u, table.length, options.tolerance);
    let (exact_picture, exact_times, exact_outcomes) =
        direct_frame(world, view, Paths::Exact(&exact), options);
    let probed = probe_pixels(world, view, table, options);
    let errors = table_errors(&fan, view, &probed);
    let equal_error = rival(world, view, table, options, &probed, &errors);
    let (table_picture, table_times) = table_frame;
    let flip = flip(&exact_picture, &table_picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let psnr = psnr(&exact_picture, &table_picture)?;
    let finite = |pick: fn(&(f64, f64)) -> f64| {
        let mut all: Vec<f64> = errors.iter().flatten().map(pick).collect();
        Quantiles::of(&mut all)
    };
    let flagged = outcomes.iter().filter(|o| o.flagged).count() as f64 / outcomes.len() as f64;
    let report = Report {
        psnr: psnr.is_finite().then_some(psnr),
        flip: flip.mean,
        mrad: finite(|e| e.0),
        screen_mrad: finite(|e| e.1),
        sky_mrad: sky_errors(&outcomes, &exact_outcomes),
        flagged,
        table: table_times,
        exact: exact_times,
        equal_error,
        lattice: tally.into(),
        speedup: exact_times.frame / table_times.frame,
        speedup_equal_error: equal_error.times.frame / table_times.frame,
    };
    let screen = errors.iter().map(|e| e.map_or(f32::NAN, |e| e.1 as f32));
    let (width, height) = view.size;
    let screen = Array2::from_shape_vec((height, width), screen.collect());
    Ok(Comparison {
        report,
        table: table_picture,
        exact: exact_picture,
        flip: flip.map,
        screen: screen.expect("one error for each pixel"),
    })
}

/// Angles between sky directions of samples that leave through the same exit, mrad.
fn sky_errors(a: &Outcomes, b: &Outcomes) -> Quantiles {
    let angle = |(a, b): (&Outcome, &Outcome)| match (a.seen, b.seen) {
        (
            Seen::Sky {
                exit, direction, ..
            },
            Seen::Sky {
                exit: other,
                direction: d,
                ..
            },
        ) if exit == other => Some(1e3 * f64::from((direction - d).length())),
        _ => None,
    };
    let mut angles: Vec<f64> = a.iter().zip(b).filter_map(angle).collect();
    Quantiles::of(&mut angles)
}

type Drawn = (Picture, Times);

/// The table's frame, drawn several times; times are medians.
fn table_frame<'t>(
    world: &World,
    view: &View,
    table: &'t Table,
    options: Options,
) -> Result<(Drawn, Outcomes, Work, Fan<'t>)> {
    let budget = 1e-3 * options.error;
    let mut all: Vec<Times> = Vec::new();
    let lookup = Lookup::new(table, 1e-3 * options.promise, options.tolerance);
    let offsets = offsets(options.samples);
    loop {
        let began = Instant::now();
        let fan = table.fan(view.u)?;
        let contract = began.elapsed();
        let tracer = lookup.tracer(&fan);
        let Traced { outcomes, work } =
            trace(world, view, Paths::Lattice(&tracer, budget), &offsets);
        let paths = began.elapsed() - contract;
        let picture = shade(world, view, outcomes.view());
        all.push(times(contract, paths, began.elapsed()));
        if all.len() >= options.repeats.max(1) {
            all.sort_by(|a, b| a.frame.total_cmp(&b.frame));
            let median = all[all.len() / 2];
            drop(tracer);
            return Ok(((picture, median), outcomes, work, fan));
        }
    }
}

fn times(contract: Duration, paths: Duration, frame: Duration) -> Times {
    Times {
        contract: contract.as_secs_f64(),
        paths: paths.as_secs_f64(),
        shade: (frame - contract - paths).as_secs_f64(),
        frame: frame.as_secs_f64(),
    }
}

fn direct_frame(
    world: &World,
    view: &View,
    paths: Paths<'_>,
    options: Options,
) -> (Picture, Times, Outcomes) {
    let began = Instant::now();
    let Traced { outcomes, .. } = trace(world, view, paths, &offsets(options.samples));
    let paths = began.elapsed();
    let picture = shade(world, view, outcomes.view());
    (
        picture,
        times(Duration::ZERO, paths, began.elapsed()),
        outcomes,
    )
}

/// The exact state where the ray through the middle of every pixel ends (surfaces left out: paths
/// go on behind them), row by row.
fn probe_pixels(world: &World, view: &View, table: &Table, options: Options) -> Vec<Probed> {
    let (width, height) = view.size;
    let rows: Vec<Vec<Probed>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let rays: Vec<(DVec3, DVec3)> =
                (0..width).map(|x| (view.u, middle(view, x, y))).collect();
            let tolerance = options.tolerance;
            probe(&world.manifold, tolerance, table.length, &rays, |_, end| {
                vec![end]
            })
        })
        .collect();
    rows.into_iter().flatten().collect()
}

fn middle(view: &View, x: usize, y: usize) -> DVec3 {
    view.direction(x as f64 + 0.5, y as f64 + 0.5)
}

/// (mrad, screen mrad) of the table at every pixel; `None` where it gives up or nothing is known.
fn table_errors(fan: &Fan<'_>, view: &View, probed: &[Probed]) -> Vec<Option<(f64, f64)>> {
    let width = view.size.0;
    probed
        .par_iter()
        .enumerate()
        .map(|(i, probed)| {
            let probe = probed.probes.first()?;
            let path = fan.path(middle(view, i % width, i / width));
            if path.flagged_from() < probe.s {
                return None;
            }
            let deviation = probe.deviation(path.at(probe.s)?.0, None);
            Some((deviation.mrad, deviation.screen_mrad))
        })
        .collect()
}

/// The equal-step integrator with the fewest steps that is as good as the table.
fn rival(
    world: &World,
    view: &View,
    table: &Table,
    options: Options,
    probed: &[Probed],
    errors: &[Option<(f64, f64)>],
) -> Rival {
    let (width, height) = view.size;
    let pixels: Vec<usize> = (0..height)
        .step_by(RIVAL_STRIDE)
        .flat_map(|y| (0..width).step_by(RIVAL_STRIDE).map(move |x| y * width + x))
        .filter(|&i| errors[i].is_some())
        .collect();
    let mut goal: Vec<f64> = pixels
        .iter()
        .filter_map(|&i| errors[i])
        .map(|e| e.1)
        .collect();
    let goal = Quantiles::of(&mut goal).p99;
    let directions: Vec<DVec3> = pixels
        .iter()
        .map(|i| middle(view, i % width, i / width))
        .collect();
    let measure = |steps: usize| {
        let tracer = FixedTracer::new(&world.manifold, view.u, table.length, steps);
        let mut strands = Strands::new(tracer.knots().clone());
        let mut endings = EndingFinder::new(&world.manifold);
        tracer.add(&directions, &mut endings, &mut strands);
        let mut found: Vec<f64> = pixels
            .iter()
            .enumerate()
            .map(|(k, &i)| strand_error(strands.strand(k), &probed[i]))
            .collect();
        Quantiles::of(&mut found)
    };
    let mut chosen = (RIVAL_STEPS[RIVAL_STEPS.len() - 1], Quantiles::default());
    for steps in RIVAL_STEPS {
        chosen = (steps, measure(steps));
        if chosen.1.p99 <= goal {
            break;
        }
    }
    let tracer = FixedTracer::new(&world.manifold, view.u, table.length, chosen.0);
    let (_, times, _) = direct_frame(world, view, Paths::Direct(&tracer), options);
    Rival {
        steps: chosen.0,
        equal: chosen.1.p99 <= goal,
        screen_mrad: chosen.1,
        times,
    }
}

fn strand_error(strand: Strand<'_>, probed: &Probed) -> f64 {
    let Some(probe) = probed.probes.first() else {
        return 0.0;
    };
    match strand.position(probe.s) {
        Some(u) => probe.deviation(u, None).screen_mrad,
        None => f64::INFINITY,
    }
}
