//! The file around a bundle: blocks that tell when they are damaged.
//!
//! In: a header, numbered chunks and the bundle's id. Out: bytes, and back; nothing of a file that
//! fails any check comes back. Layout, all numbers little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 10 | magic `GEOFAN\r\n\x1a\n`: line ends that a text transfer would change |
//! | 4 | format version |
//! | … | the header block, the table of contents, one block for each sampled field of the manifold, one for each chunk in order |
//! | 32 | blake3 of everything before |
//!
//! A block is type u8, index u32, payload length u64, the bundle's id (16), the payload, and xxh3-64
//! over all of it. The table of contents has index u32, offset u64 and length u64 of each chunk's
//! payload.

use crate::decode::{BundleError, ByteReader, DecodeError};
use std::convert::Infallible;
use xxhash_rust::xxh3::xxh3_64;

/// The first bytes of a bundle.
pub const MAGIC: &[u8; 10] = b"GEOFAN\r\n\x1a\n";

/// The format that is written, and the only one that is read.
pub const VERSION: u32 = 11;

/// The largest file read: files are read whole.
pub const MOST_BYTES: u64 = 4 << 30;

/// Names a bundle: equal for equal manifold and plan.
pub type Id = [u8; 16];

/// Bytes of a block before its payload.
pub(crate) const BLOCK_HEAD: usize = 1 + 4 + 8 + 16;
/// Bytes of the checksum behind a payload.
pub(crate) const CHECKSUM: usize = 8;
/// Bytes of the hash at the end of a file.
pub(crate) const HASH: usize = 32;
/// Offset of the first block.
pub(crate) const START: usize = MAGIC.len() + 4;
/// Bytes of an entry of the table of contents.
const ENTRY: usize = 4 + 8 + 8;

/// Tells the payloads of blocks apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BlockKind {
    /// The header record.
    Header = 1,
    /// The table of contents.
    Contents = 2,
    /// One chunk.
    Chunk = 3,
    /// One chunk in a file of its own, while a bake is under way.
    Part = 4,
    /// The samples of a field of the manifold.
    Field = 5,
    /// What was decided about one box of a chunk, in a file of its own while a bake is under way.
    Decision = 6,
}

/// A block of a file, checked.
#[derive(Debug, Clone, Copy)]
pub struct FileBlock<'a> {
    kind: u8,
    /// The number of a chunk or of a field; 0 in other blocks.
    pub index: u32,
    /// The bundle's id.
    pub id: Id,
    /// The content.
    pub payload: &'a [u8],
    /// Where the payload starts in the file.
    offset: usize,
}

/// What is said of a block before its payload, and where that lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct BlockPlace {
    pub kind: u8,
    pub index: u32,
    pub id: Id,
    /// Where the payload starts in the file, and its bytes.
    pub offset: u64,
    pub length: u64,
}

impl BlockPlace {
    /// Reads the head of the block that begins at the byte `start` of a file.
    ///
    /// # Errors
    /// There are fewer bytes.
    pub fn read(head: &[u8], start: u64) -> Result<Self, DecodeError> {
        let mut input = ByteReader(head);
        let (kind, index, length) = (input.u8()?, input.u32()?, input.u64()?);
        let mut id = Id::default();
        id.copy_from_slice(input.take(size_of::<Id>())?);
        let offset = start + BLOCK_HEAD as u64;
        Ok(Self {
            kind,
            index,
            id,
            offset,
            length,
        })
    }
}

impl FileBlock<'_> {
    fn place(&self) -> BlockPlace {
        BlockPlace {
            kind: self.kind,
            index: self.index,
            id: self.id,
            offset: self.offset as u64,
            length: self.payload.len() as u64,
        }
    }
}

/// Appends one block to `out`.
pub fn put_block(out: &mut Vec<u8>, kind: BlockKind, index: u32, id: Id, payload: &[u8]) {
    let start = out.len();
    out.push(kind as u8);
    out.extend(index.to_le_bytes());
    out.extend((payload.len() as u64).to_le_bytes());
    out.extend(id);
    out.extend(payload);
    let checksum = xxh3_64(&out[start..]);
    out.extend(checksum.to_le_bytes());
}

/// Returns the payload of `bytes`, if they are exactly the undamaged block of this kind, index and id.
pub fn read_block(bytes: &[u8], kind: BlockKind, index: u32, id: Id) -> Option<&[u8]> {
    let (payload, rest) = first_block(bytes, kind, index, id)?;
    rest.is_empty().then_some(payload)
}

