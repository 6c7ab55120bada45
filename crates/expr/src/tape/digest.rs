//! Digests of compiled expressions.
//!
//! In: a tape. Out: a hash of each output that is equal for equal expressions of equal inputs, in whatever
//! order they were written and compiled: names, intermediate results and the order of the operands of sums
//! and products leave no trace. Expressions that are equal only by algebra have different digests.

use super::{Tape, instruction::Operation};

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
        node: &impl Fn(&str, &[Digest]) -> Digest,
    ) -> Digest {
        let either_order = |name: &str, x: Digest, y: Digest| node(name, &[x.min(y), x.max(y)]);
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
