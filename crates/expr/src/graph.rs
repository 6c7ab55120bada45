//! The expression graph: nodes shared by value, simplified as they are made.
//!
//! In: calls such as [`Graph::add`]. Out: [`NodeId`]s; operands always have smaller ids than the
//! node that uses them, so the id order is an evaluation order.
//!
//! Simplification keeps the value at every finite point but not the *cause* of a failure:
//! `0*x` is `0` even where `x` is infinite, and `a/b` is `a*(1/b)`, one rounding more, so that
//! divisions by the same thing are shared.

mod division;

use super::{real::Real, spline::Spline, tape::TapeTooLarge};
use std::{collections::HashMap, sync::Arc};

/// A node of a [`Graph`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(pub(super) u32);

/// A sampled field of a [`Graph`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FieldId(pub(super) u16);

/// Functions of one argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Unary {
    Neg,
    Recip,
    Sqrt,
    Abs,
    Floor,
    Exp,
    Log,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Sinh,
    Cosh,
    Tanh,
    Asinh,
    Acosh,
    Atanh,
}

/// Functions of two arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Binary {
    Add,
    Sub,
    Mul,
    Pow,
    Atan2,
    Min,
    Max,
    /// 1 where `a < b`, else 0.
    Less,
    /// 1 where `a <= b`, else 0.
    LessEqual,
}

/// A node of the graph: the operation it stands for, with its operands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Node {
    /// A number, by its bits so that it can be hashed.
    Constant(u64),
    /// The input with this index.
    Input(u32),
    /// A function of one node.
    Unary(Unary, NodeId),
    /// A function of two nodes.
    Binary(Binary, NodeId, NodeId),
    /// `if mask > 0 { yes } else { no }`, in the order mask, yes, no.
    Select(NodeId, NodeId, NodeId),
    /// The derivative of a field, of these orders along its axes, at a point.
    Sample(FieldId, [u8; 3], [NodeId; 3]),
}

impl Node {
    /// Tells whether it takes one of its operands and leaves another.
    pub(super) fn chooses(self) -> bool {
        matches!(
            self,
            Node::Select(..) | Node::Binary(Binary::Min | Binary::Max, ..)
        )
    }

    /// The operands, in order.
    pub fn operands(self) -> impl Iterator<Item = NodeId> {
        let all = match self {
            Node::Constant(_) | Node::Input(_) => [None; 3],
            Node::Unary(_, a) => [Some(a), None, None],
            Node::Binary(_, a, b) => [Some(a), Some(b), None],
            Node::Select(a, b, c) | Node::Sample(_, _, [a, b, c]) => [Some(a), Some(b), Some(c)],
        };
        all.into_iter().flatten()
    }
}

/// A hash-consed expression graph.
#[derive(Debug, Clone, Default)]
pub struct Graph {
    nodes: Vec<Node>,
    index: HashMap<Node, NodeId>,
    fields: Vec<Arc<Spline>>,
    /// What fields are asked for: the value, and the arguments before they are clamped.
    calls: Vec<(FieldId, NodeId, [NodeId; 3])>,
    /// The bases of the powers 3/2, 5/2 and so on: where those vanish, the product rule knows no slope.
    half_powers: HashMap<NodeId, NodeId>,
    /// Reciprocals of what may grow beyond all numbers, with that: there they vanish, and so do their slopes.
    vanishing: HashMap<NodeId, NodeId>,
}

impl Unary {
    /// The value of the function, by the same kernels that tapes use.
    #[inline(always)]
    pub fn apply<R: Real>(self, x: R) -> R {
        match self {
            Unary::Neg => -x,
            Unary::Recip => R::ONE / x,
            Unary::Sqrt => x.sqrt(),
            Unary::Abs => x.abs(),
            Unary::Floor => x.floor(),
            Unary::Exp => x.exp(),
            Unary::Log => x.ln(),
            Unary::Sin => x.sin(),
            Unary::Cos => x.cos(),
            Unary::Tan => x.tan(),
            Unary::Asin => x.asin(),
            Unary::Acos => x.acos(),
            Unary::Atan => x.atan(),
            Unary::Sinh => x.sinh(),
            Unary::Cosh => x.cosh(),
            Unary::Tanh => x.tanh(),
            Unary::Asinh => x.asinh(),
            Unary::Acosh => x.acosh(),
            Unary::Atanh => x.atanh(),
        }
    }
}

