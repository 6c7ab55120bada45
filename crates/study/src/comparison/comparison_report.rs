//! The numbers of a comparison, as text and for JSON.
//!
//! In: drawings with their times. Out: [`FrameTimes`], in seconds, and the [`ComparisonReport`].

use super::LatticeErrors;
use geofan_core::{geodesic::UnfinishedPaths, quantiles::Quantiles};
use geofan_render::{drawing::Drawing, frame::FrameStatistics};
use serde::Serialize;
use std::fmt;

/// Tells the times of one tracer's frame, seconds by the clock. `lattice`, `tiles` and `pixels` overlap on
/// several threads: they are the shares of the time for paths that threads spent on each.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct FrameTimes {
    /// Fixing the camera: contraction of the table; zero for integrators.
    pub contract: f64,
    /// Paths of the lattice, and dividing tiles.
    pub lattice: f64,
    /// Tubes and chords.
    pub tiles: f64,
    /// Samples: their paths, and what they meet.
    pub pixels: f64,
    /// Rays that the table gave up on, integrated.
    pub pending: f64,
    /// Colours and the pixel filter.
    pub shade: f64,
    /// All of it.
    pub frame: f64,
}

/// Splits the time of a drawing.
pub(super) fn frame_times(drawing: &Drawing) -> FrameTimes {
    // Threads' times of the steps of paths, which overlap.
    let work = &drawing.work;
    let pending = work.pending_time.as_secs_f64();
    let paths = drawing.paths.as_secs_f64();
    let [lattice, tiles, pixels] = [work.lattice, work.tiles, work.pixels].map(|t| t.as_secs_f64());
    let threads = lattice + tiles + pixels;
    // Tracers without steps of their own spend all of it on samples.
    let share = |part: f64| match threads > 0.0 {
        true => (paths - pending) * part / threads,
        false => 0.0,
    };
    let shade = drawing.shade.as_secs_f64();
    FrameTimes {
        contract: 0.0,
        lattice: share(lattice),
        tiles: share(tiles),
        pixels: if threads > 0.0 { share(pixels) } else { paths },
        pending,
        shade,
        frame: paths + shade,
    }
}

/// Takes the median of each step's times; of the whole frame's too, so steps need not add up to it.
pub(super) fn median(all: impl Iterator<Item = FrameTimes>) -> FrameTimes {
    let all: Vec<FrameTimes> = all.collect();
    let middle = |pick: fn(&FrameTimes) -> f64| {
        let mut values: Vec<f64> = all.iter().map(pick).collect();
        Quantiles::of(&mut values).p50
    };
    FrameTimes {
        contract: middle(|t| t.contract),
        lattice: middle(|t| t.lattice),
        tiles: middle(|t| t.tiles),
        pixels: middle(|t| t.pixels),
        pending: middle(|t| t.pending),
        shade: middle(|t| t.shade),
        frame: middle(|t| t.frame),
    }
}

/// Describes equal-error exact.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct EqualErrorExact {
    /// Its steps; the most tried if none sufficed.
    pub steps: usize,
    /// Set if its error is no worse than the table's.
    pub equal: bool,
    /// Its screen error.
    pub screen_mrad: Quantiles,
    /// The times of its frame.
    pub times: FrameTimes,
    /// Those of its frame with the lattice, so with the lattice's error too.
    pub lattice_times: FrameTimes,
}

/// Tells the nanoseconds for the path of one pixel.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PathTimes {
    /// A table's, with the lattice.
    pub table: f64,
    /// A table's, every pixel by itself.
    pub table_without_lattice: f64,
    /// Exact.
    pub exact: f64,
    /// Equal-error exact.
    pub equal_error: f64,
    /// Equal-error exact with the lattice.
    pub equal_error_lattice: f64,
}

