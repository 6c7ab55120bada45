//! Graph -> straight-line tape, run over lanes of rays.
//!
//! In: a graph and the nodes wanted. Out: a [`Tape`] whose instructions read and write registers of
//! `W` lanes; every instruction is one short loop over the lanes, which the compiler turns into
//! vector code under [`vectorised`]. Arithmetic is `+ - * /` and the kernels of [`super::real`]
//! in a fixed order, so results are the same bits on every machine.

mod compiler;
mod digest;
mod instruction;

use super::{
    graph::{Graph, NodeId},
    real::Real,
};
use compiler::Compiler;
use fearless_simd::{Level, Simd, dispatch};
pub use instruction::Wide;
use instruction::{Instruction, carry_out};

/// Runs `work` with the widest vector instructions this machine has. `work` and what it calls must
/// be `#[inline(always)]` to profit.
#[inline]
pub fn vectorised<T>(work: impl FnOnce() -> T) -> T {
    dispatch!(Level::new(), simd => simd.vectorize(work))
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
        let mut registers = self.registers();
        self.run_at(&mut registers, inputs);
        (0..self.outputs())
            .map(|k| registers.output(k)[0])
            .collect()
    }

    /// Runs at one point, in registers made before.
    pub fn run_at(&self, registers: &mut Registers<f64, 1>, inputs: &[f64]) {
        for (i, &value) in inputs.iter().enumerate() {
            *registers.input(i) = [value];
        }
        self.run(registers);
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