impl Binary {
    /// The value of the function, by the same kernels that tapes use.
    #[inline(always)]
    pub fn apply<R: Real>(self, a: R, b: R) -> R {
        match self {
            Binary::Add => a + b,
            Binary::Sub => a - b,
            Binary::Mul => a * b,
            Binary::Pow => a.pow(b),
            Binary::Atan2 => a.atan2(b),
            Binary::Min => a.min(b),
            Binary::Max => a.max(b),
            Binary::Less => R::select(a < b, R::ONE, R::ZERO),
            Binary::LessEqual => R::select(a <= b, R::ONE, R::ZERO),
        }
    }
}

/// Largest integer exponent that becomes multiplications; beyond it `pow` is as quick.
const MOST_MULTIPLIED_POWER: f64 = 32.0;

impl Graph {
    /// An empty graph.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the operation of `id` with its operands.
    pub fn node(&self, id: NodeId) -> Node {
        self.nodes[id.0 as usize]
    }

    /// For each node, whether `roots` depend on it; they depend on themselves.
    pub(super) fn reached_from(&self, roots: &[NodeId]) -> Vec<bool> {
        let mut reached = vec![false; self.nodes.len()];
        for root in roots {
            reached[root.0 as usize] = true;
        }
        for id in (0..reached.len()).rev() {
            if reached[id] {
                let operands = self.nodes[id].operands();
                operands.for_each(|a| reached[a.0 as usize] = true);
            }
        }
        reached
    }

