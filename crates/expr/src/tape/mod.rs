//! Graph -> straight-line tape, run over lanes of rays.
//!
//! In: a graph and the nodes wanted. Out: a [`Tape`] whose instructions read and write registers of
//! `W` lanes; every instruction is one short loop over the lanes, which the compiler turns into
//! vector code under [`vectorised`]. Arithmetic is `+ - * /` and the kernels of [`super::real`]
//! in a fixed order, so results are the same bits on every machine.
//!
//! [`Tape::digests`] gives a hash of each output that is equal for equal expressions of equal inputs, in
//! whatever order they were written and compiled: names, intermediate results and the order of the operands
//! of sums and products leave no trace. Expressions that are equal only by algebra have different digests.

mod compiler;

use super::{
    graph::{Binary, Graph, NodeId, Unary},
    real::Real,
    spline::SplineEvaluator,
};
use compiler::Compiler;
use fearless_simd::{Level, Simd, dispatch};
use std::{
    cell::Cell,
    ops::{Deref, DerefMut},
};

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
    /// What instructions look up in sampled fields.
    fields: Vec<FieldLookup>,
    /// Number of instructions of the code that [`Tape::run_first`] carries out.
    first: usize,
    constants: Vec<(u16, f64)>,
    outputs: Vec<u16>,
    inputs: usize,
    /// For each input: does anything depend on it?
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

/// The expressions are too large for a tape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TapeTooLarge {
    /// It would need more registers than there are.
    #[error("the expressions need more than {MOST_REGISTERS} intermediate values at once")]
    Values,
    /// The graph has as many fields as it can hold.
    #[error("more than {} fields", u16::MAX)]
    Fields,
}

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

    /// Counts the operations of one run: (arithmetic, transcendental). A sum of products counts as
    /// many as it has multiplications and additions.
    pub fn operations(&self) -> (usize, usize) {
        self.code
            .iter()
            .fold((0, 0), |(plain, heavy), i| match i.operation {
                Operation::Sample => (plain + self.field_of(i).evaluator.arithmetic(), heavy),
                heavy_one if heavy_one.is_transcendental() => (plain, heavy + 1),
                other => (plain + other.arithmetic(), heavy),
            })
    }

    /// What an instruction looks up.
    fn field_of(&self, instruction: &Instruction) -> &FieldLookup {
        &self.fields[usize::from(instruction.operands[3])]
    }

    /// Returns the number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Returns whether anything depends on the input `index`.
    pub fn reads(&self, index: usize) -> bool {
        self.read[index]
    }

    /// Registers for this tape, constants set.
    pub fn registers<R: Real, const W: usize>(&self) -> Registers<R, W> {
        let mut values = Vec::new();
        self.prepare(&mut values);
        Registers {
            values,
            inputs: self.inputs,
            outputs: self.outputs.clone(),
        }
    }

    /// Makes `values` the registers of this tape, constants set.
    fn prepare<R: Real, const W: usize>(&self, values: &mut Vec<Wide<R, W>>) {
        values.clear();
        values.resize(self.registers, Wide([R::ZERO; W]));
        for &(register, value) in &self.constants {
            values[register as usize] = Wide([R::from_f64(value); W]);
        }
    }

    /// Computes all outputs from the inputs in `registers` (which must be of this tape), with the
    /// widest vector instructions there are.
    pub fn run<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        self.interpret(&self.code, &mut registers.values);
    }

    /// [`Tape::run`] for the first part of the outputs only.
    pub fn run_first<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        self.interpret(&self.code[..self.first], &mut registers.values);
    }

    /// Computes the rest of the outputs after [`Tape::run_first`], for the same inputs.
    pub fn run_rest<R: Real, const W: usize>(&self, registers: &mut Registers<R, W>) {
        self.interpret(&self.code[self.first..], &mut registers.values);
    }

    /// The outputs at one point, in double precision.
    pub fn at(&self, inputs: &[f64]) -> Vec<f64> {
        // Kept from call to call: to make registers takes as long as to run a short tape.
        thread_local! {
            static REGISTERS: Cell<Vec<Wide<f64, 1>>> = const { Cell::new(Vec::new()) };
        }
        let mut values = REGISTERS.take();
        self.prepare(&mut values);
        for (register, input) in values.iter_mut().zip(inputs) {
            register[0] = *input;
        }
        self.interpret(&self.code, &mut values);
        let outputs = self.outputs.iter();
        let outputs = outputs.map(|r| values[usize::from(*r)][0]).collect();
        REGISTERS.set(values);
        outputs
    }

    /// The outputs at many points of `N` inputs, one row for each: a vector of them at a time, at a fraction of the
    /// cost.
    pub fn at_each<const N: usize>(
        &self,
        points: impl ExactSizeIterator<Item = [f64; N]>,
    ) -> Vec<f64> {
        const LANES: usize = 16;
        let mut rows = Vec::with_capacity(points.len() * self.outputs());
        if points.len() == 0 {
            return rows;
        }
        let mut registers = self.registers::<f64, LANES>();
        let (mut points, mut left) = (points, LANES);
        while left == LANES {
            left = 0;
            for point in points.by_ref().take(LANES) {
                for (k, x) in point.into_iter().enumerate() {
                    registers.input(k)[left] = x;
                }
                left += 1;
            }
            self.run(&mut registers);
            for lane in 0..left {
                rows.extend((0..self.outputs()).map(|k| registers.output(k)[lane]));
            }
        }
        rows
    }

    /// Runs at one point, in registers made before.
    pub fn run_at(&self, registers: &mut Registers<f64, 1>, inputs: &[f64]) {
        for (i, &value) in inputs.iter().enumerate() {
            *registers.input(i) = [value];
        }
        self.run(registers);
    }
}

