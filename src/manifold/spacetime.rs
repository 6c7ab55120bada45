//! A stationary spacetime -> metric, wind, drift and lapse, as graph nodes.
//!
//! In: the entries of `ds² = g_tt dt² + 2 g_ti dt dx^i + g_ij dx^i dx^j`, none of which depends on t.
//! Out: what its light sees, in two forms.
//!
//! Observers at rest on the slices t = const ([`normal`], after Zermelo):
//! `β_i = g_ti`, `β^i = γ^ij β_j`, `N² = β_i β^i − g_tt`, `G = γ/N²`, `W = −β`. `G` is positive definite
//! wherever the slices are spacelike, inside horizons too.
//!
//! Observers at rest in the coordinates ([`fixed`], after Randers): `V² = −g_tt`,
//! `G_ij = g_ij/V² + g_ti g_tj/V⁴`, `b_i = g_ti/V²`. They end at the ergosphere, where `V² = 0`.

use super::{
    geometry::{PAIRS, factor, solve},
    wind::Medium,
};
use crate::expr::{Graph, NodeId, Unary};

/// The entries of a metric of spacetime.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entries {
    pub tt: NodeId,
    /// `g_ti`
    pub t: [NodeId; 3],
    /// `g_ij`: xx, yy, zz, xy, xz, yz.
    pub space: [NodeId; 6],
}

/// Metric and medium for the observers whose world lines are normal to the slices t = const.
pub(super) fn normal(graph: &mut Graph, entries: &Entries) -> ([NodeId; 6], Medium) {
    let factors = factor(graph, entries.space);
    let shift = solve(graph, &factors, entries.t);
    let square = graph.dot(&entries.t, &shift);
    let square = graph.sub(square, entries.tt);
    let lapse = graph.unary(Unary::Sqrt, square);
    let (metric, wind) = sliced(graph, entries.space, shift, square);
    let medium = Medium {
        wind: Some(wind),
        drift: None,
        lapse: Some(lapse),
    };
    (metric, medium)
}

/// `γ/N²` and `−β` of slices with metric γ, shift β and the square N² of the lapse.
pub(super) fn sliced(
    graph: &mut Graph,
    space: [NodeId; 6],
    shift: [NodeId; 3],
    square: NodeId,
) -> ([NodeId; 6], [NodeId; 3]) {
    let metric = space.map(|g| graph.div(g, square));
    (metric, shift.map(|b| graph.neg(b)))
}

/// Metric and medium for the observers at rest in the coordinates, and `V²`, positive where there are
/// any.
pub(super) fn fixed(graph: &mut Graph, entries: &Entries) -> ([NodeId; 6], Medium, NodeId) {
    let square = graph.neg(entries.tt);
    let drift = entries.t.map(|g| graph.div(g, square));
    let mut metric = entries.space;
    for (g, (i, j)) in metric.iter_mut().zip(PAIRS) {
        let own = graph.div(*g, square);
        *g = graph.mul_add(drift[i], drift[j], own);
    }
    let lapse = graph.unary(Unary::Sqrt, square);
    let medium = Medium {
        wind: None,
        drift: Some(drift),
        lapse: Some(lapse),
    };
    (metric, medium, square)
}
