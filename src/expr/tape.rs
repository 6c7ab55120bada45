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

/// What an instruction does with its operands a, b, c.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operation {
    Unary(Unary),
    Binary(Binary),
    /// `a b + c`, rounded twice.
    MulAdd,
    /// `c − a b`, rounded twice.
    NegMulAdd,
    /// `if a > 0 { b } else { c }`
    Select,
}

#[derive(Debug, Clone, Copy)]
struct Instruction {
    operation: Operation,
    to: u16,
    a: u16,
    b: u16,
    c: u16,
}

/// A compiled set of expressions.
#[derive(Debug, Clone)]
pub struct Tape {
    code: Vec<Instruction>,
    constants: Vec<(u16, f64)>,
    outputs: Vec<u16>,
    inputs: usize,
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
        Compiler::new(graph, outputs, inputs).compile(outputs)
    }

    /// How many operations one run costs, by the hundred weight: (arithmetic, transcendental).
    pub fn operations(&self) -> (usize, usize) {
        let heavy = |i: &&Instruction| match i.operation {
            Operation::Unary(op) => !matches!(
                op,
                Unary::Neg | Unary::Abs | Unary::Recip | Unary::Sqrt | Unary::Floor
            ),
            Operation::Binary(op) => matches!(op, Binary::Pow | Binary::Atan2),
            _ => false,
        };
        let heavy = self.code.iter().filter(heavy).count();
        (self.code.len() - heavy, heavy)
    }

    /// How many outputs there are.
    pub fn outputs(&self) -> usize {
        self.outputs.len()
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
    // Not inlined: one copy of the interpreter for each kind of number and of machine is large
    // enough, and a call costs nothing against a tape.
    #[inline(never)]
    pub fn run<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        vectorised(
            #[inline(always)]
            || self.interpret(registers),
        );
    }

    #[inline(always)]
    fn interpret<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        let r = registers.values.as_mut_slice();
        for i in &self.code {
            match i.operation {
                Operation::Unary(op) => unary(r, i, op),
                Operation::Binary(op) => binary(r, i, op),
                Operation::MulAdd => ternary(r, i, |a, b, c| a * b + c),
                Operation::NegMulAdd => ternary(r, i, |a, b, c| c - a * b),
                Operation::Select => ternary(r, i, |a, b, c| R::select(a > R::ZERO, b, c)),
            }
        }
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

/// Calls `$body` once for each vector's worth of lanes, with the lanes' number in `$C` and the
/// first of them in `$first`.
// A vector at a time goes through a local array, which the compiler keeps in a vector register;
// written straight into the registers, which might overlap the operands, or through an array of all
// lanes, which goes to memory and back, the loops are slower.
macro_rules! by_vectors {
    ($R:ident, $W:ident, |$first:ident, $C:ident| $body:block) => {{
        /// Lanes in a vector of 64 bytes.
        #[inline(always)]
        const fn fitting<R>(lanes: usize) -> usize {
            let fit = 64 / size_of::<R>();
            if lanes % fit == 0 { fit } else { 1 }
        }
        match const { fitting::<$R>($W) } {
            8 => {
                const $C: usize = 8;
                for $first in (0..$W).step_by($C) $body
            }
            16 => {
                const $C: usize = 16;
                for $first in (0..$W).step_by($C) $body
            }
            _ => {
                const $C: usize = 1;
                for $first in (0..$W).step_by($C) $body
            }
        }
    }};
}

/// The `C` lanes of `row` from `first`.
#[inline(always)]
fn lanes<R: Real, const W: usize, const C: usize>(row: &Wide<R, W>, first: usize) -> [R; C] {
    let mut lanes = [R::ZERO; C];
    lanes.copy_from_slice(&row[first..first + C]);
    lanes
}

type File<R, const W: usize> = [Wide<R, W>];

#[inline(always)]
fn map<R: Real, const W: usize>(r: &mut File<R, W>, i: &Instruction, f: impl Fn(R) -> R) {
    let (a, to) = (i.a as usize, i.to as usize);
    by_vectors!(R, W, |first, C| {
        let a: [R; C] = lanes(&r[a], first);
        let mut result = [R::ZERO; C];
        for lane in 0..C {
            result[lane] = f(a[lane]);
        }
        r[to][first..first + C].copy_from_slice(&result);
    });
}

#[inline(always)]
fn zip<R: Real, const W: usize>(r: &mut File<R, W>, i: &Instruction, f: impl Fn(R, R) -> R) {
    let (a, b, to) = (i.a as usize, i.b as usize, i.to as usize);
    by_vectors!(R, W, |first, C| {
        let (a, b): ([R; C], [R; C]) = (lanes(&r[a], first), lanes(&r[b], first));
        let mut result = [R::ZERO; C];
        for lane in 0..C {
            result[lane] = f(a[lane], b[lane]);
        }
        r[to][first..first + C].copy_from_slice(&result);
    });
}

#[inline(always)]
fn ternary<R: Real, const W: usize>(r: &mut File<R, W>, i: &Instruction, f: impl Fn(R, R, R) -> R) {
    let [a, b, c, to] = [i.a, i.b, i.c, i.to].map(usize::from);
    by_vectors!(R, W, |first, C| {
        let (a, b): ([R; C], [R; C]) = (lanes(&r[a], first), lanes(&r[b], first));
        let c: [R; C] = lanes(&r[c], first);
        let mut result = [R::ZERO; C];
        for lane in 0..C {
            result[lane] = f(a[lane], b[lane], c[lane]);
        }
        r[to][first..first + C].copy_from_slice(&result);
    });
}