/// Returns the payload of the block that `bytes` begin with and what follows it, if that is an undamaged one of this kind,
/// index and id.
pub fn first_block(bytes: &[u8], kind: BlockKind, index: u32, id: Id) -> Option<(&[u8], &[u8])> {
    let mut at = 0;
    let block = next_block(bytes, &mut at).ok()?;
    let same = block.kind == kind as u8 && block.index == index && block.id == id;
    same.then_some((block.payload, &bytes[at..]))
}

/// Reads the block at `at` and checks it; `at` moves behind it.
fn next_block<'a>(bytes: &'a [u8], at: &mut usize) -> Result<FileBlock<'a>, BundleError> {
    let cut = |_| BundleError::Truncated(bytes.len() as u64);
    let start = *at;
    let place = BlockPlace::read(&bytes[start..], start as u64).map_err(cut)?;
    // The payload, however long a hostile file says it is.
    let length = usize::try_from(place.length).unwrap_or(usize::MAX);
    let mut input = ByteReader(&bytes[start + BLOCK_HEAD..]);
    let payload = input.take(length).map_err(cut)?;
    let end = start + BLOCK_HEAD + length;
    let checksum = input.u64().map_err(cut)?;
    if xxh3_64(&bytes[start..end]) != checksum {
        return Err(BundleError::Block(start as u64));
    }
    *at = end + CHECKSUM;
    Ok(FileBlock {
        kind: place.kind,
        index: place.index,
        id: place.id,
        payload,
        offset: start + BLOCK_HEAD,
    })
}

/// Writes a file block by block, for chunks that are not in memory together.
pub struct BlockWriter<W> {
    out: W,
    hasher: blake3::Hasher,
    id: Id,
}

impl<W: FnMut(&[u8]) -> Result<(), E>, E> BlockWriter<W> {
    /// Begins a file with this id, header record and fields, whose chunks have these numbers and bytes, in
    /// ascending order; `out` takes what is to be written.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn begin(
        out: W,
        id: Id,
        (header, fields): (&[u8], &[Vec<u8>]),
        chunks: &[(u32, u64)],
    ) -> Result<Self, E> {
        let mut start = MAGIC.to_vec();
        start.extend(VERSION.to_le_bytes());
        put_block(&mut start, BlockKind::Header, 0, id, header);
        let between = fields
            .iter()
            .map(|field| BLOCK_HEAD + field.len() + CHECKSUM);
        let contents = table_of_contents(header, between.sum(), chunks);
        put_block(&mut start, BlockKind::Contents, 0, id, &contents);
        for (index, payload) in (0..).zip(fields) {
            put_block(&mut start, BlockKind::Field, index, id, payload);
        }
        let mut writer = Self {
            out,
            hasher: blake3::Hasher::new(),
            id,
        };
        writer.put(&start).map(|()| writer)
    }

    /// Writes the next chunk.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn chunk(&mut self, index: u32, payload: &[u8]) -> Result<(), E> {
        let mut block = Vec::with_capacity(BLOCK_HEAD + payload.len() + CHECKSUM);
        put_block(&mut block, BlockKind::Chunk, index, self.id, payload);
        self.put(&block)
    }

    /// Ends the file with its hash.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn end(mut self) -> Result<(), E> {
        (self.out)(self.hasher.finalize().as_bytes())
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), E> {
        self.hasher.update(bytes);
        (self.out)(bytes)
    }
}

/// Returns the bytes of a file with this header record, fields and chunks.
pub fn file_bytes(header: &[u8], fields: &[Vec<u8>], chunks: &[(u32, u64)]) -> u64 {
    let fields = fields.iter().map(|field| field.len() as u64);
    let contents = (chunks.len() * ENTRY) as u64;
    let blocks = [header.len() as u64, contents].into_iter().chain(fields);
    let blocks = blocks.chain(chunks.iter().map(|(_, length)| *length));
    let around = (BLOCK_HEAD + CHECKSUM) as u64;
    (START + HASH) as u64 + blocks.map(|length| length + around).sum::<u64>()
}

