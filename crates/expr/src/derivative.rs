//! Exact derivatives of graphs, as new nodes of the same graph, and where they jump.
//!
//! In: a node and the rates of the inputs along some direction. Out: the node's rate along it
//! (forward-mode automatic differentiation, carried out once on the graph instead of at every
//! point). Applied twice it gives second derivatives. Of a weighted sum of nodes [`Graph::gradient`] gives the rates along
//! many inputs at once (reverse mode).
//!
//! # Where branches meet
//!
//! Where the two sides of `abs`, `min`, `max` or `if` meet, the derivative is one-sided: that of the
//! branch whose value is taken there, never an average.
//!
//! | expression | at | derivative |
//! |---|---|---|
//! | `abs(a)` | `a = 0` | `a'`, as for `a > 0` |
//! | `min(a, b)`, `max(a, b)` | `a = b` | `min`: `b'`; `max`: `a'` |
//! | `if(a < b, p, q)`, `if(a > b, p, q)` | `a = b` | `q'` |
//! | `if(a <= b, p, q)`, `if(a >= b, p, q)` | `a = b` | `p'` |
//! | `a^1.5`, `a^2.5` and so on | `a = 0` | 0, and so are all higher ones |
//! | `p/a` with `exp`, `sinh` or `cosh` in `a` | `a = ±∞` | 0, and so are all higher ones |
//!
//! Only the branch taken counts, even where the other one is not finite. [`Graph::switching_functions`] names the
//! functions that vanish at these places, because a variation of a path jumps there.

use super::graph::{Binary, FieldId, Graph, Node, NodeId, Unary};
use std::collections::{HashMap, HashSet};

/// A direction in input space: how fast each input changes. Inputs not named stand still.
#[derive(Debug, Clone, Default)]
pub struct Direction {
    rates: HashMap<NodeId, NodeId>,
}

impl Direction {
    /// The direction in which input node `.0` changes at rate `.1`, for each pair.
    pub fn new(seeds: impl IntoIterator<Item = (NodeId, NodeId)>) -> Self {
        Self {
            rates: seeds.into_iter().collect(),
        }
    }

    /// The direction in which input `index` alone changes, at rate 1.
    pub fn of_input(graph: &mut Graph, index: u32) -> Self {
        Self::new([(graph.input(index), graph.constant(1.0))])
    }
}

impl Graph {
    /// The rate of change of `root` along `direction`; results are kept in `direction`, so that
    /// many roots share them.
    pub fn derivative(&mut self, root: NodeId, direction: &mut Direction) -> NodeId {
        let mut pending = vec![root];
        while let Some(&id) = pending.last() {
            if direction.rates.contains_key(&id) {
                pending.pop();
                continue;
            }
            let missing: Vec<_> = self
                .node(id)
                .operands()
                .filter(|a| !direction.rates.contains_key(a))
                .collect();
            if missing.is_empty() {
                let mut rate = self.rate(id, &direction.rates);
                if let Some(base) = self.half_power_base(id) {
                    // The product rule makes 0 · ∞ of it where the base vanishes, as x² + y² + z² does at its minimum.
                    let zero = self.constant(0.0);
                    rate = self.select(base, rate, zero);
                }
                direction.rates.insert(id, rate);
                pending.pop();
            } else {
                pending.extend(missing);
            }
        }
        direction.rates[&root]
    }

    /// The gradient of `Σ weight root` over `inputs`, for pairs (root, weight), where the weights stand still.
    ///
    /// By reverse-mode differentiation, which takes about three times the operations of the roots however many inputs
    /// there are; where a branch is chosen by forward mode, because what is not chosen may not be finite there.
    pub fn gradient(&mut self, weighted: &[(NodeId, NodeId)], inputs: &[NodeId]) -> Vec<NodeId> {
        let roots: Vec<NodeId> = weighted.iter().map(|(root, _)| *root).collect();
        let reached = self.reached_from(&roots);
        let below = (0..reached.len()).filter(|id| reached[*id]);
        let below: Vec<NodeId> = below.map(|id| NodeId(id as u32)).collect();
        let chooses = |id: &NodeId| {
            let has_no_slope = self.half_power_base(*id).is_some() || self.vanishes(*id);
            self.node(*id).chooses() || has_no_slope
        };
        match below.iter().any(chooses) {
            true => self.forward_gradient(weighted, inputs),
            false => self.reverse_gradient(weighted, inputs, &below),
        }
    }