    /// The number of nodes made so far.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Returns whether nothing has been made yet.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    fn intern(&mut self, node: Node) -> NodeId {
        *self.index.entry(node).or_insert_with(|| {
            self.nodes.push(node);
            NodeId(self.nodes.len() as u32 - 1)
        })
    }

    /// The number `value`.
    pub fn constant(&mut self, value: f64) -> NodeId {
        // One zero only: the graph treats -0 and 0 as the same number.
        let value = if value == 0.0 { 0.0 } else { value };
        self.intern(Node::Constant(value.to_bits()))
    }

    /// The input with index `index`.
    pub fn input(&mut self, index: u32) -> NodeId {
        self.intern(Node::Input(index))
    }

    /// The value of `id` if it is a constant.
    pub fn value(&self, id: NodeId) -> Option<f64> {
        match self.node(id) {
            Node::Constant(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// Returns whether `id` is the constant `value`.
    pub fn is(&self, id: NodeId, value: f64) -> bool {
        self.value(id) == Some(value)
    }

    fn negated(&self, id: NodeId) -> Option<NodeId> {
        match self.node(id) {
            Node::Unary(Unary::Neg, a) => Some(a),
            _ => None,
        }
    }

    /// `op(a)`.
    pub fn unary(&mut self, op: Unary, a: NodeId) -> NodeId {
        if let Some(x) = self.value(a) {
            return self.constant(op.apply(x));
        }
        match (op, self.node(a)) {
            (Unary::Neg, Node::Unary(Unary::Neg, x)) => x,
            (Unary::Neg, Node::Binary(Binary::Sub, x, y)) => self.sub(y, x),
            (Unary::Neg, Node::Binary(Binary::Mul, x, y)) if self.value(x).is_some() => {
                let x = self.neg(x);
                self.mul(x, y)
            }
            (Unary::Recip, Node::Unary(Unary::Recip, x)) => x,
            (Unary::Recip, Node::Unary(Unary::Neg, x)) => {
                let r = self.recip(x);
                self.neg(r)
            }
            (Unary::Abs, Node::Unary(Unary::Neg | Unary::Abs, x)) => self.unary(Unary::Abs, x),
            (Unary::Sqrt, Node::Binary(Binary::Mul, x, y)) if x == y => self.unary(Unary::Abs, x),
            _ => self.intern(Node::Unary(op, a)),
        }
    }

    /// `op(a, b)`.
    pub fn binary(&mut self, op: Binary, a: NodeId, b: NodeId) -> NodeId {
        match op {
            Binary::Add => self.add(a, b),
            Binary::Sub => self.sub(a, b),
            Binary::Mul => self.mul(a, b),
            Binary::Pow => self.pow(a, b),
            _ => self.plain_binary(op, a, b),
        }
    }

    fn plain_binary(&mut self, op: Binary, a: NodeId, b: NodeId) -> NodeId {
        match (self.value(a), self.value(b)) {
            (Some(x), Some(y)) => self.constant(op.apply(x, y)),
            _ => self.intern(Node::Binary(op, a, b)),
        }
    }

    fn commutative(&mut self, op: Binary, a: NodeId, b: NodeId) -> NodeId {
        // A constant goes first, so that products of constants meet.
        let swap = (self.value(b).is_some(), a) > (self.value(a).is_some(), b);
        let (a, b) = if swap { (b, a) } else { (a, b) };
        self.plain_binary(op, a, b)
    }

    /// `-a`.
    pub fn neg(&mut self, a: NodeId) -> NodeId {
        self.unary(Unary::Neg, a)
    }

    /// `1/a`.
    pub fn recip(&mut self, a: NodeId) -> NodeId {
        self.unary(Unary::Recip, a)
    }

    /// `a + b`.
    pub fn add(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if self.is(a, 0.0) {
            return b;
        }
        if self.is(b, 0.0) {
            return a;
        }
        if let Some(y) = self.negated(b) {
            return self.sub(a, y);
        }
        if let Some(x) = self.negated(a) {
            return self.sub(b, x);
        }
        if a == b {
            let two = self.constant(2.0);
            return self.mul(two, a);
        }
        if let Some((factor, x, y)) = self.common_factor(a, b) {
            let sum = self.add(x, y);
            return self.mul(factor, sum);
        }
        self.commutative(Binary::Add, a, b)
    }

    /// (c, x, y) if `a` is `c x` and `b` is `c y` with the same number `c`: derivatives of squares
    /// are full of them, and taken out of a sum they meet other numbers.
    fn common_factor(&self, a: NodeId, b: NodeId) -> Option<(NodeId, NodeId, NodeId)> {
        match (self.node(a), self.node(b)) {
            (Node::Binary(Binary::Mul, c, x), Node::Binary(Binary::Mul, d, y))
                if c == d && self.value(c).is_some() =>
            {
                Some((c, x, y))
            }
            _ => None,
        }
    }

    /// `a - b`.
    pub fn sub(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if self.is(b, 0.0) {
            return a;
        }
        if self.is(a, 0.0) {
            return self.neg(b);
        }
        if a == b {
            return self.constant(0.0);
        }
        if let Some(y) = self.negated(b) {
            return self.add(a, y);
        }
        if let Some(x) = self.negated(a) {
            let sum = self.add(x, b);
            return self.neg(sum);
        }
        if let Some((factor, x, y)) = self.common_factor(a, b) {
            let difference = self.sub(x, y);
            return self.mul(factor, difference);
        }
        self.plain_binary(Binary::Sub, a, b)
    }

    /// `a b`.
    pub fn mul(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if self.is(a, 0.0) || self.is(b, 0.0) {
            return self.constant(0.0);
        }
        for (one, other) in [(a, b), (b, a)] {
            if self.is(one, 1.0) {
                return other;
            }
            if self.is(one, -1.0) {
                return self.neg(other);
            }
        }
        if let Some(product) = self.signed_product(a, b) {
            return product;
        }
        for (factor, product) in [(a, b), (b, a)] {
            if let (Some(c), Node::Binary(Binary::Mul, inner, rest)) =
                (self.value(factor), self.node(product))
                && let Some(d) = self.value(inner)
            {
                let cd = self.constant(c * d);
                return self.mul(cd, rest);
            }
        }
        if a == b
            && let Node::Unary(Unary::Sqrt, x) = self.node(a)
        {
            return x;
        }
        self.commutative(Binary::Mul, a, b)
    }

    /// Pulls signs out of a product, so that products equal up to sign are shared.
    fn signed_product(&mut self, a: NodeId, b: NodeId) -> Option<NodeId> {
        match (self.negated(a), self.negated(b)) {
            (Some(x), Some(y)) => Some(self.mul(x, y)),
            (Some(x), None) => {
                let product = self.mul(x, b);
                Some(self.neg(product))
            }
            (None, Some(y)) => {
                let product = self.mul(a, y);
                Some(self.neg(product))
            }
            (None, None) => None,
        }
    }

    /// `a / b`.
    pub fn div(&mut self, a: NodeId, b: NodeId) -> NodeId {
        if let (Some(x), Some(y)) = (self.value(a), self.value(b)) {
            return self.constant(x / y);
        }
        if a == b {
            return self.constant(1.0);
        }
        let r = self.recip(b);
        self.mul(a, r)
    }

    /// `a b + c`, with zeros and ones taken out.
    pub fn mul_add(&mut self, a: NodeId, b: NodeId, c: NodeId) -> NodeId {
        let ab = self.mul(a, b);
        self.add(ab, c)
    }

    /// `a₀ b₀ + a₁ b₁ + …`
    pub fn dot(&mut self, a: &[NodeId], b: &[NodeId]) -> NodeId {
        let zero = self.constant(0.0);
        a.iter()
            .zip(b)
            .fold(zero, |sum, (&x, &y)| self.mul_add(x, y, sum))
    }

    /// `a × b`
    pub fn cross(&mut self, a: [NodeId; 3], b: [NodeId; 3]) -> [NodeId; 3] {
        [(1, 2), (2, 0), (0, 1)].map(|(i, j)| {
            let (forth, back) = (self.mul(a[i], b[j]), self.mul(a[j], b[i]));
            self.sub(forth, back)
        })
    }

    /// `a^n` for an integer `n`, by squaring.
    pub fn powi(&mut self, a: NodeId, n: i32) -> NodeId {
        let mut result = self.constant(1.0);
        let mut square = a;
        let mut left = n.unsigned_abs();
        while left > 0 {
            if left & 1 == 1 {
                result = self.mul(result, square);
            }
            left >>= 1;
            if left > 0 {
                square = self.mul(square, square);
            }
        }
        if n < 0 { self.recip(result) } else { result }
    }

    /// `a^b`; integer and half-integer exponents become products and square roots, a positive
    /// constant base an exponential.
    pub fn pow(&mut self, a: NodeId, b: NodeId) -> NodeId {
        match (self.value(a), self.value(b)) {
            (Some(x), Some(y)) => self.constant(Real::pow(x, y)),
            (_, Some(n)) if n.fract() == 0.0 && n.abs() <= MOST_MULTIPLIED_POWER => {
                self.powi(a, n as i32)
            }
            (_, Some(n)) if n.fract().abs() == 0.5 && n.abs() <= MOST_MULTIPLIED_POWER => {
                let whole = self.powi(a, n.floor() as i32);
                let root = self.unary(Unary::Sqrt, a);
                let power = self.mul(whole, root);
                if n > 1.0 {
                    self.half_powers.insert(power, a);
                }
                power
            }
            (Some(base), None) if base > 0.0 => {
                let log = self.constant(base.ln());
                let exponent = self.mul(log, b);
                self.unary(Unary::Exp, exponent)
            }
            _ => self.intern(Node::Binary(Binary::Pow, a, b)),
        }
    }

    /// Returns the base, where it is the power 3/2, 5/2 and so on of one.
    pub(super) fn half_power_base(&self, id: NodeId) -> Option<NodeId> {
        self.half_powers.get(&id).copied()
    }

    /// `if mask > 0 { yes } else { no }`.
    pub fn select(&mut self, mask: NodeId, yes: NodeId, no: NodeId) -> NodeId {
        if yes == no {
            return yes;
        }
        match self.value(mask) {
            Some(m) if m > 0.0 => yes,
            Some(_) => no,
            None => self.intern(Node::Select(mask, yes, no)),
        }
    }

    /// Adds a sampled field.
    ///
    /// # Errors
    /// There are too many.
    pub fn add_field(&mut self, spline: Arc<Spline>) -> Result<FieldId, TapeTooLarge> {
        let id = u16::try_from(self.fields.len()).map_err(|_| TapeTooLarge::Fields)?;
        self.fields.push(spline);
        Ok(FieldId(id))
    }

    /// Returns the spline of a field.
    pub fn field(&self, id: FieldId) -> &Arc<Spline> {
        &self.fields[usize::from(id.0)]
    }

    /// The value of a field at a point; outside its grid that of the nearest point of the grid.
    pub fn sample(&mut self, id: FieldId, at: [NodeId; 3]) -> NodeId {
        let axes = *self.field(id).axes();
        let mut inside = at;
        for k in 0..3 {
            let [low, high] = axes[k].limits.map(|x| self.constant(x));
            inside[k] = match (axes[k].samples, axes[k].periodic) {
                (1, _) => low,
                (_, true) => at[k],
                (_, false) => self.clamped(at[k], low, high),
            };
        }
        let value = self.sampled(id, [0; 3], inside);
        if !self.calls.contains(&(id, value, at)) {
            self.calls.push((id, value, at));
        }
        value
    }

    /// `a` between two numbers. Not by minimum and maximum, which would hide a NaN; at the limits the
    /// derivative is that of `a`.
    fn clamped(&mut self, a: NodeId, low: NodeId, high: NodeId) -> NodeId {
        let above = self.binary(Binary::Less, high, a);
        let below = self.binary(Binary::Less, a, low);
        let inner = self.select(above, high, a);
        self.select(below, low, inner)
    }

    /// The derivative of a field, of these orders along its axes, at a point of its grid.
    pub(super) fn sampled(&mut self, id: FieldId, orders: [u8; 3], at: [NodeId; 3]) -> NodeId {
        let spline = self.field(id).clone();
        if spline.vanishes(orders) {
            return self.constant(0.0);
        }
        match at.map(|a| self.value(a)) {
            [Some(x), Some(y), Some(z)] => self.constant(spline.derivative(orders, [x, y, z])),
            _ => self.intern(Node::Sample(id, orders, at)),
        }
    }

    /// Returns the calls of fields that `roots` depend on: the field, and its arguments as they were given.
    pub fn calls_below(&self, roots: &[NodeId]) -> Vec<(FieldId, [NodeId; 3])> {
        let reached = self.reached_from(roots);
        let calls = self.calls.iter();
        calls
            .filter(|(_, value, _)| reached[value.0 as usize])
            .map(|(id, _, at)| (*id, *at))
            .collect()
    }

    /// Returns the fields that `roots` depend on, each with the highest order along one axis in which it is
    /// differentiated for them.
    pub fn fields_below(&self, roots: &[NodeId]) -> Vec<(FieldId, u8)> {
        let reached = self.reached_from(roots);
        let mut found: Vec<(FieldId, u8)> = Vec::new();
        for node in self.nodes.iter().zip(reached).filter(|n| n.1).map(|n| n.0) {
            let Node::Sample(id, orders, _) = node else {
                continue;
            };
            let order = orders.iter().copied().max().unwrap_or(0);
            match found.iter_mut().find(|(known, _)| known == id) {
                Some((_, highest)) => *highest = order.max(*highest),
                None => found.push((*id, order)),
            }
        }
        found
    }
}
