//! Graph -> instructions: sums of products are fused, and registers used again.
//!
//! In: a graph and the nodes wanted. Out: a [`Tape`].

use super::{
    FieldLookup, Instruction, MOST_OPERANDS, MOST_REGISTERS, Operation, Tape, TapeTooLarge,
};
use crate::{
    graph::{Binary, FieldId, Graph, Node, NodeId},
    spline::SplineEvaluator,
};
use std::collections::HashMap;

/// An operation with its operands.
type Fused = (Operation, Vec<NodeId>);

/// Chooses instructions and registers: inputs first, then constants, then scratch that is reused
/// after a value's last use.
pub struct Compiler<'g> {
    graph: &'g Graph,
    reached: Vec<bool>,
    uses: Vec<u32>,
    register: Vec<u16>,
    free: Vec<u16>,
    next: usize,
    fields: Vec<FieldLookup>,
}

/// The nodes wanted of each field at each point: one instruction computes them.
type FieldPoints = HashMap<(FieldId, [NodeId; 3]), Vec<usize>>;

impl<'g> Compiler<'g> {
    /// For the nodes `outputs` of `graph`, whose inputs are numbered below `inputs`.
    pub fn new(graph: &'g Graph, outputs: &[NodeId], inputs: usize) -> Self {
        let reached = graph.reached_from(outputs);
        let mut compiler = Self {
            graph,
            reached,
            uses: vec![0; graph.len()],
            register: vec![0; graph.len()],
            free: Vec::new(),
            next: inputs,
            fields: Vec::new(),
        };
        for output in outputs {
            compiler.uses[output.0 as usize] += 1;
        }
        for id in 0..graph.len() {
            if compiler.reached[id] {
                for operand in graph.node(NodeId(id as u32)).operands() {
                    compiler.uses[operand.0 as usize] += 1;
                }
            }
        }
        compiler
    }

    /// The tape that computes `outputs`, and of them those in `first` before all others.
    pub fn compile(mut self, first: &[NodeId], outputs: &[NodeId]) -> Result<Tape, TapeTooLarge> {
        let inputs = self.next;
        let constants = self.place_leaves()?;
        let mut fused = self.fuse();
        let mut points = self.field_points();
        let first = self.graph.reached_from(first);
        let mut parts = [const { Vec::new() }; 2];
        for (part, wanted) in parts.iter_mut().zip([true, false]) {
            for id in 0..self.graph.len() {
                if !self.reached[id] || first[id] != wanted || self.is_leaf(id) || fused[id].1 {
                    continue;
                }
                match self.graph.node(NodeId(id as u32)) {
                    // Taken out by the first of its nodes, with all others.
                    Node::Sample(field, _, at) => {
                        let nodes = points.remove(&(field, at));
                        let nodes = nodes.map(|nodes| self.lookup(field, at, &nodes));
                        part.extend(nodes.transpose()?);
                    }
                    _ => part.push(self.instruction(id, fused[id].0.take())?),
                }
            }
        }
        Ok(Tape {
            first: parts[0].len(),
            code: parts.concat(),
            fields: std::mem::take(&mut self.fields),
            constants,
            outputs: outputs
                .iter()
                .map(|o| self.register[o.0 as usize])
                .collect(),
            inputs,
            read: self.inputs_read(inputs),
            registers: self.next,
        })
    }

    fn fresh(&mut self) -> Result<u16, TapeTooLarge> {
        if self.next >= MOST_REGISTERS {
            return Err(TapeTooLarge::Values);
        }
        self.next += 1;
        Ok(self.next as u16 - 1)
    }

    fn place_leaves(&mut self) -> Result<Vec<(u16, f64)>, TapeTooLarge> {
        let mut constants = Vec::new();
        for id in 0..self.graph.len() {
            match self.graph.node(NodeId(id as u32)) {
                Node::Input(index) => self.register[id] = index as u16,
                Node::Constant(bits) if self.reached[id] => {
                    self.register[id] = self.fresh()?;
                    constants.push((self.register[id], f64::from_bits(bits)));
                }
                _ => {}
            }
        }
        Ok(constants)
    }

    /// For each node, what is computed in its place, and whether it is absorbed by another. A product
    /// used once, by a sum, is computed inside the sum's instruction, and so is a short sum of
    /// products used once, by another.
    fn fuse(&self) -> Vec<(Option<Fused>, bool)> {
        let mut fused = vec![(None, false); self.graph.len()];
        for id in 0..self.graph.len() {
            if !self.reached[id] {
                continue;
            }
            let Some((op, product, rest)) = self.sum_with_product(NodeId(id as u32)) else {
                continue;
            };
            let inner = match self.used_once(rest) {
                true => fused[rest.0 as usize].0.as_ref(),
                false => None,
            };
            let whole = match self.used_once(rest) {
                true => self.longer(op, rest, inner),
                false => None,
            };
            let (operation, mut operands) = match whole {
                Some(longer) => {
                    fused[rest.0 as usize].1 = true;
                    longer
                }
                None => match op {
                    Binary::Sub => (Operation::NegMulAdd, vec![]),
                    _ => (Operation::MulAdd, vec![]),
                },
            };
            let alone = operands.is_empty();
            operands.extend(self.graph.node(product).operands());
            if alone {
                operands.push(rest);
            }
            fused[product.0 as usize].1 = true;
            fused[id].0 = Some((operation, operands));
        }
        fused
    }

