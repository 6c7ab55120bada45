//! Divisions as formulas have them.
//!
//! In: numerator and denominator. Out: their quotient, with slopes also where the denominator grows beyond all numbers, and
//! where it is the size of the numerator: there the quotient rule makes numbers of infinities or of differences of large ones.

use super::{Binary, Graph, Node, NodeId, Unary};

/// Most parts of a numerator that are looked at: lets that are squares of each other have more than there are atoms.
const MOST_FACTORS: usize = 1000;

impl Graph {
    /// `a / b` of a formula: where `b` has exponential functions in it and is infinite, slopes are 0, not the rule's 0 · ∞;
    /// where it is a sign, as `x / |x|` is, slopes are 0 up to the jump.
    pub fn quotient(&mut self, a: NodeId, b: NodeId) -> NodeId {
        use Unary::{Cosh, Exp, Sinh};
        if let Some(sign) = self.as_sign(a, b) {
            return sign;
        }
        let grows = |node: &Node| matches!(node, Node::Unary(Exp | Sinh | Cosh, _));
        if self.below(&[b]).iter().any(grows) {
            let reciprocal = self.recip(b);
            self.vanishing.insert(reciprocal, b);
        }
        self.div(a, b)
    }

    /// Tells whether a reciprocal and its slopes vanish where it is 0.
    pub(crate) fn vanishes(&self, id: NodeId) -> bool {
        self.vanishing.contains_key(&id)
    }

    /// Returns `c x / |x|` and `c |x| / x` as `c` times the sign of `x`.
    fn as_sign(&mut self, a: NodeId, b: NodeId) -> Option<NodeId> {
        let (x, factor) = match self.node(b) {
            Node::Unary(Unary::Abs, x) => (x, x),
            Node::Unary(Unary::Neg, x) => {
                let negative = self.neg(a);
                return self.as_sign(negative, x);
            }
            _ => (b, *self.index.get(&Node::Unary(Unary::Abs, b))?),
        };
        let rest = self.without_factor(a, factor, &mut { MOST_FACTORS })?;
        let [zero, one, minus] = [0.0, 1.0, -1.0].map(|c| self.constant(c));
        let positive = self.binary(Binary::Less, zero, x);
        let sign = self.select(positive, one, minus);
        Some(self.mul(rest, sign))
    }

    /// Returns a product without this factor of it, if that is among the first so many `left`.
    fn without_factor(
        &mut self,
        product: NodeId,
        factor: NodeId,
        left: &mut usize,
    ) -> Option<NodeId> {
        *left = left.checked_sub(1)?;
        if product == factor {
            return Some(self.constant(1.0));
        }
        match self.node(product) {
            Node::Unary(Unary::Neg, x) => {
                let rest = self.without_factor(x, factor, left)?;
                Some(self.neg(rest))
            }
            Node::Binary(Binary::Mul, x, y) => {
                let (rest, other) = match self.without_factor(x, factor, left) {
                    Some(rest) => (rest, y),
                    None => (self.without_factor(y, factor, left)?, x),
                };
                Some(self.mul(rest, other))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tape;

    #[test]
    fn numerators_of_any_depth_are_divided_at_once() {
        let mut graph = Graph::new();
        let (x, y) = (graph.input(0), graph.input(1));
        let size = graph.unary(Unary::Abs, x);
        let long = (0..200_000).fold(y, |product, i| {
            let more = graph.input(2 + i % 5);
            graph.mul(product, more)
        });
        // Squares of squares of sums, which no power stands for.
        let mut tall = graph.add(y, size);
        for _ in 0..60 {
            let more = graph.add(tall, y);
            tall = graph.mul(tall, more);
        }
        for product in [long, tall] {
            let quotient = graph.quotient(product, size);
            assert!(!matches!(graph.node(quotient), Node::Select(..)));
        }
    }

    #[test]
    fn a_number_through_its_size_is_its_sign_however_that_is_written() {
        let mut graph = Graph::new();
        let (x, y) = (graph.input(0), graph.input(1));
        let size = graph.unary(Unary::Abs, x);
        let square = graph.powi(x, 2);
        let root = graph.unary(Unary::Sqrt, square);
        assert_eq!(root, size);
        let sign = graph.quotient(x, size);
        assert!(matches!(graph.node(sign), Node::Select(..)));
        assert_eq!(graph.quotient(size, x), sign);
        let other = graph.quotient(y, size);
        assert!(!matches!(graph.node(other), Node::Select(..)));
        // −0.25 x y / |x|, and |x| / −x
        let quarter = graph.constant(-0.25);
        let product = graph.mul(quarter, x);
        let product = graph.mul(product, y);
        let quotient = graph.quotient(product, size);
        let negative = graph.neg(x);
        let turned = graph.quotient(size, negative);
        let tape = Tape::compile(&graph, &[quotient, turned], 2).unwrap();
        let mut registers = tape.registers::<f64, 1>();
        for (x, sign) in [(-1e-300, -1.0), (0.3, 1.0)] {
            registers.input(0)[0] = x;
            registers.input(1)[0] = 3.0;
            tape.run(&mut registers);
            assert_eq!(registers.output(0)[0], -0.75 * sign);
            assert_eq!(registers.output(1)[0], -sign);
        }
    }
}
