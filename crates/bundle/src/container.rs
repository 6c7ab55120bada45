//! The file around a bundle: blocks that tell when they are damaged.
//!
//! In: a header, numbered chunks and the bundle's id. Out: bytes, and back; nothing of a file that
//! fails any check comes back. Layout, all numbers little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 10 | magic `GEOFAN\r\n\x1a\n`: line ends that a text transfer would change |
//! | 4 | format version |
//! | … | the header block, the table of contents, one block for each chunk in order |
//! | 32 | blake3 of everything before |
//!
//! A block is type u8, index u32, payload length u64, the bundle's id (16), the payload, and xxh3-64
//! over all of it. The table of contents has index u32, offset u64 and length u64 of each chunk's
//! payload.

use std::io::{self, Write};
use xxhash_rust::xxh3::xxh3_64;

/// The first bytes of a bundle.
pub const MAGIC: &[u8; 10] = b"GEOFAN\r\n\x1a\n";

/// The format written, and the newest one read.
pub const VERSION: u32 = 11;

/// The largest file read: files are read whole.
pub const MOST_BYTES: u64 = 4 << 30;

/// Names a bundle: equal for equal manifold and plan.
pub type Id = [u8; 16];

const HEAD: usize = 1 + 4 + 8 + 16;
const CHECKSUM: usize = 8;
const HASH: usize = 32;
const START: usize = MAGIC.len() + 4;
const ENTRY: usize = 4 + 8 + 8;

/// What a block holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The header record.
    Header = 1,
    /// The table of contents.
    Contents = 2,
    /// One chunk.
    Chunk = 3,
    /// One chunk in a file of its own, while a bake is under way.
    Part = 4,
}

/// What is wrong with the bytes of a file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ContainerError {
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
    /// A block is not what was written.
    #[error("is damaged in the block at byte {0}: copy it again, or bake again")]
    Block(u64),
    /// The blocks are whole, but not the file.
    #[error("is damaged: its hash does not match; copy it again, or bake again")]
    Hash,
    /// Whole, but not put together as bundles are.
    #[error("is not a valid bundle: {0}")]
    Layout(&'static str),
}

/// The payloads of a bundle's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Container {
    /// The bundle's id, in every block.
    pub id: Id,
    /// The header record.
    pub header: Vec<u8>,
    /// Chunk numbers, ascending, and their payloads.
    pub chunks: Vec<(u32, Vec<u8>)>,
}

/// A block as read.
struct Block<'a> {
    kind: u8,
    index: u32,
    id: Id,
    payload: &'a [u8],
    /// Where the payload starts in the file.
    offset: usize,
}

/// Writes one block.
pub fn write_block(
    out: &mut impl Write,
    kind: Kind,
    index: u32,
    id: Id,
    payload: &[u8],
) -> io::Result<()> {
    let mut block = Vec::with_capacity(HEAD + payload.len() + CHECKSUM);
    block.push(kind as u8);
    block.extend(index.to_le_bytes());
    block.extend((payload.len() as u64).to_le_bytes());
    block.extend(id);
    block.extend(payload);
    let checksum = xxh3_64(&block);
    block.extend(checksum.to_le_bytes());
    out.write_all(&block)
}

/// The payload of `bytes`, if they are exactly the undamaged block of this kind, index and id.
pub fn read_block(bytes: &[u8], kind: Kind, index: u32, id: Id) -> Option<&[u8]> {
    let mut at = 0;
    let block = next_block(bytes, &mut at).ok()?;
    let same = block.kind == kind as u8 && block.index == index && block.id == id;
    (same && at == bytes.len()).then_some(block.payload)
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

/// The block at `at`, checked; `at` moves behind it.
fn next_block<'a>(bytes: &'a [u8], at: &mut usize) -> Result<Block<'a>, ContainerError> {
    let cut = || ContainerError::Truncated(bytes.len() as u64);
    let start = *at;
    let kind = *bytes.get(start).ok_or_else(cut)?;
    let index = u32::from_le_bytes(number(bytes, start + 1).ok_or_else(cut)?);
    let length = u64::from_le_bytes(number(bytes, start + 5).ok_or_else(cut)?);
    let id: Id = number(bytes, start + 13).ok_or_else(cut)?;
    let offset = start + HEAD;
    let end = usize::try_from(length)
        .ok()
        .and_then(|length| offset.checked_add(length))
        .ok_or_else(cut)?;
    let checksum = number(bytes, end).ok_or_else(cut)?;
    if xxh3_64(&bytes[start..end]) != u64::from_le_bytes(checksum) {
        return Err(ContainerError::Block(start as u64));
    }
    *at = end + CHECKSUM;
    Ok(Block {
        kind,
        index,
        id,
        payload: &bytes[offset..end],
        offset,
    })
}