impl Tape {
    // Not inlined: one copy of the interpreter for each kind of number and of machine is large enough,
    // and a call costs nothing against a tape.
    #[inline(never)]
    fn interpret<R: Real, const W: usize>(
        &self,
        code: &[Instruction],
        registers: &mut [Wide<R, W>],
    ) {
        vectorised(
            #[inline(always)]
            || {
                for i in code {
                    carry_out(registers, i, &self.fields);
                }
            },
        );
    }
}

/// A hash of an expression.
pub type Digest = [u8; 32];

impl Tape {
    /// Digests every output, with `hash` as the hash function.
    pub fn digests(&self, hash: impl Fn(&[u8]) -> Digest) -> Vec<Digest> {
        let node = |name: &str, operands: &[Digest]| {
            let mut bytes = name.as_bytes().to_vec();
            operands.iter().for_each(|operand| bytes.extend(operand));
            hash(&bytes)
        };
        let leaf = |name: &str, bytes: &[u8]| hash(&[name.as_bytes(), bytes].concat());
        // Inputs and constants, then what becomes of the registers one instruction after the other.
        let mut registers = vec![Digest::default(); self.registers];
        for (index, register) in registers.iter_mut().take(self.inputs).enumerate() {
            *register = leaf("input", &(index as u64).to_le_bytes());
        }
        for (register, value) in &self.constants {
            registers[usize::from(*register)] = leaf("constant", &value.to_bits().to_le_bytes());
        }
        for instruction in &self.code {
            if instruction.operation == Operation::Sample {
                let FieldLookup { evaluator, to } = self.field_of(instruction);
                let [x, y, z, ..] = instruction.operands.map(usize::from);
                let at = [x, y, z].map(|r| registers[r]);
                for (orders, register) in evaluator.orders().iter().zip(to) {
                    let which = leaf("derivative", orders);
                    let parts = [*evaluator.spline().identity(), which, at[0], at[1], at[2]];
                    registers[usize::from(*register)] = node("Sample", &parts);
                }
                continue;
            }
            let operands = instruction.operands.map(|r| registers[usize::from(r)]);
            let result = instruction.operation.digest(operands, &node);
            registers[usize::from(instruction.to)] = result;
        }
        let outputs = self.outputs.iter();
        outputs.map(|r| registers[usize::from(*r)]).collect()
    }
}

impl Operation {
    /// Digests what it makes of operands with these digests; sums of products as their single steps.
    fn digest(
        self,
        [a, b, c, d, e, f]: [Digest; 6],
        node: &dyn Fn(&str, &[Digest]) -> Digest,
    ) -> Digest {
        let either_order = |name: &str, x, y| symmetric_digest(name, [x, y], node);
        let add = |x, y| either_order("Add", x, y);
        let mul = |x, y| either_order("Mul", x, y);
        let sub = |x, y| node("Sub", &[x, y]);
        match self {
            Self::Add | Self::Mul | Self::Min | Self::Max => either_order(&self.name(), a, b),
            Self::Sub | Self::Pow | Self::Atan2 | Self::Less | Self::LessEqual => {
                node(&self.name(), &[a, b])
            }
            Self::Select => node(&self.name(), &[a, b, c]),
            Self::MulAdd => add(mul(a, b), c),
            Self::NegMulAdd => sub(c, mul(a, b)),
            Self::MulAddTwice => add(add(mul(a, b), c), mul(d, e)),
            Self::NegMulAddTwice => sub(sub(c, mul(a, b)), mul(d, e)),
            Self::DotOfTwo => add(mul(a, b), mul(c, d)),
            Self::DotOfThree => add(add(mul(a, b), mul(c, d)), mul(e, f)),
            _ => node(&self.name(), &[a]),
        }
    }

    /// Returns its name.
    fn name(self) -> String {
        format!("{self:?}")
    }
}

/// Digests an operation that does not ask which of its operands is the first.
// Inlined for each operation, it would be nearly a hundredth of a page's viewer.
#[inline(never)]
fn symmetric_digest(
    name: &str,
    [x, y]: [Digest; 2],
    node: &dyn Fn(&str, &[Digest]) -> Digest,
) -> Digest {
    node(name, &if x <= y { [x, y] } else { [y, x] })
}

