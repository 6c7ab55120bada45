//! Where the paths of an interval meet edges of the metric.
//!
//! In: the interval's paths at Chebyshev nodes, which meet edges where their table says. Out: the pieces between knots in
//! which any path of the interval may meet one. There polynomials along the arc are none of a path's.

use crate::path_batch::piece_at;
use geofan_bundle::TablePath;

/// Share of the difference between the nodes' edges by which those of paths beyond the outermost nodes may differ more:
/// these are 1 % of the interval away from its ends.
const BEYOND_NODES: f64 = 0.05;

/// Lists the pieces between `knots` in which paths between these may meet edges, in order; `None` if they meet different
/// numbers of them.
pub(super) fn pieces_with_edges(paths: &[TablePath<'_>], knots: &[f64]) -> Option<Vec<usize>> {
    let edges: Vec<Vec<f64>> = paths.iter().map(|path| path.edges().collect()).collect();
    let count = edges.first().map_or(0, Vec::len);
    if edges.iter().any(|edges| edges.len() != count) {
        return None;
    }
    let mut pieces = Vec::new();
    for edge in 0..count {
        let places = edges.iter().map(|edges| edges[edge]);
        let low = places.clone().fold(f64::INFINITY, f64::min);
        let high = places.fold(0.0, f64::max);
        let beyond = BEYOND_NODES * (high - low);
        pieces.extend(piece_at(knots, low - beyond)..=piece_at(knots, high + beyond));
    }
    pieces.dedup();
    Some(pieces)
}