impl Container {
    /// The whole file.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        let mut put = |kind, index, payload: &[u8]| {
            // Writing to memory does not fail.
            let _ = write_block(&mut out, kind, index, self.id, payload);
        };
        put(Kind::Header, 0, &self.header);
        put(Kind::Contents, 0, &self.contents());
        for (index, payload) in &self.chunks {
            put(Kind::Chunk, *index, payload);
        }
        let hash = blake3::hash(&out);
        out.extend(hash.as_bytes());
        out
    }

    fn contents(&self) -> Vec<u8> {
        let contents = self.chunks.len() * ENTRY;
        let mut offset = START + 3 * HEAD + 2 * CHECKSUM + self.header.len() + contents;
        let mut out = Vec::with_capacity(contents);
        for (index, payload) in &self.chunks {
            out.extend(index.to_le_bytes());
            out.extend((offset as u64).to_le_bytes());
            out.extend((payload.len() as u64).to_le_bytes());
            offset += payload.len() + CHECKSUM + HEAD;
        }
        out
    }

    /// Reads what [`Container::encode`] wrote.
    ///
    /// # Errors
    /// Anything is different: every byte is covered by a checksum.
    pub fn decode(bytes: &[u8]) -> Result<Self, ContainerError> {
        check_start(bytes)?;
        let body = bytes.len().checked_sub(HASH).filter(|body| *body >= START);
        let body = body.ok_or(ContainerError::Truncated(bytes.len() as u64))?;
        if blake3::hash(&bytes[..body]).as_bytes() != &bytes[body..] {
            return Err(diagnose(bytes));
        }
        let bytes = &bytes[..body];
        let mut at = START;
        let mut blocks = Vec::new();
        while at < bytes.len() {
            blocks.push(next_block(bytes, &mut at)?);
        }
        assemble(&blocks)
    }
}

/// That the file is a bundle of a format this version reads.
fn check_start(bytes: &[u8]) -> Result<(), ContainerError> {
    let start = &bytes[..bytes.len().min(MAGIC.len())];
    if start != &MAGIC[..start.len()] || start.is_empty() {
        return Err(match bytes.starts_with(&MAGIC[..6]) {
            true => ContainerError::TextMode,
            false => ContainerError::NotABundle,
        });
    }
    let version = number(bytes, MAGIC.len());
    match version.map(u32::from_le_bytes) {
        None => Err(ContainerError::Truncated(bytes.len() as u64)),
        Some(VERSION) => Ok(()),
        Some(version) if version > VERSION => Err(ContainerError::Newer(version)),
        Some(version @ 1..) => Err(ContainerError::Older(version)),
        Some(version) => Err(ContainerError::Version(version)),
    }
}

/// The first thing wrong with a file whose hash does not match.
fn diagnose(bytes: &[u8]) -> ContainerError {
    let mut at = START;
    loop {
        match bytes.len() - at {
            HASH => return ContainerError::Hash,
            0..HASH => return ContainerError::Truncated(bytes.len() as u64),
            _ => {}
        }
        if let Err(error) = next_block(bytes, &mut at) {
            return error;
        }
    }
}