/// One arm for each function, so that each is a loop of its own over the lanes.
macro_rules! arms {
    ($loop:ident, $r:expr, $i:expr, $op:expr, $kind:ident, $args:tt, [$($name:ident),*]) => {
        match $op { $($kind::$name => arms!(@one $loop, $r, $i, $kind::$name, $args)),* }
    };
    (@one $loop:ident, $r:expr, $i:expr, $op:expr, ($($arg:ident),*)) => {
        $loop($r, $i, #[inline(always)] |$($arg),*| $op.apply($($arg),*))
    };
}

#[inline(always)]
fn unary<R: Real, const W: usize>(r: &mut File<R, W>, i: &Instruction, op: Unary) {
    arms!(
        map,
        r,
        i,
        op,
        Unary,
        (x),
        [
            Neg, Recip, Sqrt, Abs, Floor, Exp, Log, Sin, Cos, Tan, Asin, Acos, Atan, Sinh, Cosh,
            Tanh, Asinh, Acosh, Atanh
        ]
    );
}

#[inline(always)]
fn binary<R: Real, const W: usize>(r: &mut File<R, W>, i: &Instruction, op: Binary) {
    arms!(
        zip,
        r,
        i,
        op,
        Binary,
        (x, y),
        [Add, Sub, Mul, Pow, Atan2, Min, Max, Less, LessEqual]
    );
}

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
        let mut compiler = Self {
            graph,
            reached: vec![false; graph.len()],
            uses: vec![0; graph.len()],
            register: vec![0; graph.len()],
            free: Vec::new(),
            next: inputs,
        };
        for output in outputs {
            compiler.reached[output.0 as usize] = true;
            compiler.uses[output.0 as usize] += 1;
        }
        for id in (0..graph.len()).rev() {
            if compiler.reached[id] {
                for operand in graph.node(NodeId(id as u32)).operands() {
                    compiler.reached[operand.0 as usize] = true;
                    compiler.uses[operand.0 as usize] += 1;
                }
            }
        }
        compiler
    }

    fn compile(mut self, outputs: &[NodeId]) -> Result<Tape, TapeTooLarge> {
        let inputs = self.next;
        let constants = self.place_leaves()?;
        let fused = self.fuse();
        let mut code = Vec::new();
        for id in 0..self.graph.len() {
            let leaf = matches!(
                self.graph.node(NodeId(id as u32)),
                Node::Constant(_) | Node::Input(_)
            );
            if self.reached[id] && !leaf && !fused[id].1 {
                code.push(self.instruction(id, fused[id].0)?);
            }
        }
        Ok(Tape {
            code,
            constants,
            outputs: outputs
                .iter()
                .map(|o| self.register[o.0 as usize])
                .collect(),
            inputs,
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

    /// For each node, the product it absorbs, and whether it is itself absorbed. A product used
    /// once, by a sum, is computed inside the sum's instruction: half the dispatches and stores.
    fn fuse(&self) -> Vec<(Option<NodeId>, bool)> {
        let mut fused = vec![(None, false); self.graph.len()];
        for id in 0..self.graph.len() {
            if !self.reached[id] {
                continue;
            }
            let candidates = match self.graph.node(NodeId(id as u32)) {
                Node::Binary(Binary::Add, a, b) => [Some(b), Some(a)],
                Node::Binary(Binary::Sub, _, b) => [Some(b), None],
                _ => continue,
            };
            let product = candidates.into_iter().flatten().find(|c| {
                matches!(self.graph.node(*c), Node::Binary(Binary::Mul, ..))
                    && self.uses[c.0 as usize] == 1
            });
            if let Some(product) = product {
                fused[id].0 = Some(product);
                fused[product.0 as usize].1 = true;
            }
        }
        fused
    }

    fn instruction(
        &mut self,
        id: usize,
        product: Option<NodeId>,
    ) -> Result<Instruction, TapeTooLarge> {
        let node = self.graph.node(NodeId(id as u32));
        let (operation, operands) = match (node, product) {
            (Node::Binary(op, x, y), Some(product)) => {
                let rest = if x == product { y } else { x };
                let mut operands: Vec<_> = self.graph.node(product).operands().collect();
                operands.push(rest);
                let operation = match op {
                    Binary::Sub => Operation::NegMulAdd,
                    _ => Operation::MulAdd,
                };
                (operation, operands)
            }
            (Node::Unary(op, _), _) => (Operation::Unary(op), node.operands().collect()),
            (Node::Binary(op, ..), _) => (Operation::Binary(op), node.operands().collect()),
            _ => (Operation::Select, node.operands().collect()),
        };
        let register = |k: usize| {
            operands
                .get(k)
                .map_or(0, |o: &NodeId| self.register[o.0 as usize])
        };
        let (a, b, c) = (register(0), register(1), register(2));
        for operand in &operands {
            self.release(*operand);
        }
        let to = match self.free.pop() {
            Some(register) => register,
            None => self.fresh()?,
        };
        self.register[id] = to;
        Ok(Instruction {
            operation,
            to,
            a,
            b,
            c,
        })
    }

    /// Counts one use of `id` as done and frees its register after the last.
    fn release(&mut self, id: NodeId) {
        let at = id.0 as usize;
        self.uses[at] -= 1;
        let scratch = !matches!(self.graph.node(id), Node::Constant(_) | Node::Input(_));
        if self.uses[at] == 0 && scratch {
            self.free.push(self.register[at]);
        }
    }
}
