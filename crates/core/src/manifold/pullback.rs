//! Textbook coordinates: what is written in r, θ, φ, in terms of the chart's x, y, z, and on their axis.
//!
//! In: the textbook coordinates as functions of the chart, with their Jacobian `J^a_k = ∂r^a/∂u^k`. Out:
//! metrics (`JᵀgJ`), vectors (`J⁻¹w`) and covectors (`Jᵀb`) of the chart, as graph nodes.
//!
//! On the axis formulas give no values, though the space is as smooth there as anywhere: numbers that are smooth
//! functions of the point around it are what they tend to there, from points on both sides ([`around`]).

use super::geometry::{PAIRS, symmetric};
use geofan_expr::{Direction, Graph, NodeId};
use glam::DVec3;

/// The differential of the textbook coordinates by the chart's.
#[derive(Debug, Clone)]
pub(super) struct Pullback {
    /// Rows: one for each textbook coordinate.
    rows: [[NodeId; 3]; 3],
    /// The columns of `J⁻¹ det J`, and `det J`.
    cofactors: [[NodeId; 3]; 3],
    pub determinant: NodeId,
}

impl Pullback {
    /// Prepares for these textbook coordinates.
    pub fn new(graph: &mut Graph, coordinates: [NodeId; 3]) -> Self {
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
        let rows = coordinates.map(|r| axes.each_mut().map(|axis| graph.derivative(r, axis)));
        let cofactors = [(1, 2), (2, 0), (0, 1)].map(|(a, b)| graph.cross(rows[a], rows[b]));
        let determinant = graph.dot(&rows[0], &cofactors[0]);
        Self {
            rows,
            cofactors,
            determinant,
        }
    }

    /// `J` by rows, and its determinant.
    pub fn nodes(&self) -> Vec<NodeId> {
        let rows = self.rows.iter().flatten().copied();
        rows.chain([self.determinant]).collect()
    }

    /// `JᵀgJ`
    pub fn metric(&self, graph: &mut Graph, g: [NodeId; 6]) -> [NodeId; 6] {
        let lowered = [0, 1, 2].map(|a| {
            let row = [0, 1, 2].map(|b| g[symmetric(a, b)]);
            self.covector(graph, row)
        });
        PAIRS.map(|(k, l)| {
            let [left, right] = [
                self.rows.map(|row| row[k]),
                lowered.map(|covector| covector[l]),
            ];
            graph.dot(&left, &right)
        })
    }

    /// `J⁻¹w`
    pub fn vector(&self, graph: &mut Graph, w: [NodeId; 3]) -> [NodeId; 3] {
        [0, 1, 2].map(|k| {
            let sum = graph.dot(&w, &self.cofactors.map(|column| column[k]));
            graph.div(sum, self.determinant)
        })
    }

    /// `Jᵀb`
    pub fn covector(&self, graph: &mut Graph, b: [NodeId; 3]) -> [NodeId; 3] {
        [0, 1, 2].map(|k| graph.dot(&b, &self.rows.map(|row| row[k])))
    }
}

/// How far the nearest points are from the one asked for, as shares of its distance from the chart's
/// origin (in chart units at the origin itself). Near by, rounding spoils what is made of angles about
/// the axis; far away, the space is another. What differs least between two orders is taken.
const NEAREST: [f64; 6] = [3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-6];

/// From the point asked for to others: beside all coordinate axes and planes through it.
const BESIDE: DVec3 = DVec3::new(0.48, 0.6, 0.64);

/// Extrapolates what `values` tends to at `u`; not numbers if it is none around it.
pub(crate) fn around(u: DVec3, mut values: impl FnMut(DVec3) -> Vec<f64>) -> Vec<f64> {
    let scale = match u.length() {
        length if length > 0.0 => length,
        _ => 1.0,
    };
    let mut best: Option<(f64, Vec<f64>)> = None;
    for nearest in NEAREST {
        let (found, doubt) = extrapolated(u, BESIDE * (nearest * scale), &mut values);
        if best
            .as_ref()
            .is_none_or(|(least, _)| doubt < *least || least.is_nan())
        {
            best = Some((doubt, found));
        }
    }
    best.map(|(_, found)| found).unwrap_or_default()
}

/// Extrapolates the means of both sides at one, two and three times `by` to the point itself; and tells how far
/// that is, at most, from what the first two alone say.
fn extrapolated(
    u: DVec3,
    by: DVec3,
    values: &mut impl FnMut(DVec3) -> Vec<f64>,
) -> (Vec<f64>, f64) {
    let [one, two, three] = [1.0, 2.0, 3.0].map(|k| {
        let (a, b) = (values(u + by * k), values(u - by * k));
        a.iter()
            .zip(b)
            .map(|(a, b)| 0.5 * (a + b))
            .collect::<Vec<_>>()
    });
    let mut doubt = 0.0;
    let mut found = Vec::with_capacity(one.len());
    for ((a, b), c) in one.iter().zip(two).zip(three) {
        // Even functions of the distance: terms of the second and of the fourth power fall out.
        let all = (15.0 * a - 6.0 * b + c) / 10.0;
        let off = (all - (4.0 * a - b) / 3.0).abs();
        doubt = if off <= doubt { doubt } else { off };
        found.push(all);
    }
    (found, doubt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_values_are_found_whatever_the_size_of_the_space() {
        for size in [1e-3, 1.0, 1e4] {
            let u = DVec3::new(0.0, 0.0, 2.0 * size);
            let values = |u: DVec3| {
                let (x, y) = (u.x / size, u.y / size);
                let rho2 = x * x + y * y;
                // sin ρ/ρ in disguise, with an odd function beside it.
                vec![rho2.sqrt().sin() / rho2.sqrt() + x, (u.z / size).cos()]
            };
            assert!(!values(u)[0].is_finite());
            let found = around(u, values);
            assert!((found[0] - 1.0).abs() < 1e-11, "{}", found[0]);
            assert!((found[1] - 2.0_f64.cos()).abs() < 1e-11, "{}", found[1]);
        }
    }
}