fn assemble(blocks: &[Block<'_>]) -> Result<Container, ContainerError> {
    let wrong = ContainerError::Layout;
    let [header, contents, chunks @ ..] = blocks else {
        return Err(wrong("its header or its table of contents is missing"));
    };
    if header.kind != Kind::Header as u8 || contents.kind != Kind::Contents as u8 {
        return Err(wrong("its blocks are out of order"));
    }
    if blocks.iter().any(|b| b.id != header.id) {
        return Err(wrong("its blocks come from several bundles"));
    }
    let mut entries = contents.payload.chunks_exact(ENTRY);
    let listed = entries.by_ref().zip(chunks).all(|(entry, chunk)| {
        chunk.kind == Kind::Chunk as u8
            && entry[..4] == chunk.index.to_le_bytes()
            && entry[4..12] == (chunk.offset as u64).to_le_bytes()
            && entry[12..] == (chunk.payload.len() as u64).to_le_bytes()
    });
    if !listed || contents.payload.len() != chunks.len() * ENTRY {
        return Err(wrong("its table of contents disagrees with its chunks"));
    }
    if !chunks.is_sorted_by(|a, b| a.index < b.index) {
        return Err(wrong("its chunks are out of order"));
    }
    Ok(Container {
        id: header.id,
        header: header.payload.to_vec(),
        chunks: chunks
            .iter()
            .map(|b| (b.index, b.payload.to_vec()))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    fn container() -> Container {
        Container {
            id: *b"0123456789abcdef",
            header: b"a header".to_vec(),
            chunks: (0..5)
                .map(|k| (2 * k, vec![k as u8; 7 * k as usize]))
                .collect(),
        }
    }

    #[test]
    fn payloads_come_back_as_they_were() {
        let container = container();
        assert_eq!(Container::decode(&container.encode()).unwrap(), container);
    }

    #[test]
    fn every_truncation_is_refused_and_named() {
        let bytes = container().encode();
        for length in 1..bytes.len() {
            let error = Container::decode(&bytes[..length]).unwrap_err();
            let known = matches!(error, ContainerError::Truncated(at) if at == length as u64);
            // A cut in the last hash can look like a hash that does not match.
            assert!(known || error == ContainerError::Hash, "{length}: {error}");
        }
        assert!(Container::decode(&[]).is_err());
    }

    #[test]
    fn every_flipped_bit_and_every_tail_is_refused() {
        let bytes = container().encode();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Container::decode(&damaged).is_err(), "bit {bit}");
        }
        for tail in 1..100 {
            let mut longer = bytes.clone();
            longer.extend(vec![0; tail]);
            assert!(Container::decode(&longer).is_err());
        }
    }

    #[test]
    fn hostile_lengths_take_no_memory_even_under_a_right_hash() {
        for length in [u64::MAX, u64::MAX - 40, 1 << 62, 1 << 33] {
            let mut bytes = container().encode();
            bytes[START + 5..START + 13].copy_from_slice(&length.to_le_bytes());
            let body = bytes.len() - HASH;
            let hash = blake3::hash(&bytes[..body]);
            bytes[body..].copy_from_slice(hash.as_bytes());
            assert!(Container::decode(&bytes).is_err());
        }
    }

    #[test]
    fn noise_behind_the_magic_is_refused() {
        let mut stream = Stream::new(&[5]);
        for length in 0..300 {
            let mut bytes = MAGIC.to_vec();
            bytes.extend(VERSION.to_le_bytes());
            bytes.extend((0..length).map(|_| stream.bits() as u8));
            assert!(Container::decode(&bytes).is_err());
        }
    }

    #[test]
    fn newer_formats_and_text_transfers_are_told_apart() {
        let mut bytes = container().encode();
        let mut version = |number: u8| {
            bytes[MAGIC.len()] = number;
            Container::decode(&bytes).unwrap_err().to_string()
        };
        assert!(version(VERSION as u8 + 1).contains("newer geofan"));
        assert!(version(VERSION as u8 - 1).contains("older geofan"));
        let error = Container::decode(b"GEOFAN\n\x1a\n....").unwrap_err();
        assert_eq!(error, ContainerError::TextMode);
        let error = Container::decode(b"name = \"flat\"").unwrap_err();
        assert_eq!(error, ContainerError::NotABundle);
    }

    #[test]
    fn a_block_alone_knows_its_number_and_its_bundle() {
        let mut bytes = Vec::new();
        write_block(&mut bytes, Kind::Part, 7, [1; 16], b"payload").unwrap();
        let read = |index, id| read_block(&bytes, Kind::Part, index, id);
        assert_eq!(read(7, [1; 16]), Some(b"payload".as_slice()));
        assert_eq!(read(8, [1; 16]), None);
        assert_eq!(read(7, [2; 16]), None);
        assert_eq!(read_block(&bytes[1..], Kind::Part, 7, [1; 16]), None);
    }
}
