//! What a tape is made of: operations, instructions, and how one is carried out in all lanes.

use crate::{
    graph::{Binary, Unary},
    real::Real,
    spline::SplineEvaluator,
};
use std::ops::{Deref, DerefMut};

/// The operations of instructions, the interpreter's arm for each, and those of graph nodes: one list.
macro_rules! operations {
    (unary [$($unary:ident)*] binary [$($binary:ident)*] own [$($own:ident ($($operand:ident)*) $value:expr;)*]) => {
        /// The operation that an instruction applies to its operands.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Operation {
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
        pub fn carry_out<R: Real, const W: usize>(
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
    pub fn is_transcendental(self) -> bool {
        use Operation::{
            Acos, Acosh, Asin, Asinh, Atan, Atan2, Atanh, Cos, Cosh, Exp, Log, Pow, Sin, Sinh, Tan,
            Tanh,
        };
        let circular = matches!(self, Sin | Cos | Tan | Asin | Acos | Atan | Atan2);
        let hyperbolic = matches!(self, Sinh | Cosh | Tanh | Asinh | Acosh | Atanh);
        circular || hyperbolic || matches!(self, Exp | Log | Pow)
    }

    /// Counts the multiplications and additions (or other single steps) that it takes.
    pub fn arithmetic(self) -> usize {
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
pub struct FieldLookup {
    /// Computes them.
    pub evaluator: SplineEvaluator,
    /// The register of each.
    pub to: Vec<u16>,
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
pub const MOST_OPERANDS: usize = 6;

/// An operation on registers.
#[derive(Debug, Clone, Copy)]
pub struct Instruction {
    /// The operation.
    pub operation: Operation,
    /// The register of the result.
    pub to: u16,
    /// The registers of the operands, as many as the operation takes.
    pub operands: [u16; MOST_OPERANDS],
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
