//! Textbook coordinates: what is written in r, θ, φ, in terms of the chart's x, y, z.
//!
//! In: the textbook coordinates as functions of the chart, with their Jacobian `J^a_k = ∂r^a/∂u^k`. Out:
//! metrics (`JᵀgJ`), vectors (`J⁻¹w`) and covectors (`Jᵀb`) of the chart, as graph nodes.

use super::geometry::{PAIRS, symmetric};
use geofan_expr::{Direction, Graph, NodeId};

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
        let cofactors = [(1, 2), (2, 0), (0, 1)].map(|(a, b)| cross(graph, rows[a], rows[b]));
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

fn cross(graph: &mut Graph, a: [NodeId; 3], b: [NodeId; 3]) -> [NodeId; 3] {
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| {
        let (forth, back) = (graph.mul(a[i], b[j]), graph.mul(a[j], b[i]));
        graph.sub(forth, back)
    })
}
