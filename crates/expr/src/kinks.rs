//! Where expressions are not smooth.
//!
//! In: nodes. Out: functions of the inputs that vanish exactly where `abs`, `min`, `max` or `if`
//! below those nodes change their branch.

use super::graph::{Binary, Graph, Node, NodeId, Unary};

impl Graph {
    /// The functions that vanish at the kinks of `roots`, each once: the argument of `abs`, the
    /// difference of what `min`, `max` or a condition compares. Their signs mean nothing.
    pub fn kinks(&mut self, roots: &[NodeId]) -> Vec<NodeId> {
        let mut found = Vec::new();
        for node in self.below(roots) {
            let function = match node {
                Node::Unary(Unary::Abs, a) => a,
                Node::Binary(
                    Binary::Min | Binary::Max | Binary::Less | Binary::LessEqual,
                    a,
                    b,
                ) => self.sub(a.min(b), a.max(b)),
                _ => continue,
            };
            if !found.contains(&function) {
                found.push(function);
            }
        }
        found
    }

    /// All nodes that `roots` depend on, themselves included.
    fn below(&self, roots: &[NodeId]) -> Vec<Node> {
        let reached = self.reached_from(roots);
        let ids = (0..self.len()).rev().filter(|id| reached[*id]);
        ids.map(|id| self.node(NodeId(id as u32))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kink_is_found_once_and_smooth_parts_have_none() {
        let mut graph = Graph::new();
        let (x, y) = (graph.input(0), graph.input(1));
        let least = graph.binary(Binary::Min, x, y);
        let most = graph.binary(Binary::Max, y, x);
        let size = graph.unary(Unary::Abs, x);
        let sine = graph.unary(Unary::Sin, y);
        let sum = graph.add(least, size);
        let difference = graph.sub(x, y);
        let found = graph.kinks(&[sum, most, sine]);
        assert_eq!(found.len(), 2);
        assert!(found.contains(&difference) && found.contains(&x));
        assert!(graph.kinks(&[sine]).is_empty());
    }
}