    /// By one derivative of each root for each input.
    fn forward_gradient(
        &mut self,
        weighted: &[(NodeId, NodeId)],
        inputs: &[NodeId],
    ) -> Vec<NodeId> {
        let one = self.constant(1.0);
        let (roots, weights): (Vec<NodeId>, Vec<NodeId>) = weighted.iter().copied().unzip();
        let along = |input: &NodeId| {
            let mut direction = Direction::new([(*input, one)]);
            let rates = roots.iter().map(|r| self.derivative(*r, &mut direction));
            let rates: Vec<NodeId> = rates.collect();
            self.dot(&weights, &rates)
        };
        inputs.iter().map(along).collect()
    }

    /// By the share that each node `below` the roots has in the sum, from the roots down to the inputs.
    fn reverse_gradient(
        &mut self,
        weighted: &[(NodeId, NodeId)],
        inputs: &[NodeId],
        below: &[NodeId],
    ) -> Vec<NodeId> {
        let mut shares: HashMap<NodeId, NodeId> = HashMap::new();
        for (root, weight) in weighted {
            self.add_share(&mut shares, *root, *weight);
        }
        for id in below.iter().rev() {
            let Some(&share) = shares.get(id) else {
                continue;
            };
            for (operand, part) in self.shares_of_operands(*id, share) {
                self.add_share(&mut shares, operand, part);
            }
        }
        let zero = self.constant(0.0);
        let found = inputs.iter().map(|input| shares.get(input).copied());
        found.map(|share| share.unwrap_or(zero)).collect()
    }

    fn add_share(&mut self, shares: &mut HashMap<NodeId, NodeId>, of: NodeId, part: NodeId) {
        let sum = match shares.get(&of) {
            Some(&known) => self.add(known, part),
            None => part,
        };
        shares.insert(of, sum);
    }

    /// What the operands of a node with this `share` get of it: the node's rate is linear in theirs, so each gets the
    /// rate that it would have if the operand changed at the rate `share` and the others stood still.
    fn shares_of_operands(&mut self, id: NodeId, share: NodeId) -> Vec<(NodeId, NodeId)> {
        let zero = self.constant(0.0);
        match self.node(id) {
            Node::Constant(_) | Node::Input(_) | Node::Select(..) => Vec::new(),
            Node::Unary(op, a) => vec![(a, self.unary_rate(op, id, a, share))],
            Node::Binary(op, a, b) => {
                let first = self.binary_rate(op, id, (a, share), (b, zero));
                let second = self.binary_rate(op, id, (a, zero), (b, share));
                vec![(a, first), (b, second)]
            }
            Node::Sample(field, orders, at) => {
                let part = |k: usize| {
                    let mut moving = [zero; 3];
                    moving[k] = share;
                    (at[k], self.sample_rate(field, orders, at, moving))
                };
                [0, 1, 2].map(part).to_vec()
            }
        }
    }

    fn rate(&mut self, id: NodeId, rates: &HashMap<NodeId, NodeId>) -> NodeId {
        match self.node(id) {
            Node::Constant(_) | Node::Input(_) => self.constant(0.0),
            Node::Unary(op, a) => {
                let da = rates[&a];
                if self.is(da, 0.0) {
                    return da;
                }
                self.unary_rate(op, id, a, da)
            }
            Node::Binary(op, a, b) => self.binary_rate(op, id, (a, rates[&a]), (b, rates[&b])),
            Node::Select(mask, yes, no) => self.select(mask, rates[&yes], rates[&no]),
            Node::Sample(field, orders, at) => {
                let moving = at.map(|a| rates[&a]);
                self.sample_rate(field, orders, at, moving)
            }
        }
    }