/// Makes the bytes of a file with this id, header record, fields and numbered chunks, these in ascending order.
pub fn encode(id: Id, header: &[u8], fields: &[Vec<u8>], chunks: &[(u32, Vec<u8>)]) -> Vec<u8> {
    let lengths: Vec<(u32, u64)> = chunks
        .iter()
        .map(|(index, payload)| (*index, payload.len() as u64))
        .collect();
    let mut bytes = Vec::with_capacity(file_bytes(header, fields, &lengths) as usize);
    let out = |part: &[u8]| -> Result<(), Infallible> {
        bytes.extend(part);
        Ok(())
    };
    let written = BlockWriter::begin(out, id, (header, fields), &lengths).and_then(|mut file| {
        for (index, payload) in chunks {
            file.chunk(*index, payload)?;
        }
        file.end()
    });
    let Ok(()) = written;
    bytes
}

/// Lists the chunks; `between` is the number of bytes between the list and the first of them.
fn table_of_contents(header: &[u8], between: usize, chunks: &[(u32, u64)]) -> Vec<u8> {
    let contents = chunks.len() * ENTRY;
    let start = START + 3 * BLOCK_HEAD + 2 * CHECKSUM + header.len() + contents + between;
    let mut offset = start as u64;
    let mut out = Vec::with_capacity(contents);
    for (index, length) in chunks {
        out.extend(index.to_le_bytes());
        out.extend(offset.to_le_bytes());
        out.extend(length.to_le_bytes());
        offset += length + (CHECKSUM + BLOCK_HEAD) as u64;
    }
    out
}

/// The blocks of a file: that of the header, those of fields, those of chunks.
pub type FileBlocks<'a> = (FileBlock<'a>, Vec<FileBlock<'a>>, Vec<FileBlock<'a>>);

/// Reads what [`encode`] made.
///
/// # Errors
/// Anything is different: every byte is covered by a checksum.
pub fn decode(bytes: &[u8]) -> Result<FileBlocks<'_>, BundleError> {
    if bytes.len() as u64 > MOST_BYTES {
        return Err(too_large(bytes.len() as u64));
    }
    check_start(bytes)?;
    // The hash over everything before it; if it does not match, the first block that is damaged.
    let body = bytes.len().checked_sub(HASH).filter(|body| *body >= START);
    let body = body.ok_or(BundleError::Truncated(bytes.len() as u64))?;
    if blake3::hash(&bytes[..body]).as_bytes() != &bytes[body..] {
        return Err(first_damage(bytes));
    }
    // The blocks.
    let bytes = &bytes[..body];
    let mut at = START;
    let mut blocks = Vec::new();
    while at < bytes.len() {
        blocks.push(next_block(bytes, &mut at)?);
    }
    let places: Vec<BlockPlace> = blocks.iter().map(FileBlock::place).collect();
    let listed = blocks.get(1).map_or(&[][..], |contents| contents.payload);
    let fields = check_order(&places, listed)?;
    let chunks = blocks.split_off(2 + fields);
    let fields = blocks.split_off(2);
    Ok((blocks[0], fields, chunks))
}

/// Makes the error for a file of this many bytes.
pub(crate) fn too_large(found: u64) -> BundleError {
    BundleError::Limit {
        what: "bytes",
        found,
        most: MOST_BYTES,
    }
}

/// Checks that the file is a bundle of a format this version reads.
pub(crate) fn check_start(bytes: &[u8]) -> Result<(), BundleError> {
    let start = &bytes[..bytes.len().min(MAGIC.len())];
    if start != &MAGIC[..start.len()] || start.is_empty() {
        return Err(match bytes.starts_with(&MAGIC[..6]) {
            true => BundleError::TextMode,
            false => BundleError::NotABundle,
        });
    }
    match ByteReader(&bytes[start.len()..]).u32() {
        Err(_) => Err(BundleError::Truncated(bytes.len() as u64)),
        Ok(VERSION) => Ok(()),
        Ok(version) if version > VERSION => Err(BundleError::Newer(version)),
        Ok(version @ 1..) => Err(BundleError::Older(version)),
        Ok(version) => Err(BundleError::Version(version)),
    }
}

/// Finds the first thing wrong with a file whose hash does not match.
fn first_damage(bytes: &[u8]) -> BundleError {
    let mut at = START;
    loop {
        match bytes.len() - at {
            HASH => return BundleError::Hash,
            0..HASH => return BundleError::Truncated(bytes.len() as u64),
            _ => {}
        }
        let start = at;
        if let Err(error) = next_block(bytes, &mut at) {
            let (before, behind) = bytes.split_at(start);
            return match behind.strip_prefix(blake3::hash(before).as_bytes()) {
                Some(tail) => BundleError::Appended(tail.len() as u64),
                None => error,
            };
        }
    }
}