/// The operations of instructions, the interpreter's arm for each, and those of graph nodes: one list.
macro_rules! operations {
    (unary [$($unary:ident)*] binary [$($binary:ident)*] own [$($own:ident ($($operand:ident)*) $value:expr;)*]) => {
        /// The operation that an instruction applies to its operands.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        enum Operation {
            $($unary,)* $($binary,)* $($own,)*
            /// All derivatives wanted of a field, at the point of the first three operands; the fourth
            /// is the number of its [`FieldLookup`].
            Sample,
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
        fn carry_out<R: Real, const W: usize>(
            r: &mut [Wide<R, W>],
            i: &Instruction,
            fields: &[FieldLookup],
        ) {
            match i.operation {
                Operation::Sample => look_up(r, i, fields),
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
    /// Returns whether it is one of the elementary functions, which cost many multiplications.
    fn is_transcendental(self) -> bool {
        use Operation::{
            Acos, Acosh, Asin, Asinh, Atan, Atan2, Atanh, Cos, Cosh, Exp, Log, Pow, Sin, Sinh, Tan,
            Tanh,
        };
        let circular = matches!(self, Sin | Cos | Tan | Asin | Acos | Atan | Atan2);
        let hyperbolic = matches!(self, Sinh | Cosh | Tanh | Asinh | Acosh | Atanh);
        circular || hyperbolic || matches!(self, Exp | Log | Pow)
    }

    /// Counts the multiplications and additions (or other single steps) that it takes.
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

/// The derivatives of a field at one point, with the registers that they go to.
#[derive(Debug, Clone)]
struct FieldLookup {
    /// Computes them.
    evaluator: SplineEvaluator,
    /// The register of each.
    to: Vec<u16>,
}

/// Carries out the lookup of a field.
#[inline(never)]
fn look_up<R: Real, const W: usize>(r: &mut [Wide<R, W>], i: &Instruction, fields: &[FieldLookup]) {
    let [x, y, z, field, ..] = i.operands.map(usize::from);
    let FieldLookup { evaluator, to } = &fields[field];
    // Copied, because results may take the place of arguments.
    let at = [x, y, z].map(|k| r[k].0);
    evaluator.evaluate(at.each_ref(), |k, lanes| {
        r[usize::from(to[k])] = Wide(lanes)
    });
}

/// Most operands of an instruction.
const MOST_OPERANDS: usize = 6;

/// An operation on registers.
#[derive(Debug, Clone, Copy)]
struct Instruction {
    /// The operation.
    operation: Operation,
    /// The register of the result.
    to: u16,
    /// The registers of the operands, as many as the operation takes.
    operands: [u16; MOST_OPERANDS],
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

/// Returns the number of lanes that fill a vector of 64 bytes; 1 if `lanes` do not fill whole ones.
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

#[cfg(test)]
mod tests {
    use crate::{
        Graph, Tape,
        parse::{Binding, Scope, parse},
    };

    /// A hash good enough for a test.
    fn hash(bytes: &[u8]) -> [u8; 32] {
        let mut state = [0xcbf2_9ce4_8422_2325_u64, 0x9e37_79b9_7f4a_7c15, 3, 4];
        for (i, byte) in bytes.iter().enumerate() {
            let word = &mut state[i % 4];
            *word = (*word ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
            state[(i + 1) % 4] ^= state[i % 4].rotate_left(29);
        }
        let bytes: Vec<u8> = state.iter().flat_map(|w| w.to_le_bytes()).collect();
        std::array::from_fn(|i| bytes[i])
    }

    /// Compiles `text` over x, y, z after `first` has been read into the graph.
    fn digest(first: &str, text: &str) -> [u8; 32] {
        let mut graph = Graph::new();
        let mut scope = Scope::default();
        for (index, name) in ["x", "y", "z"].into_iter().enumerate() {
            let node = graph.input(index as u32);
            scope.bind(name, Binding::fixed(node));
        }
        if !first.is_empty() {
            parse(first, &scope, &mut graph).unwrap();
        }
        let node = parse(text, &scope, &mut graph).unwrap().node;
        Tape::compile(&graph, &[node], 3).unwrap().digests(hash)[0]
    }

    #[test]
    fn equal_expressions_have_equal_digests_in_whatever_order_they_were_read() {
        let texts = [
            "sin(x)*y + z*cos(x) + 2",
            "x*y + y*z + z*x",
            "if(x < y, exp(z), max(x, y)) - x*y - z",
        ];
        for text in texts {
            let alone = digest("", text);
            assert_eq!(alone, digest("cos(x) + z*y", text), "{text}");
            assert_eq!(alone, digest("z*x - exp(z) + sin(x)", text), "{text}");
        }
        assert_eq!(digest("", "x*y + z"), digest("", "z + y*x"));
    }

    #[test]
    fn different_expressions_have_different_digests() {
        let texts = [
            "x - y", "y - x", "x + y", "x*y", "x", "y", "1", "2", "x^y", "y^x", "sin(x)", "x + y*z",
        ];
        for (i, a) in texts.iter().enumerate() {
            for b in &texts[..i] {
                assert_ne!(digest("", a), digest("", b), "{a} and {b}");
            }
        }
    }
}