    /// The rate of `value = op(a)`, when `a` changes at rate `da`.
    fn unary_rate(&mut self, op: Unary, value: NodeId, a: NodeId, da: NodeId) -> NodeId {
        let one = self.constant(1.0);
        let slope = match op {
            Unary::Neg => return self.neg(da),
            Unary::Floor => return self.constant(0.0),
            Unary::Recip => {
                let square = self.mul(value, value);
                let slope = self.neg(square);
                if self.vanishes(value) {
                    let (rate, zero) = (self.mul(slope, da), self.constant(0.0));
                    return self.select(square, rate, zero);
                }
                slope
            }
            Unary::Sqrt => {
                let half = self.constant(0.5);
                self.div(half, value)
            }
            Unary::Abs => {
                let (zero, minus) = (self.constant(0.0), self.constant(-1.0));
                let negative = self.binary(Binary::Less, a, zero);
                self.select(negative, minus, one)
            }
            Unary::Exp => value,
            Unary::Log => self.recip(a),
            Unary::Sin => self.unary(Unary::Cos, a),
            Unary::Cos => {
                let sine = self.unary(Unary::Sin, a);
                self.neg(sine)
            }
            Unary::Tan => self.mul_add(value, value, one),
            Unary::Sinh => self.unary(Unary::Cosh, a),
            Unary::Cosh => self.unary(Unary::Sinh, a),
            Unary::Tanh => {
                let square = self.mul(value, value);
                self.sub(one, square)
            }
            Unary::Asin
            | Unary::Acos
            | Unary::Atan
            | Unary::Asinh
            | Unary::Acosh
            | Unary::Atanh => self.inverse_slope(op, a),
        };
        self.mul(slope, da)
    }

    /// The slope of the inverse circular and hyperbolic functions at `a`: ±1/√|1 ± a²| or 1/(1 ± a²).
    fn inverse_slope(&mut self, op: Unary, a: NodeId) -> NodeId {
        let one = self.constant(1.0);
        let square = self.mul(a, a);
        let radicand = match op {
            Unary::Asin | Unary::Acos | Unary::Atanh => self.sub(one, square),
            Unary::Acosh => self.sub(square, one),
            _ => self.add(one, square),
        };
        let slope = match op {
            Unary::Atan | Unary::Atanh => self.recip(radicand),
            _ => {
                let root = self.unary(Unary::Sqrt, radicand);
                self.recip(root)
            }
        };
        if op == Unary::Acos {
            self.neg(slope)
        } else {
            slope
        }
    }

    fn binary_rate(
        &mut self,
        op: Binary,
        value: NodeId,
        (a, da): (NodeId, NodeId),
        (b, db): (NodeId, NodeId),
    ) -> NodeId {
        match op {
            Binary::Add => self.add(da, db),
            Binary::Sub => self.sub(da, db),
            Binary::Mul => {
                let first = self.mul(da, b);
                self.mul_add(a, db, first)
            }
            Binary::Pow => self.power_rate(value, (a, da), (b, db)),
            Binary::Atan2 => {
                let (turn, back) = (self.mul(da, b), self.mul(a, db));
                let turn = self.sub(turn, back);
                let square = self.dot(&[a, b], &[a, b]);
                self.div(turn, square)
            }
            Binary::Min => {
                let mask = self.binary(Binary::Less, a, b);
                self.select(mask, da, db)
            }
            Binary::Max => {
                let mask = self.binary(Binary::Less, a, b);
                self.select(mask, db, da)
            }
            Binary::Less | Binary::LessEqual => self.constant(0.0),
        }
    }

    /// Ḟ = Σ_k ∂_k F ȧ_k
    fn sample_rate(
        &mut self,
        field: FieldId,
        orders: [u8; 3],
        at: [NodeId; 3],
        moving: [NodeId; 3],
    ) -> NodeId {
        let mut rate = self.constant(0.0);
        for k in 0..3 {
            if self.is(moving[k], 0.0) {
                continue;
            }
            let mut higher = orders;
            higher[k] = higher[k].saturating_add(1);
            let slope = self.sampled(field, higher, at);
            rate = self.mul_add(slope, moving[k], rate);
        }
        rate
    }