    /// A sum or difference with a product that it alone uses: (operation, product, the other term).
    fn sum_with_product(&self, id: NodeId) -> Option<(Binary, NodeId, NodeId)> {
        let pairs = match self.graph.node(id) {
            Node::Binary(Binary::Add, a, b) => [Some((b, a)), Some((a, b))],
            Node::Binary(Binary::Sub, a, b) => [Some((b, a)), None],
            _ => return None,
        };
        let op = match self.graph.node(id) {
            Node::Binary(op, ..) => op,
            _ => return None,
        };
        let mut pairs = pairs.into_iter().flatten();
        let (product, rest) = pairs.find(|(p, _)| self.is_product(*p) && self.used_once(*p))?;
        Some((op, product, rest))
    }

    fn inputs_read(&self, inputs: usize) -> Vec<bool> {
        let mut read = vec![false; inputs];
        for id in (0..self.graph.len()).filter(|id| self.reached[*id]) {
            if let Node::Input(index) = self.graph.node(NodeId(id as u32)) {
                read[index as usize] = true;
            }
        }
        read
    }

    fn is_leaf(&self, id: usize) -> bool {
        let node = self.graph.node(NodeId(id as u32));
        matches!(node, Node::Constant(_) | Node::Input(_))
    }

    fn is_product(&self, id: NodeId) -> bool {
        matches!(self.graph.node(id), Node::Binary(Binary::Mul, ..))
    }

    fn used_once(&self, id: NodeId) -> bool {
        self.uses[id.0 as usize] == 1
    }

    /// The operation that adds (or subtracts) one more product to `rest`, which may be `inner`
    /// itself, with the operands of `rest`.
    fn longer(&self, op: Binary, rest: NodeId, inner: Option<&Fused>) -> Option<Fused> {
        match (op, inner) {
            (Binary::Add, None) if self.is_product(rest) => {
                let operands = self.graph.node(rest).operands().collect();
                Some((Operation::DotOfTwo, operands))
            }
            (Binary::Add, Some((Operation::MulAdd, operands))) => {
                Some((Operation::MulAddTwice, operands.clone()))
            }
            (Binary::Add, Some((Operation::DotOfTwo, operands))) => {
                Some((Operation::DotOfThree, operands.clone()))
            }
            (Binary::Sub, Some((Operation::NegMulAdd, operands))) => {
                Some((Operation::NegMulAddTwice, operands.clone()))
            }
            _ => None,
        }
    }

    fn field_points(&self) -> FieldPoints {
        let mut points = FieldPoints::new();
        for id in (0..self.graph.len()).filter(|id| self.reached[*id]) {
            if let Node::Sample(field, _, at) = self.graph.node(NodeId(id as u32)) {
                points.entry((field, at)).or_default().push(id);
            }
        }
        points
    }

    /// The instruction that computes `nodes`, derivatives of a field at one point.
    fn lookup(
        &mut self,
        field: FieldId,
        at: [NodeId; 3],
        nodes: &[usize],
    ) -> Result<Instruction, TapeTooLarge> {
        let mut operands = [0; MOST_OPERANDS];
        for (operand, node) in operands.iter_mut().zip(at) {
            *operand = self.register[node.0 as usize];
        }
        operands[3] = u16::try_from(self.fields.len()).map_err(|_| TapeTooLarge::Values)?;
        let (mut orders, mut to) = (Vec::new(), Vec::new());
        for id in nodes {
            if let Node::Sample(_, these, _) = self.graph.node(NodeId(*id as u32)) {
                orders.push(these);
            }
            at.iter().for_each(|node| self.release(*node));
        }
        for id in nodes {
            let register = match self.free.pop() {
                Some(register) => register,
                None => self.fresh()?,
            };
            self.register[*id] = register;
            to.push(register);
        }
        self.fields.push(FieldLookup {
            evaluator: SplineEvaluator::new(self.graph.field(field).clone(), orders),
            to,
        });
        Ok(Instruction {
            operation: Operation::Sample,
            to: self.fields[self.fields.len() - 1].to[0],
            operands,
        })
    }

    fn instruction(
        &mut self,
        id: usize,
        fused: Option<Fused>,
    ) -> Result<Instruction, TapeTooLarge> {
        let node = self.graph.node(NodeId(id as u32));
        let (operation, nodes) = fused.unwrap_or_else(|| {
            let operation = match node {
                Node::Unary(op, _) => op.into(),
                Node::Binary(op, ..) => op.into(),
                _ => Operation::Select,
            };
            (operation, node.operands().collect())
        });
        let mut operands = [0; MOST_OPERANDS];
        for (operand, node) in operands.iter_mut().zip(&nodes) {
            *operand = self.register[node.0 as usize];
        }
        for node in &nodes {
            self.release(*node);
        }
        let to = match self.free.pop() {
            Some(register) => register,
            None => self.fresh()?,
        };
        self.register[id] = to;
        Ok(Instruction {
            operation,
            to,
            operands,
        })
    }

    /// Counts one use of `id` as done and frees its register after the last.
    fn release(&mut self, id: NodeId) {
        let at = id.0 as usize;
        self.uses[at] -= 1;
        if self.uses[at] == 0 && !self.is_leaf(at) {
            self.free.push(self.register[at]);
        }
    }
}
