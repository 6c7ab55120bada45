//! Graph -> straight-line tape, run over lanes of rays.
//!
//! In: a graph and the nodes wanted. Out: a [`Tape`] whose instructions read and write registers of
//! `W` lanes; every instruction is one short loop over the lanes, which the compiler turns into
//! vector code under [`vectorised`]. Arithmetic is `+ - * /` and the kernels of [`super::real`]
//! in a fixed order, so results are the same bits on every machine.

use super::{
    graph::{Binary, Graph, Node, NodeId, Unary},
    real::Real,
};
use fearless_simd::{Level, Simd, dispatch};
use std::ops::{Deref, DerefMut};

/// Runs `work` with the widest vector instructions this machine has. `work` and what it calls must
/// be `#[inline(always)]` to profit.
#[inline]
pub fn vectorised<T>(work: impl FnOnce() -> T) -> T {
    dispatch!(Level::new(), simd => simd.vectorize(work))
}

/// The operations of instructions, the interpreter's arm for each, and those of graph nodes: one list.
macro_rules! operations {
    (unary [$($unary:ident)*] binary [$($binary:ident)*] own [$($own:ident ($($operand:ident)*) $value:expr;)*]) => {
        /// What an instruction does with its operands.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        enum Operation {
            $($unary,)* $($binary,)* $($own,)*
        }

        impl From<Unary> for Operation {
            fn from(op: Unary) -> Self {
                match op { $(Unary::$unary => Self::$unary),* }
            }
        }

        impl From<Binary> for Operation {
            fn from(op: Binary) -> Self {
                match op { $(Binary::$binary => Self::$binary),* }
            }
        }

        /// Carries out one instruction. Every arm is a loop of its own over the lanes.
        #[inline(always)]
        fn carry_out<R: Real, const W: usize>(r: &mut [Wide<R, W>], i: &Instruction) {
            match i.operation {
                $(Operation::$unary => apply(r, i, #[inline(always)] |[x]| Unary::$unary.apply(x)),)*
                $(Operation::$binary => apply(r, i, #[inline(always)] |[x, y]| Binary::$binary.apply(x, y)),)*
                $(Operation::$own => apply(r, i, #[inline(always)] |[$($operand),*]| $value),)*
            }
        }
    };
}

// Sums of products are operations of their own, rounded after every multiplication and addition:
// that saves the dispatch of an instruction, and a store and a load of every lane.
operations! {
    unary [Neg Recip Sqrt Abs Floor Exp Log Sin Cos Tan Asin Acos Atan Sinh Cosh Tanh Asinh Acosh Atanh]
    binary [Add Sub Mul Pow Atan2 Min Max Less LessEqual]
    own [
        MulAdd(a b c) a * b + c;
        NegMulAdd(a b c) c - a * b;
        MulAddTwice(a b c d e) (a * b + c) + d * e;
        NegMulAddTwice(a b c d e) (c - a * b) - d * e;
        DotOfTwo(a b c d) a * b + c * d;
        DotOfThree(a b c d e f) (a * b + c * d) + e * f;
        Select(a b c) R::select(a > R::ZERO, b, c);
    ]
}

impl Operation {
    fn is_transcendental(self) -> bool {
        use Operation::{
            Acos, Acosh, Asin, Asinh, Atan, Atan2, Atanh, Cos, Cosh, Exp, Log, Pow, Sin, Sinh, Tan,
            Tanh,
        };
        let circular = matches!(self, Sin | Cos | Tan | Asin | Acos | Atan | Atan2);
        let hyperbolic = matches!(self, Sinh | Cosh | Tanh | Asinh | Acosh | Atanh);
        circular || hyperbolic || matches!(self, Exp | Log | Pow)
    }

    /// How many multiplications and additions (or other single steps) it takes.
    fn arithmetic(self) -> usize {
        match self {
            Self::MulAdd | Self::NegMulAdd => 2,
            Self::DotOfTwo => 3,
            Self::MulAddTwice | Self::NegMulAddTwice => 4,
            Self::DotOfThree => 5,
            _ => 1,
        }
    }
}

/// Most operands of an instruction.
const MOST_OPERANDS: usize = 6;

#[derive(Debug, Clone, Copy)]
struct Instruction {
    operation: Operation,
    to: u16,
    operands: [u16; MOST_OPERANDS],
}

/// A compiled set of expressions.
#[derive(Debug, Clone)]
pub struct Tape {
    code: Vec<Instruction>,
    /// How many instructions of the code [`Tape::run_first`] carries out.
    first: usize,
    constants: Vec<(u16, f64)>,
    outputs: Vec<u16>,
    inputs: usize,
    /// For each input, whether anything depends on it.
    read: Vec<bool>,
    registers: usize,
}

/// `W` lanes on a boundary of the widest vectors: a vector that straddles two lines of the cache
/// takes two loads.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Wide<R, const W: usize>(pub [R; W]);

impl<R, const W: usize> Deref for Wide<R, W> {
    type Target = [R; W];

    #[inline(always)]
    fn deref(&self) -> &[R; W] {
        &self.0
    }
}

impl<R, const W: usize> DerefMut for Wide<R, W> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [R; W] {
        &mut self.0
    }
}

/// The registers of one tape at work: `W` lanes of each.
#[derive(Debug, Clone)]
pub struct Registers<R, const W: usize> {
    values: Vec<Wide<R, W>>,
    inputs: usize,
    outputs: Vec<u16>,
}

impl<R: Real, const W: usize> Registers<R, W> {
    /// The lanes of input `index`, to be set before a run; runs leave them as they are.
    #[inline(always)]
    pub fn input(&mut self, index: usize) -> &mut [R; W] {
        debug_assert!(index < self.inputs);
        &mut self.values[index]
    }

    /// The lanes of output `index`, after a run.
    #[inline(always)]
    pub fn output(&self, index: usize) -> &[R; W] {
        &self.values[self.outputs[index] as usize]
    }
}

/// The most registers a tape may have: their numbers are 16 bits wide.
const MOST_REGISTERS: usize = u16::MAX as usize;

/// The tape would need more registers than there are; the expressions are too large.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the expressions need more than {MOST_REGISTERS} intermediate values at once")]
pub struct TapeTooLarge;

impl Tape {
    /// Compiles `outputs` of `graph`, whose inputs are numbered below `inputs`.
    pub fn compile(graph: &Graph, outputs: &[NodeId], inputs: usize) -> Result<Self, TapeTooLarge> {
        Self::compile_parts(graph, outputs, &[], inputs)
    }

    /// Compiles the outputs `first` and then `rest`, which need not be computed together: see
    /// [`Tape::run_first`].
    pub fn compile_parts(
        graph: &Graph,
        first: &[NodeId],
        rest: &[NodeId],
        inputs: usize,
    ) -> Result<Self, TapeTooLarge> {
        let outputs = [first, rest].concat();
        Compiler::new(graph, &outputs, inputs).compile(first, &outputs)
    }

    /// How many operations one run costs: (arithmetic, transcendental). A sum of products counts as
    /// many as it has multiplications and additions.
    pub fn operations(&self) -> (usize, usize) {
        self.code.iter().fold((0, 0), |(plain, heavy), i| {
            match i.operation.is_transcendental() {
                true => (plain, heavy + 1),
                false => (plain + i.operation.arithmetic(), heavy),
            }
        })
    }

    /// How many outputs there are.
    pub fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Whether anything depends on the input `index`.
    pub fn reads(&self, index: usize) -> bool {
        self.read[index]
    }

    /// Registers for this tape, constants set.
    pub fn registers<R: Real, const W: usize>(&self) -> Registers<R, W> {
        let mut values = vec![Wide([R::ZERO; W]); self.registers];
        for &(register, value) in &self.constants {
            values[register as usize] = Wide([R::from_f64(value); W]);
        }
        Registers {
            values,
            inputs: self.inputs,
            outputs: self.outputs.clone(),
        }
    }

    /// Computes all outputs from the inputs in `registers` (which must be of this tape), with the
    /// widest vector instructions there are.
    pub fn run<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        interpret(&self.code, registers);
    }

    /// [`Tape::run`] for the first part of the outputs only.
    pub fn run_first<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        interpret(&self.code[..self.first], registers);
    }

    /// Computes the rest of the outputs after [`Tape::run_first`], for the same inputs.
    pub fn run_rest<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        interpret(&self.code[self.first..], registers);
    }

    /// The outputs at one point, in double precision.
    pub fn at(&self, inputs: &[f64]) -> Vec<f64> {
        let mut registers = self.registers::<f64, 1>();
        for (i, &value) in inputs.iter().enumerate() {
            *registers.input(i) = [value];
        }
        self.run(&mut registers);
        (0..self.outputs())
            .map(|k| registers.output(k)[0])
            .collect()
    }
}

// Not inlined: one copy of the interpreter for each kind of number and of machine is large enough,
// and a call costs nothing against a tape.
#[inline(never)]
fn interpret<R: Real, const W: usize>(code: &[Instruction], registers: &mut Registers<R, W>) {
    vectorised(
        #[inline(always)]
        || {
            let r = registers.values.as_mut_slice();
            for i in code {
                carry_out(r, i);
            }
        },
    );
}

/// `to = f(operands)` in every lane.
#[inline(always)]
fn apply<R: Real, const W: usize, const N: usize>(
    r: &mut [Wide<R, W>],
    i: &Instruction,
    f: impl Fn([R; N]) -> R,
) {
    match const { lanes_in_a_vector::<R>(W) } {
        8 => apply_by::<R, W, N, 8>(r, i, f),
        16 => apply_by::<R, W, N, 16>(r, i, f),
        _ => apply_by::<R, W, N, 1>(r, i, f),
    }
}

/// How many of `lanes` fill a vector of 64 bytes; 1 if they do not fill whole ones.
const fn lanes_in_a_vector<R>(lanes: usize) -> usize {
    let fit = 64 / size_of::<R>();
    if lanes.is_multiple_of(fit) { fit } else { 1 }
}

/// [`apply`], `C` lanes at a time.
// A vector at a time goes through a local array, which the compiler keeps in a vector register;
// written straight into the registers, which might overlap the operands, or through an array of all
// lanes, which goes to memory and back, the loops are slower.
#[inline(always)]
fn apply_by<R: Real, const W: usize, const N: usize, const C: usize>(
    r: &mut [Wide<R, W>],
    i: &Instruction,
    f: impl Fn([R; N]) -> R,
) {
    for first in (0..W).step_by(C) {
        let mut operands = [[R::ZERO; C]; N];
        for k in 0..N {
            operands[k].copy_from_slice(&r[i.operands[k] as usize][first..first + C]);
        }
        let mut result = [R::ZERO; C];
        for lane in 0..C {
            let mut arguments = [R::ZERO; N];
            for k in 0..N {
                arguments[k] = operands[k][lane];
            }
            result[lane] = f(arguments);
        }
        r[i.to as usize][first..first + C].copy_from_slice(&result);
    }
}

/// An operation with its operands.
type Fused = (Operation, Vec<NodeId>);

/// Chooses instructions and registers: inputs first, then constants, then scratch that is reused
/// after a value's last use.
struct Compiler<'g> {
    graph: &'g Graph,
    reached: Vec<bool>,
    uses: Vec<u32>,
    register: Vec<u16>,
    free: Vec<u16>,
    next: usize,
}

impl<'g> Compiler<'g> {
    fn new(graph: &'g Graph, outputs: &[NodeId], inputs: usize) -> Self {
        let reached = graph.reached_from(outputs);
        let mut compiler = Self {
            graph,
            reached,
            uses: vec![0; graph.len()],
            register: vec![0; graph.len()],
            free: Vec::new(),
            next: inputs,
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

    fn compile(mut self, first: &[NodeId], outputs: &[NodeId]) -> Result<Tape, TapeTooLarge> {
        let inputs = self.next;
        let constants = self.place_leaves()?;
        let mut fused = self.fuse();
        let first = self.graph.reached_from(first);
        let mut parts = [const { Vec::new() }; 2];
        for (part, wanted) in parts.iter_mut().zip([true, false]) {
            for id in 0..self.graph.len() {
                if self.reached[id] && first[id] == wanted && !self.is_leaf(id) && !fused[id].1 {
                    part.push(self.instruction(id, fused[id].0.take())?);
                }
            }
        }
        Ok(Tape {
            first: parts[0].len(),
            code: parts.concat(),
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
            return Err(TapeTooLarge);
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