    /// (a^b)˙ = b a^(b−1) ȧ + a^b ln(a) ḃ
    fn power_rate(
        &mut self,
        value: NodeId,
        (a, da): (NodeId, NodeId),
        (b, db): (NodeId, NodeId),
    ) -> NodeId {
        let one = self.constant(1.0);
        let less = self.sub(b, one);
        let lower = self.pow(a, less);
        let by_base = self.mul(b, lower);
        let by_base = self.mul(by_base, da);
        if self.is(db, 0.0) {
            return by_base;
        }
        let log = self.unary(Unary::Log, a);
        let by_exponent = self.mul(value, log);
        self.mul_add(by_exponent, db, by_base)
    }

    /// Returns the switching functions of `roots`, each once: they vanish where `abs`, `min`, `max`, `if`,
    /// `floor` or `atan2` below those nodes change their branch (the argument of `abs`, the difference of what
    /// the others compare, the sine of π times the argument of `floor`, the first argument of `atan2`), and where what
    /// a function bounds has a pole (the denominator, the cosine of the argument of `tan`). Their signs mean nothing.
    pub fn switching_functions(&mut self, roots: &[NodeId]) -> Vec<NodeId> {
        self.switching_functions_of(roots, |_| true)
    }

    /// Returns those of the switching functions of `roots` at which values may jump, not only derivatives, and which depend on
    /// no inputs but the first `inputs`.
    pub fn jump_functions(&mut self, roots: &[NodeId], inputs: u32) -> Vec<NodeId> {
        let kinks = |node: &Node| {
            let binary = matches!(node, Node::Binary(Binary::Min | Binary::Max, ..));
            binary || matches!(node, Node::Unary(Unary::Abs, _))
        };
        let mut found = self.switching_functions_of(roots, |node| !kinks(node));
        found.retain(|function| {
            let below = self.below(&[*function]);
            !below
                .iter()
                .any(|node| matches!(node, Node::Input(k) if *k >= inputs))
        });
        found
    }

    fn switching_functions_of(
        &mut self,
        roots: &[NodeId],
        counts: impl Fn(&Node) -> bool,
    ) -> Vec<NodeId> {
        let mut found = Vec::new();
        let nodes = self.below(roots);
        let bounded = self.below_bounds(&nodes);
        for node in nodes.into_iter().filter(counts) {
            let function = match node {
                Node::Unary(Unary::Recip, a) if bounded.contains(&node) => a,
                Node::Unary(Unary::Tan, a) if bounded.contains(&node) => self.unary(Unary::Cos, a),
                Node::Unary(Unary::Abs, a) => a,
                Node::Binary(
                    Binary::Min | Binary::Max | Binary::Less | Binary::LessEqual,
                    a,
                    b,
                ) => self.sub(a.min(b), a.max(b)),
                // The cut lies at `a = 0` where `b < 0`; elsewhere on it nothing happens.
                Node::Binary(Binary::Atan2, a, _) => a,
                Node::Unary(Unary::Floor, a) => {
                    let pi = self.constant(std::f64::consts::PI);
                    let turns = self.mul(pi, a);
                    self.unary(Unary::Sin, turns)
                }
                _ => continue,
            };
            if !found.contains(&function) {
                found.push(function);
            }
        }
        found
    }

    /// Returns what functions among the `nodes` are of that have finite limits at one end or both: they hide a pole,
    /// where the limits of both sides differ.
    fn below_bounds(&self, nodes: &[Node]) -> HashSet<Node> {
        let argument = |node: &Node| match node {
            Node::Unary(Unary::Atan | Unary::Tanh | Unary::Exp, a) => Some(*a),
            _ => None,
        };
        let arguments: Vec<NodeId> = nodes.iter().filter_map(argument).collect();
        self.below(&arguments).into_iter().collect()
    }

