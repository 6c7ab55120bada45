//! Comparisons of the points of one manifold.
//!
//! In: [`ManifoldResults`]. Out: slopes, the Pareto front, sizes at equal error, and when baking pays. Only
//! measured points are compared; nothing is extrapolated.

use crate::sweep::{
    grid::mean,
    manifold_sweep::{ManifoldResults, Rival},
    point::{SweepPoint, TableKind, TableMeasurement, TableSpec},
};

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
/// negative.
pub fn byte_slopes(points: &[Pair<'_>]) -> Vec<f64> {
    let bytes = |(_, m): &Pair<'_>| m.disk as f64;
    let slope = |pair: &[Pair<'_>]| log_ratio(pair, error) / log_ratio(pair, bytes);
    points.windows(2).map(slope).collect()
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
