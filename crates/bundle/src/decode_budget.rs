//! Bounds on what the bytes of a table may ask for.
//!
//! In: the number of bytes of a file. Out: a [`DecodeBudget`] that every tensor takes its share out of before
//! anything is allocated for it. A coder of zeros writes seven hundred integers in a byte, a core of one
//! column is padded sixteenfold, and a camera opens the product of all terms of directions: without bounds,
//! 32 kB ask for gigabytes and minutes.

use crate::decode::DecodeError;
use std::sync::atomic::{AtomicU64, Ordering};

/// Units that any file has, however small, and those for each of its bytes: more than twice what tables
/// take that are baked.
#[derive(Debug, Clone, Copy)]
struct Allowance {
    base: u64,
    per_byte: u64,
}

/// Numbers that are decoded, restored or unpacked: a second for a megabyte. A floor of three bumps takes 32 a
/// byte, its largest cores of many vectors.
const WORK: Allowance = Allowance {
    base: 1 << 22,
    per_byte: 128,
};

/// Bytes of memory that stay, when a camera has opened every chunk: a rail among three bumps takes 27 a byte.
const MEMORY: Allowance = Allowance {
    base: 24 << 20,
    per_byte: 64,
};

/// Bytes that one core needs while it is unpacked.
const CORE: Allowance = Allowance {
    base: 16 << 20,
    per_byte: 20,
};

/// Integers restored from vectors cost a multiplication for each vector before; so many count as one number.
const MULTIPLICATIONS: u64 = 64;

/// Holds what the chunks of a table may still ask for. All share one, so that a file of many small chunks gets
/// no more than a file of a large one.
#[derive(Debug)]
pub struct DecodeBudget {
    work: AtomicU64,
    memory: AtomicU64,
    core: u64,
}

/// The sizes that a core asks for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CoreSizes {
    /// Integers that are stored.
    pub integers: u64,
    /// Vectors that they are restored from, or numbers of each, whichever is less.
    pub vectors: u64,
    /// Numbers when it is packed, with those that fill its panels.
    pub padded: u64,
}

impl Allowance {
    fn of_bytes(self, bytes: usize) -> u64 {
        let own = self.per_byte.saturating_mul(bytes as u64);
        self.base.saturating_add(own)
    }
}

impl DecodeBudget {
    /// Returns the budget of a file of so many bytes.
    pub fn for_bytes(bytes: usize) -> Self {
        Self {
            work: WORK.of_bytes(bytes).into(),
            memory: MEMORY.of_bytes(bytes).into(),
            core: CORE.of_bytes(bytes),
        }
    }

    /// Takes the work on a core and its integers out, before they are decoded.
    ///
    /// # Errors
    /// Less is left.
    pub(crate) fn take_core(&self, sizes: CoreSizes) -> Result<(), DecodeError> {
        let CoreSizes {
            integers,
            vectors,
            padded,
        } = sizes;
        // Integers, restored numbers in double precision, and those of panels.
        let unpacked = integers
            .saturating_mul(12)
            .saturating_add(padded.saturating_mul(4));
        if unpacked > self.core {
            return Err(TOO_MUCH);
        }
        let restored = integers.saturating_mul(vectors) / MULTIPLICATIONS;
        take(
            &self.work,
            integers.saturating_add(padded).saturating_add(restored),
        )?;
        self.take_memory(integers.saturating_mul(4))
    }

    /// Takes so many bytes out that stay in memory.
    ///
    /// # Errors
    /// Fewer are left.
    pub(crate) fn take_memory(&self, bytes: u64) -> Result<(), DecodeError> {
        take(&self.memory, bytes)
    }
}

const TOO_MUCH: DecodeError = DecodeError("number of coefficients for its size");

/// Takes so many units out of what is left.
fn take(left: &AtomicU64, units: u64) -> Result<(), DecodeError> {
    let less = |left: u64| left.checked_sub(units);
    let taken = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    taken.map(|_| ()).map_err(|_| TOO_MUCH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_spent_once_by_whoever_shares_it() {
        let budget = DecodeBudget::for_bytes(10);
        let all = MEMORY.of_bytes(10);
        assert!(budget.take_memory(all - 5).is_ok());
        assert!(budget.take_memory(6).is_err());
        assert!(budget.take_memory(5).is_ok());
        assert!(budget.take_memory(1).is_err());
        let sizes = CoreSizes {
            integers: u64::MAX,
            vectors: u64::MAX,
            padded: 1,
        };
        assert!(DecodeBudget::for_bytes(1 << 20).take_core(sizes).is_err());
    }
}