    /// Returns all nodes that `roots` depend on, themselves included, the latest first.
    pub(super) fn below(&self, roots: &[NodeId]) -> Vec<Node> {
        let reached = self.reached_from(roots);
        let ids = (0..self.len()).rev().filter(|id| reached[*id]);
        ids.map(|id| self.node(NodeId(id as u32))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tape;

    #[test]
    fn each_switching_function_is_found_once_and_smooth_parts_have_none() {
        let mut graph = Graph::new();
        let (x, y) = (graph.input(0), graph.input(1));
        let least = graph.binary(Binary::Min, x, y);
        let most = graph.binary(Binary::Max, y, x);
        let size = graph.unary(Unary::Abs, x);
        let sine = graph.unary(Unary::Sin, y);
        let sum = graph.add(least, size);
        let difference = graph.sub(x, y);
        let found = graph.switching_functions(&[sum, most, sine]);
        assert_eq!(found.len(), 2);
        assert!(found.contains(&difference) && found.contains(&x));
        assert!(graph.switching_functions(&[sine]).is_empty());
        // Kinks are no jumps; and jumps count by the inputs of what decides.
        assert!(graph.jump_functions(&[sum, most, sine], 3).is_empty());
        let zero = graph.constant(0.0);
        let [before, behind] = [x, graph.input(3)].map(|a| graph.binary(Binary::Less, a, zero));
        let chosen = [before, behind].map(|condition| graph.select(condition, y, zero));
        assert_eq!(graph.switching_functions(&chosen).len(), 2);
        assert_eq!(graph.jump_functions(&chosen, 3).len(), 1);
        assert_eq!(graph.jump_functions(&chosen, 4).len(), 2);
    }

    #[test]
    fn poles_are_found_where_a_function_hides_them() {
        let mut graph = Graph::new();
        let (x, y) = (graph.input(0), graph.input(1));
        let steep = graph.quotient(y, x);
        let angle = graph.unary(Unary::Atan, steep);
        let tangent = graph.unary(Unary::Tan, y);
        let bounded = graph.unary(Unary::Tanh, tangent);
        let cosine = graph.unary(Unary::Cos, y);
        assert!(graph.switching_functions(&[steep, tangent]).is_empty());
        let found = graph.switching_functions(&[angle, bounded]);
        assert_eq!(found.len(), 2);
        assert!(found.contains(&x) && found.contains(&cosine));
    }

    #[test]
    fn quotients_have_slopes_where_their_denominators_grow_beyond_all_numbers() {
        // y / (1 + e^x)
        let mut graph = Graph::new();
        let inputs = [0, 1].map(|k| graph.input(k));
        let one = graph.constant(1.0);
        let grown = graph.unary(Unary::Exp, inputs[0]);
        let sum = graph.add(one, grown);
        let root = graph.quotient(inputs[1], sum);
        let gradient = graph.gradient(&[(root, one)], &inputs);
        let mut along = Direction::of_input(&mut graph, 0);
        let first = graph.derivative(root, &mut along);
        let second = graph.derivative(first, &mut along);
        let third = graph.derivative(second, &mut along);
        let outputs = [&gradient[..], &[first, second, third]].concat();
        let tape = Tape::compile(&graph, &outputs, 2).unwrap();
        let mut registers = tape.registers::<f64, 1>();
        for (x, logistic) in [
            (0.5_f64, 1.0 / (1.0 + 0.5_f64.exp())),
            (400.0, 0.0),
            (1e4, 0.0),
        ] {
            registers.input(0)[0] = x;
            registers.input(1)[0] = 3.0;
            tape.run(&mut registers);
            let p = logistic;
            let slope = -3.0 * p * (1.0 - p);
            let expected = [
                slope,
                p,
                slope,
                slope * (2.0 * p - 1.0),
                slope * (1.0 - 6.0 * p * (1.0 - p)),
            ];
            for (k, value) in expected.into_iter().enumerate() {
                let off = registers.output(k)[0] - value;
                assert!(off.abs() < 1e-14, "{k} at {x}: off by {off:e}");
            }
        }
    }

    #[test]
    fn half_integer_powers_have_slopes_where_their_base_vanishes() {
        // r³ and √(2x)⁵, whose derivatives are 3 r x and 5 √(2x)³, and 3 r + 3 x²/r and 15 √(2x), at 0 and elsewhere.
        let mut graph = Graph::new();
        let inputs = [0, 1].map(|k| graph.input(k));
        let (three, five) = (graph.constant(1.5), graph.constant(2.5));
        let square = graph.dot(&inputs, &inputs);
        let cube = graph.pow(square, three);
        let twice = graph.add(inputs[0], inputs[0]);
        let fifth = graph.pow(twice, five);
        let one = graph.constant(1.0);
        let [reverse, _] = graph.gradient(&[(cube, one)], &inputs)[..] else {
            panic!("two inputs")
        };
        let mut along = [0, 0].map(|k| Direction::of_input(&mut graph, k));
        let firsts = [cube, fifth].map(|root| graph.derivative(root, &mut along[0]));
        let seconds = firsts.map(|root| graph.derivative(root, &mut along[1]));
        let outputs = [&[reverse], &firsts[..], &seconds[..]].concat();
        let tape = Tape::compile(&graph, &outputs, 2).unwrap();
        for (x, expected) in [(0.0, [0.0; 5]), (2.0, [12.0, 12.0, 40.0, 12.0, 30.0])] {
            let mut registers = tape.registers::<f64, 1>();
            registers.input(0)[0] = x;
            registers.input(1)[0] = 0.0;
            tape.run(&mut registers);
            for (i, expected) in expected.into_iter().enumerate() {
                let found = registers.output(i)[0];
                assert!((found - expected).abs() < 1e-12, "{x}, {i}: {found}");
            }
        }
    }

    #[test]
    fn a_gradient_has_the_derivatives_along_the_axes() {
        let at = [0.7, -0.4, 1.3];
        for chosen in [false, true] {
            let mut graph = Graph::new();
            let inputs = [0, 1, 2].map(|k| graph.input(k));
            let [x, y, z] = inputs;
            // √(x² + z²) e^(x y), its square, z^x / that, atan2(y, |z|)
            let size = graph.dot(&[x, z], &[x, z]);
            let size = graph.unary(Unary::Sqrt, size);
            let product = graph.mul(x, y);
            let grown = graph.unary(Unary::Exp, product);
            let first = graph.mul(size, grown);
            let square = graph.mul(first, first);
            let power = graph.pow(z, x);
            let second = graph.div(power, square);
            let distance = graph.unary(Unary::Abs, z);
            let third = graph.binary(Binary::Atan2, y, distance);
            let last = match chosen {
                // The root is no number where the other branch is taken.
                true => {
                    let root = graph.unary(Unary::Sqrt, y);
                    let zero = graph.constant(0.0);
                    let mask = graph.binary(Binary::Less, zero, y);
                    graph.select(mask, root, third)
                }
                false => third,
            };
            let weighted = [(square, z), (second, y), (last, first)];
            let gradient = graph.gradient(&weighted, &inputs);
            let mut outputs = gradient.clone();
            for k in 0..3 {
                let mut axis = Direction::of_input(&mut graph, k);
                let rates = weighted.map(|(root, _)| graph.derivative(root, &mut axis));
                outputs.push(graph.dot(&weighted.map(|(_, weight)| weight), &rates));
            }
            let tape = Tape::compile(&graph, &outputs, 3).unwrap();
            let mut registers = tape.registers::<f64, 1>();
            for (k, x) in at.into_iter().enumerate() {
                registers.input(k)[0] = x;
            }
            tape.run(&mut registers);
            for k in 0..3 {
                let [reverse, forward] = [k, k + 3].map(|i| registers.output(i)[0]);
                assert!(
                    (reverse - forward).abs() <= 1e-13 * forward.abs(),
                    "{k}: {reverse} {forward}"
                );
                assert!(forward.abs() > 0.1);
            }
        }
    }
}
