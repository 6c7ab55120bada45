//! What the points of one manifold say together.
//!
//! In: [`Results`]. Out: slopes, the Pareto front, sizes at equal error, and when baking pays. Only
//! measured points are compared; nothing is extrapolated.

use crate::sweep::{
    grid::mean,
    point::{Kind, Measured, Point, What},
    rival::equal,
    subject::Results,
};

/// All kinds that are drawn, in the order of the legend.
pub const KINDS: [Kind; 6] = [
    Kind::Patches,
    Kind::UndividedPatches,
    Kind::MultilinearF32,
    Kind::MultilinearU16,
    Kind::CubicF32,
    Kind::CubicU16,
];

/// A measured point: the point, and its measurement.
pub type Pair<'a> = (&'a Point, &'a Measured);

impl Results {
    /// The measured points of a kind, smallest first.
    pub fn of(&self, kind: Kind) -> Vec<Pair<'_>> {
        let all = self.points.iter().filter(|p| p.key.what.kind() == kind);
        let mut found: Vec<Pair<'_>> = all.filter_map(|p| Some((p, p.measured()?))).collect();
        found.sort_by_key(|(_, m)| m.disk);
        found
    }

    /// The points that no other point beats in bytes and error both, smallest first. Undivided
    /// patches stay out: most of their rays are not in the table.
    pub fn front(&self) -> Vec<Pair<'_>> {
        let kinds = KINDS.into_iter().filter(|k| *k != Kind::UndividedPatches);
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

/// How error falls from one point to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slope {
    /// Logarithm of the error by logarithm of the bytes, negative.
    pub bytes: f64,
    /// Logarithm of the error by logarithm of the mean spacing: the order; grids only.
    pub order: Option<f64>,
}

/// The slopes between neighbours of `points`.
pub fn slopes(points: &[Pair<'_>]) -> Vec<Slope> {
    let pairs = points.windows(2);
    let slope = |pair: &[Pair<'_>]| {
        let ratio = |of: &dyn Fn(&Pair<'_>) -> f64| (of(&pair[1]) / of(&pair[0])).ln();
        let error = ratio(&|(_, m)| m.errors.screen.p99);
        let cells = |(point, _): &Pair<'_>| match &point.key.what {
            What::Grid { cells, .. } => mean(cells),
            What::Patches { .. } => 1.0,
        };
        let finer = ratio(&cells);
        Slope {
            bytes: error / ratio(&|(_, m)| m.disk as f64),
            order: (finer > 0.0).then(|| -error / finer),
        }
    };
    pairs.map(slope).collect()
}

/// How many times larger tables of another kind are at equal or smaller error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ratio {
    /// So many times, both sides measured.
    Measured(f64),
    /// More: the largest table that was measured is so many times larger and not yet as good.
    More(f64),
}

/// The size of the smallest of `others` that is as accurate as `table`, beside its size; `None` if
/// there are no others.
pub fn ratio(table: &Measured, others: &[Pair<'_>]) -> Option<Ratio> {
    let times = |m: &Measured| m.disk as f64 / table.disk as f64;
    let good = others
        .iter()
        .find(|(_, m)| m.errors.screen.p99 <= table.errors.screen.p99);
    match good {
        Some((_, m)) => Some(Ratio::Measured(times(m))),
        None => others.last().map(|(_, m)| Ratio::More(times(m))),
    }
}

impl std::fmt::Display for Ratio {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (sign, times) = match self {
            Self::Measured(times) => ("", times),
            Self::More(times) => ("> ", times),
        };
        match *times < 10.0 {
            true => write!(f, "{sign}{times:.1}"),
            false => write!(f, "{sign}{times:.0}"),
        }
    }
}

/// When a bundle pays in processor time, against the integrator that is as accurate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payoff {
    /// Steps of the integrator.
    pub steps: usize,
    /// Its nanoseconds for a path.
    pub exact_ns: f64,
    /// Paths after which bake and lookups took less time; `None` if they never do.
    pub paths: Option<f64>,
    /// Frames of the default view after which bake and frames took less; `None` if they never do.
    pub frames: Option<f64>,
}

/// When `table` pays; `None` if no integrator that was tried is as accurate.
pub fn payoff(results: &Results, table: &Measured) -> Option<Payoff> {
    let rival = equal(&results.rivals, table.errors.screen.p99)?;
    let after = |saved_s: f64| (saved_s > 0.0).then(|| (table.bake.cpu_s / saved_s).ceil());
    let frames = table.frame_ms.zip(table.rival_frame_ms);
    Some(Payoff {
        steps: rival.steps,
        exact_ns: rival.path_ns,
        paths: after(1e-9 * (rival.path_ns - table.path_ns)),
        frames: frames.and_then(|(own, rival)| after(1e-3 * (rival - own))),
    })
}