/// Checks that whole blocks are the header, the table of contents, fields and the chunks that are `listed` in the
/// table of contents; returns the number of fields.
pub(crate) fn check_order(blocks: &[BlockPlace], listed: &[u8]) -> Result<usize, BundleError> {
    let wrong = |what| Err(BundleError::Invalid(what));
    // The blocks that must be there, of one bundle.
    let [header, contents, rest @ ..] = blocks else {
        return wrong("its header or its table of contents is missing");
    };
    if header.kind != BlockKind::Header as u8 || contents.kind != BlockKind::Contents as u8 {
        return wrong("its blocks are out of order");
    }
    if header.index != 0 || contents.index != 0 {
        return wrong("its header or its table of contents has a number");
    }
    if blocks.iter().any(|b| b.id != header.id) {
        return wrong("its blocks come from several bundles");
    }
    // Fields by their numbers, and the chunks where the table of contents says.
    let is_field = |block: &&BlockPlace| block.kind == BlockKind::Field as u8;
    let fields = rest.iter().take_while(is_field).count();
    let (numbered, chunks) = rest.split_at(fields);
    if !numbered
        .iter()
        .map(|block| block.index)
        .eq(0..fields as u32)
    {
        return wrong("its fields are out of order");
    }
    let mut entries = listed.chunks_exact(ENTRY);
    let agree = entries.by_ref().zip(chunks).all(|(entry, chunk)| {
        chunk.kind == BlockKind::Chunk as u8
            && entry[..4] == chunk.index.to_le_bytes()
            && entry[4..12] == chunk.offset.to_le_bytes()
            && entry[12..] == chunk.length.to_le_bytes()
    });
    if !agree || listed.len() != chunks.len() * ENTRY {
        return wrong("its table of contents disagrees with its chunks");
    }
    match chunks.is_sorted_by(|a, b| a.index < b.index) {
        true => Ok(fields),
        false => wrong("its chunks are out of order"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    fn chunks() -> Vec<(u32, Vec<u8>)> {
        let chunk = |k: u32| (2 * k, vec![k as u8; 7 * k as usize]);
        (0..5).map(chunk).collect()
    }

    fn file() -> Vec<u8> {
        let fields = [b"a field".to_vec(), b"another".to_vec()];
        encode(*b"0123456789abcdef", b"a header", &fields, &chunks())
    }

    #[test]
    fn payloads_come_back_as_they_were() {
        let file = file();
        let (header, fields, found) = decode(&file).unwrap();
        let fields: Vec<_> = fields.iter().map(|b| b.payload).collect();
        assert_eq!(fields, [b"a field", b"another"]);
        assert_eq!(header.payload, b"a header");
        assert_eq!(&header.id, b"0123456789abcdef");
        let found = found.iter().map(|b| (b.index, b.payload.to_vec()));
        assert!(found.eq(chunks()));
    }

    #[test]
    fn every_truncation_is_refused_and_named() {
        let bytes = file();
        for length in 1..bytes.len() {
            let error = decode(&bytes[..length]).unwrap_err();
            let known = matches!(error, BundleError::Truncated(at) if at == length as u64);
            // A cut in the last hash can look like a hash that does not match.
            let hash = matches!(error, BundleError::Hash);
            assert!(known || hash, "{length}: {error}");
        }
        assert!(decode(&[]).is_err());
    }

    #[test]
    fn what_is_appended_is_told_as_such() {
        for count in [1, 40, 4000] {
            let bytes = [file(), vec![b'x'; count]].concat();
            let error = decode(&bytes).unwrap_err();
            let known = matches!(error, BundleError::Appended(n) if n == count as u64);
            assert!(known, "{error}");
        }
    }

    #[test]
    fn every_flipped_bit_and_every_tail_is_refused() {
        let bytes = file();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&damaged).is_err(), "bit {bit}");
        }
        for tail in 1..100 {
            let mut longer = bytes.clone();
            longer.extend(vec![0; tail]);
            assert!(decode(&longer).is_err());
        }
    }

    #[test]
    fn blocks_that_need_no_number_have_none() {
        for (header, contents) in [(0, 0), (1, 0), (0, 7)] {
            let mut bytes = MAGIC.to_vec();
            bytes.extend(VERSION.to_le_bytes());
            put_block(&mut bytes, BlockKind::Header, header, [1; 16], b"h");
            put_block(&mut bytes, BlockKind::Contents, contents, [1; 16], b"");
            let hash = blake3::hash(&bytes);
            bytes.extend(hash.as_bytes());
            assert_eq!(decode(&bytes).is_ok(), header + contents == 0);
        }
    }

    #[test]
    fn blocks_in_each_others_places_are_refused_under_a_right_hash() {
        let sealed = |chunks: &[(u32, Vec<u8>)], listed: &[(u32, u64)]| {
            let mut bytes = Vec::new();
            let out = |part: &[u8]| -> Result<(), Infallible> {
                bytes.extend(part);
                Ok(())
            };
            let Ok(()) =
                BlockWriter::begin(out, [1; 16], (b"h", &[]), listed).and_then(|mut file| {
                    for (index, payload) in chunks {
                        file.chunk(*index, payload)?;
                    }
                    file.end()
                });
            bytes
        };
        let lengths = |chunks: &[(u32, Vec<u8>)]| -> Vec<(u32, u64)> {
            chunks
                .iter()
                .map(|(k, payload)| (*k, payload.len() as u64))
                .collect()
        };
        let right = [(0, vec![7; 9]), (1, vec![8; 9]), (2, vec![9; 9])];
        assert!(decode(&sealed(&right, &lengths(&right))).is_ok());
        // Blocks exchanged as they are, with a table of contents of either order.
        let exchanged = [right[1].clone(), right[0].clone(), right[2].clone()];
        assert!(decode(&sealed(&exchanged, &lengths(&right))).is_err());
        assert!(decode(&sealed(&exchanged, &lengths(&exchanged))).is_err());
        // One twice, in place of another.
        let twice = [right[0].clone(), right[0].clone(), right[2].clone()];
        assert!(decode(&sealed(&twice, &lengths(&right))).is_err());
        assert!(decode(&sealed(&twice, &lengths(&twice))).is_err());
    }

    #[test]
    fn hostile_lengths_take_no_memory_even_under_a_right_hash() {
        for length in [u64::MAX, u64::MAX - 40, 1 << 62, 1 << 33] {
            let mut bytes = file();
            bytes[START + 5..START + 13].copy_from_slice(&length.to_le_bytes());
            let body = bytes.len() - HASH;
            let hash = blake3::hash(&bytes[..body]);
            bytes[body..].copy_from_slice(hash.as_bytes());
            assert!(decode(&bytes).is_err());
        }
    }

    #[test]
    fn noise_behind_the_magic_is_refused() {
        let mut stream = Stream::new(&[5]);
        for length in 0..300 {
            let mut bytes = MAGIC.to_vec();
            bytes.extend(VERSION.to_le_bytes());
            bytes.extend((0..length).map(|_| stream.bits() as u8));
            assert!(decode(&bytes).is_err());
        }
    }

    #[test]
    fn newer_formats_and_text_transfers_are_told_apart() {
        let mut bytes = file();
        let mut version = |number: u8| {
            bytes[MAGIC.len()] = number;
            decode(&bytes).unwrap_err()
        };
        assert!(matches!(version(VERSION as u8 + 1), BundleError::Newer(_)));
        assert!(matches!(version(VERSION as u8 - 1), BundleError::Older(_)));
        let error = decode(b"GEOFAN\n\x1a\n....").unwrap_err();
        assert!(matches!(error, BundleError::TextMode));
        let error = decode(b"name = \"flat\"").unwrap_err();
        assert!(matches!(error, BundleError::NotABundle));
    }

    #[test]
    fn a_block_alone_knows_its_number_and_its_bundle() {
        let mut bytes = Vec::new();
        put_block(&mut bytes, BlockKind::Part, 7, [1; 16], b"payload");
        let read = |index, id| read_block(&bytes, BlockKind::Part, index, id);
        assert_eq!(read(7, [1; 16]), Some(b"payload".as_slice()));
        assert_eq!(read(8, [1; 16]), None);
        assert_eq!(read(7, [2; 16]), None);
        assert_eq!(read_block(&bytes[1..], BlockKind::Part, 7, [1; 16]), None);
    }
}
