//! Checked reading: errors, little-endian numbers, and bounds on what the bytes of a table may ask for.
//!
//! In: bytes that may come from anywhere. Out: numbers, or an error that a caller can match:
//! [`BundleError`] when a file is opened, [`LookupError`] when a path is looked up in it, both made of
//! [`DecodeError`] where the payload of a block makes no sense.
//!
//! In: the number of bytes of a file. Out: a [`DecodeBudget`] that every tensor takes its share out of before
//! anything is allocated for it. A coder of zeros writes seven hundred integers in a byte, a core of one
//! column is padded sixteenfold, and a camera opens the product of all terms of directions: without bounds,
//! 32 kB ask for gigabytes and minutes.

use crate::container::VERSION;
use geofan_core::Error;
use std::{
    path::Path,
    sync::atomic::{AtomicU64, Ordering},
};

/// Names the part of a payload that makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("damaged {0}")]
pub struct DecodeError(pub &'static str);

/// Says why the bytes of a file are not a bundle that can be read.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// Another kind of file.
    #[error("is not a bundle")]
    NotABundle,
    /// The start was changed as text transfers change it.
    #[error("was changed by a transfer in text mode: copy it again in binary mode")]
    TextMode,
    /// Made by a later version.
    #[error("was written by a newer geofan (format {0}; this one reads up to {VERSION})")]
    Newer(u32),
    /// Made by an earlier version, whose tables are no longer read.
    #[error("was written by an older geofan (format {0}; this one reads {VERSION}): bake it again")]
    Older(u32),
    /// No such format has existed.
    #[error("is damaged: format version {0}")]
    Version(u32),
    /// The end is missing.
    #[error("is truncated at byte {0}: copy it again, or bake again")]
    Truncated(u64),
    /// A whole file, and so many bytes behind it.
    #[error("is a bundle with {0} bytes behind its end: copy it again, or bake again")]
    Appended(u64),
    /// The block that begins at this byte is not what was written.
    #[error("is damaged in the block at byte {0}: copy it again, or bake again")]
    Block(u64),
    /// The blocks are whole, but not the file.
    #[error("is damaged: its hash does not match; copy it again, or bake again")]
    Hash,
    /// Larger than a reader accepts.
    #[error("has {found} {what}; bundles have at most {most}")]
    Limit {
        /// The thing counted.
        what: &'static str,
        /// Its number in the file.
        found: u64,
        /// The largest number accepted.
        most: u64,
    },
    /// The header does not decode, or does not fit into a header block.
    #[error("is not a valid bundle: its header: {0}")]
    Header(String),
    /// Whole, but its parts do not fit each other.
    #[error("is not a valid bundle: {0}")]
    Invalid(&'static str),
    /// The embedded manifold is refused.
    #[error("{0}")]
    Manifold(#[from] Error),
    /// A share of a bundle where a whole one is needed.
    #[error("is shard {index} of {of}: join the shards with `geofan merge`")]
    Shard {
        /// The number of the shard, from 1.
        index: u32,
        /// The number of shards.
        of: u32,
    },
}

impl BundleError {
    /// Makes the error to show: about the file `path`, or about a place in the embedded manifold.
    pub fn about(self, path: &Path) -> Error {
        match self {
            Self::Manifold(error) => error,
            other => Error::input(path.display().to_string(), other.to_string()),
        }
    }
}

/// Says why a path cannot be looked up in an open bundle.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LookupError {
    /// No camera of the region can be carried to this position by the symmetry.
    #[error("the position ({}, {}, {}) is not in the bundle's camera region {region}", at[0], at[1], at[2])]
    OutsideRegion {
        /// The chart point asked for.
        at: [f64; 3],
        /// The region, in words.
        region: String,
    },
    /// The block of a chunk passed its checksum but holds no tree of patches.
    #[error("chunk {chunk}: {damage}")]
    Damaged {
        /// The number of the chunk.
        chunk: usize,
        /// The part of it that makes no sense.
        damage: DecodeError,
    },
}

impl From<LookupError> for Error {
    fn from(error: LookupError) -> Self {
        let subject = match error {
            LookupError::OutsideRegion { .. } => "camera",
            LookupError::Damaged { .. } => "bundle",
        };
        Self::input(subject, error.to_string())
    }
}

/// Reads little-endian numbers from the front of bytes; every read is checked.
#[derive(Debug, Clone, Copy)]
pub struct ByteReader<'a>(pub &'a [u8]);

impl<'a> ByteReader<'a> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let (head, tail) = self.0.split_first_chunk().ok_or(DecodeError("length"))?;
        self.0 = tail;
        Ok(*head)
    }

    /// Reads `count` bytes.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let (head, tail) = self
            .0
            .split_at_checked(count)
            .ok_or(DecodeError("length"))?;
        self.0 = tail;
        Ok(head)
    }

    /// Reads one byte.
    pub fn u8(&mut self) -> Result<u8, DecodeError> {
        self.array().map(u8::from_le_bytes)
    }

    /// Reads a 16-bit integer.
    pub fn i16(&mut self) -> Result<i16, DecodeError> {
        self.array().map(i16::from_le_bytes)
    }

    /// Reads a 32-bit integer.
    pub fn u32(&mut self) -> Result<u32, DecodeError> {
        self.array().map(u32::from_le_bytes)
    }

    /// Reads a 64-bit integer.
    pub fn u64(&mut self) -> Result<u64, DecodeError> {
        self.array().map(u64::from_le_bytes)
    }

    /// Reads a 32-bit length and as many bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8], DecodeError> {
        let length = self.u32()?;
        self.take(length as usize)
    }

    /// Checks that nothing is left.
    pub fn finish(&self) -> Result<(), DecodeError> {
        match self.0.is_empty() {
            true => Ok(()),
            false => Err(DecodeError("end")),
        }
    }
}

/// Appends the length of `bytes` as 32 bits and then these, as [`ByteReader::bytes`] reads them.
pub fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
}

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

/// Integers restored from vectors cost a multiplication for each vector before; this many multiplications count as one number.
const MULTIPLICATIONS: u64 = 64;

/// Holds what the chunks of a table may still ask for. All share one, so that a file of many small chunks gets
/// no more than a file of a large one.
#[derive(Debug)]
pub struct DecodeBudget {
    /// Bytes of the file.
    bytes: usize,
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
    /// Returns the budget of a file of this many bytes.
    pub fn for_bytes(bytes: usize) -> Self {
        Self {
            bytes,
            work: WORK.of_bytes(bytes).into(),
            memory: MEMORY.of_bytes(bytes).into(),
            core: CORE.of_bytes(bytes),
        }
    }

    /// Returns it as it was before anything was taken.
    pub(crate) fn whole(&self) -> Self {
        Self::for_bytes(self.bytes)
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

    /// Charges the budget for bytes that stay in memory.
    ///
    /// # Errors
    /// Fewer are left.
    pub(crate) fn take_memory(&self, bytes: u64) -> Result<(), DecodeError> {
        take(&self.memory, bytes)
    }
}

const TOO_MUCH: DecodeError = DecodeError("number of coefficients for its size");

/// Subtracts `units` from what is left.
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