/// Tells the outcome of a comparison.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonReport {
    /// PSNR of the table's picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Error of the table's paths at the middle of every pixel, where its ray ends.
    pub mrad: Quantiles,
    /// Screen error of the table's paths.
    pub screen_mrad: Quantiles,
    /// What the lattice adds to the errors of the table's paths.
    #[serde(flatten)]
    pub lattice_errors: LatticeErrors,
    /// Angle between the directions in which the two pictures' samples look up the same sky.
    pub sky_mrad: Quantiles,
    /// Share of samples that the table gave up on.
    pub flagged: f64,
    /// Paths of the exact picture that end by their length or where the metric ends.
    pub unfinished: UnfinishedPaths,
    /// The table's frame: medians over a moving camera.
    pub table: FrameTimes,
    /// The exact frame.
    pub exact: FrameTimes,
    /// Equal-error exact.
    pub equal_error: EqualErrorExact,
    /// Paths alone.
    pub paths_ns: PathTimes,
    /// The work of the lattice.
    pub lattice: FrameStatistics,
    /// Exact frame over table frame.
    pub speedup: f64,
    /// Equal-error frame over table frame.
    pub speedup_equal_error: f64,
    /// Frame of equal-error exact with the lattice over table frame.
    pub speedup_equal_error_lattice: f64,
}

impl fmt::Display for ComparisonReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.differences(f)?;
        self.frames(f)?;
        let p = &self.paths_ns;
        writeln!(
            f,
            "paths, ns a pixel    table {:.0} (without lattice {:.0}), exact {:.0}, equal-error exact {:.0} (with lattice {:.0})",
            p.table, p.table_without_lattice, p.exact, p.equal_error, p.equal_error_lattice
        )?;
        writeln!(
            f,
            "the table's frame is {:.1} times faster than exact, {:.1} times than equal-error exact, {:.1} times than that with a lattice",
            self.speedup, self.speedup_equal_error, self.speedup_equal_error_lattice
        )
    }
}

impl ComparisonReport {
    /// Writes how far the pictures are apart.
    fn differences(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.psnr {
            Some(psnr) => writeln!(
                f,
                "PSNR                 {psnr:.1} dB, FLIP {:.5}",
                self.flip
            )?,
            None => writeln!(f, "PSNR                 infinite: the pictures are equal")?,
        }
        let rows = [
            ("error, mrad", &self.mrad),
            ("screen error, mrad", &self.screen_mrad),
            ("lattice adds, mrad", &self.lattice_errors.lattice_mrad),
            ("sky direction, mrad", &self.sky_mrad),
        ];
        for (name, q) in rows {
            let (a, b, c, d) = (q.p50, q.p95, q.p99, q.max);
            writeln!(
                f,
                "{name:20} {a:.3} / {b:.3} / {c:.3} / {d:.3} (p50 / p95 / p99 / max)"
            )?;
        }
        write!(f, "{}", self.lattice_errors)?;
        let flagged = 1e2 * self.flagged;
        writeln!(
            f,
            "given up by table    {flagged:.2} % of samples, integrated instead"
        )?;
        writeln!(f, "ends of paths        {}", self.unfinished)
    }

    /// Writes a line for each frame.
    fn frames(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rival = &self.equal_error;
        let equal = match rival.equal {
            true => "",
            false => ", still worse than the table",
        };
        let name = format!("equal-error exact ({} steps{equal})", rival.steps);
        let rows = [
            ("table", &self.table),
            ("exact", &self.exact),
            (&name, &rival.times),
            ("the same with a lattice", &rival.lattice_times),
        ];
        for (name, t) in rows {
            let [frame, contract, lattice, tiles, pixels, pending, shade] = [
                t.frame, t.contract, t.lattice, t.tiles, t.pixels, t.pending, t.shade,
            ]
            .map(|s| 1e3 * s);
            writeln!(
                f,
                "frame {frame:8.1} ms  = contract {contract:.1} + lattice {lattice:.1} + tiles {tiles:.1} + pixels {pixels:.1} + given up {pending:.1} + shade {shade:.1}: {name}"
            )?;
        }
        Ok(())
    }
}
