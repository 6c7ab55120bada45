//! Files of chunks that are never in memory together.
//!
//! In: the path of a bundle or shard of any size. Out: its header, checked like that of a file that is read whole, and
//! single chunks ([`StoredContents`]); and back, a file of chunks that come one by one ([`write_chunks`]). A file is
//! read through once when it is opened, so that damage anywhere is found before work is spent on it; in memory are then
//! its header, the samples of its fields and the places of its chunks.

use crate::{
    bundle::{checked_header, field_payloads},
    container::{
        BLOCK_HEAD, BlockKind, BlockPlace, BlockWriter, CHECKSUM, HASH, Id, START, check_order,
        check_start, file_bytes, read_block,
    },
    decode::BundleError,
    header::{Header, MOST_HEADER_BYTES},
    rays::RaySpace,
};
use geofan_core::{error::Error, files::write_atomically};
use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};
use xxhash_rust::xxh3::Xxh3;

/// Bytes of a chunk that are read at a time when a file is opened.
const PART: usize = 1 << 16;

/// A file of chunks, whole or a shard, whose chunks stay on the disk.
#[derive(Debug, Clone)]
pub struct StoredContents {
    /// The header.
    pub header: Header,
    /// The bundle's id.
    pub id: Id,
    /// The rays.
    pub space: RaySpace,
    /// The chunks.
    pub chunks: StoredChunks,
}

/// The chunks of a file, on the disk.
#[derive(Debug, Clone)]
pub struct StoredChunks {
    path: PathBuf,
    id: Id,
    places: Vec<BlockPlace>,
}

impl StoredContents {
    /// Opens a bundle or a shard, and checks all of it but for what its chunks mean.
    ///
    /// # Errors
    /// The file cannot be read, or is not one.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let failed = |e| Error::io(path, e);
        let file = File::open(path).map_err(failed)?;
        let found = file.metadata().map_err(failed)?;
        if !found.is_file() {
            let message = "is not a plain file, whose chunks can be read one by one";
            return Err(Error::input(path.display().to_string(), message));
        }
        let (places, payloads) = Scan::new(path, file, found.len()).blocks()?;
        Self::of_blocks(path, &places, &payloads).map_err(|e| e.about(path))
    }

    fn of_blocks(
        path: &Path,
        places: &[BlockPlace],
        payloads: &[Vec<u8>],
    ) -> Result<Self, BundleError> {
        let listed = payloads.get(1).map_or(&[][..], Vec::as_slice);
        let fields = check_order(places, listed)?;
        let id = places[0].id;
        let chunks = StoredChunks {
            path: path.into(),
            id,
            places: places[2 + fields..].to_vec(),
        };
        let (header, space) = checked_header(
            &path.display().to_string(),
            (id, &payloads[0]),
            payloads[2..].iter().map(Vec::as_slice),
            chunks.list().map(|(number, _)| number),
        )?;
        Ok(Self {
            header,
            id,
            space,
            chunks,
        })
    }
}

impl StoredChunks {
    /// Lists their numbers and bytes, in ascending order.
    pub fn list(&self) -> impl Iterator<Item = (u32, u64)> {
        self.places.iter().map(|chunk| (chunk.index, chunk.length))
    }

    /// Reads the chunk with this number.
    ///
    /// # Errors
    /// The file has no such chunk, cannot be read, or has changed.
    pub fn read(&self, number: u32) -> Result<Vec<u8>, Error> {
        let found = self
            .places
            .binary_search_by_key(&number, |chunk| chunk.index);
        let missing = |_| BundleError::Invalid("chunks are missing").about(&self.path);
        let place = self.places[found.map_err(missing)?];
        let start = place.offset - BLOCK_HEAD as u64;
        let mut block = self
            .bytes(start, place.length as usize + BLOCK_HEAD + CHECKSUM)
            .map_err(|e| Error::io(&self.path, e))?;
        if read_block(&block, BlockKind::Chunk, number, self.id).is_none() {
            return Err(BundleError::Block(start).about(&self.path));
        }
        block.truncate(block.len() - CHECKSUM);
        block.drain(..BLOCK_HEAD);
        Ok(block)
    }

    /// Reads bytes of the file.
    fn bytes(&self, start: u64, count: usize) -> io::Result<Vec<u8>> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(start))?;
        let mut bytes = vec![0; count];
        file.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

/// Writes the file of the bundle `id` over `space` with this header and chunks of these numbers and bytes, in
/// ascending order, whole or not at all; `chunk` is asked for one after the other. Returns the size of the file.
///
/// # Errors
/// The place cannot be written, or those of `chunk`.
pub fn write_chunks(
    path: &Path,
    (header, id, space): (&Header, Id, &RaySpace),
    chunks: &[(u32, u64)],
    mut chunk: impl FnMut(u32) -> Result<Vec<u8>, Error>,
) -> Result<u64, Error> {
    let header = header.encode().map_err(|e| e.about(path))?;
    let fields = field_payloads(space);
    // What is wrong with a chunk is told of where it comes from, not of the file that is written.
    let mut wrong = None;
    let written = write_atomically(path, |out| {
        let put = |bytes: &[u8]| out.write_all(bytes);
        let mut file = BlockWriter::begin(put, id, (&header, &fields), chunks)?;
        for (number, _) in chunks {
            let payload = chunk(*number).map_err(|error| {
                wrong = Some(error);
                io::Error::from(io::ErrorKind::Other)
            })?;
            file.chunk(*number, &payload)?;
        }
        file.end()
    });
    match wrong {
        Some(error) => Err(error),
        None => written.map(|()| file_bytes(&header, &fields, chunks)),
    }
}

/// Reads through a file, and hashes it on the way.
struct Scan<'p> {
    path: &'p Path,
    input: BufReader<File>,
    /// Bytes of the file, read and in all.
    at: u64,
    size: u64,
    hasher: blake3::Hasher,
    /// Where all blocks are, and the payloads of all but chunks.
    places: Vec<BlockPlace>,
    payloads: Vec<Vec<u8>>,
}

impl<'p> Scan<'p> {
    fn new(path: &'p Path, file: File, size: u64) -> Self {
        Self {
            path,
            input: BufReader::with_capacity(PART, file),
            at: 0,
            size,
            hasher: blake3::Hasher::new(),
            places: Vec::new(),
            payloads: Vec::new(),
        }
    }

    /// Tells what is wrong with the file.
    fn wrong<T>(&self, error: BundleError) -> Result<T, Error> {
        Err(error.about(self.path))
    }

    /// Reads all blocks and checks their checksums and the hash of all; returns where they are, and the payloads of all but
    /// chunks.
    fn blocks(mut self) -> Result<(Vec<BlockPlace>, Vec<Vec<u8>>), Error> {
        // A file that is shorter than its start may still be told from other kinds of files.
        let start = self.bytes(self.size.min(START as u64))?;
        check_start(&start).or_else(|e| self.wrong(e))?;
        let body = self.size.checked_sub(HASH as u64);
        let Some(body) = body.filter(|body| *body >= START as u64) else {
            return self.wrong(BundleError::Truncated(self.size));
        };
        while self.at < body {
            self.block(body)?;
        }
        let hash = self.hasher.finalize();
        match self.bytes(HASH as u64)? == hash.as_bytes() {
            true => Ok((self.places, self.payloads)),
            false => self.wrong(BundleError::Hash),
        }
    }

    /// Reads the block that begins here, in a file whose blocks end at `body`.
    fn block(&mut self, body: u64) -> Result<(), Error> {
        let start = self.at;
        let cut = BundleError::Truncated(self.size);
        let around = (BLOCK_HEAD + CHECKSUM) as u64;
        let whole = self.hasher.finalize();
        let head = self.bytes(BLOCK_HEAD as u64)?;
        if whole.as_bytes().starts_with(&head) {
            return self.wrong(BundleError::Appended(self.size - start - HASH as u64));
        }
        let Some(room) = (body - start).checked_sub(around) else {
            return self.wrong(cut);
        };
        let Ok(place) = BlockPlace::read(&head, start) else {
            return self.wrong(BundleError::Block(start));
        };
        if place.length > room {
            return self.wrong(cut);
        }
        let mut sum = Xxh3::new();
        sum.update(&head);
        if place.kind == BlockKind::Chunk as u8 {
            self.skip(place.length, &mut sum)?;
        } else {
            if place.kind == BlockKind::Header as u8 && place.length > MOST_HEADER_BYTES as u64 {
                return self.wrong(BundleError::Limit {
                    what: "bytes of its header",
                    found: place.length,
                    most: MOST_HEADER_BYTES as u64,
                });
            }
            let payload = self.bytes(place.length)?;
            sum.update(&payload);
            self.payloads.push(payload);
        }
        if self.bytes(CHECKSUM as u64)? != sum.digest().to_le_bytes() {
            return self.wrong(BundleError::Block(start));
        }
        self.places.push(place);
        Ok(())
    }

    /// Reads the next `count` bytes, which the file has.
    fn bytes(&mut self, count: u64) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let input = self.input.by_ref().take(count);
        { input }
            .read_to_end(&mut bytes)
            .map_err(|e| Error::io(self.path, e))?;
        // Somebody may shorten it meanwhile.
        if (bytes.len() as u64) < count {
            return self.wrong(BundleError::Truncated(self.at + bytes.len() as u64));
        }
        self.hasher.update(&bytes);
        self.at += count;
        Ok(bytes)
    }

    /// Passes over the next bytes, which only the checksums see.
    fn skip(&mut self, count: u64, sum: &mut Xxh3) -> Result<(), Error> {
        let mut left = count;
        while left > 0 {
            let part = self.bytes(left.min(PART as u64))?;
            sum.update(&part);
            left -= part.len() as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Contents, PlanRecord, ShardRecord,
        container::{self, MAGIC, MOST_BYTES},
    };
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use std::{fs, sync::Arc};

    const FLAT: &str = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
                        [cameras]\nparameters = { c = [-1, 1] }\nat = ['c', '0', '0']\nlength = 5\n";

    /// The bytes of the second shard of two, of chunks that nobody decodes.
    fn shard() -> Vec<u8> {
        let manifold = Manifold::from_source(SourceText::new("flat.toml", FLAT), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let plan = PlanRecord::new(5.0, 0.5, vec![1], vec![1, 1, 1, 1]);
        let payload = |k: u32| (k, vec![k as u8; 7 * k as usize * PART / 10]);
        let chunks = [1, 3, 5].map(payload).to_vec();
        let mut contents = Contents::new(space, plan, 0, chunks).unwrap();
        contents.header.shard = Some(ShardRecord {
            index: 2,
            of: 2,
            exact_rays: 9,
        });
        contents.encode().unwrap()
    }

    fn opened(bytes: &[u8]) -> Result<StoredContents, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.fan");
        fs::write(&path, bytes).unwrap();
        StoredContents::open(&path)
    }

    #[test]
    fn chunks_are_those_of_a_file_read_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.fan");
        fs::write(&path, shard()).unwrap();
        let stored = StoredContents::open(&path).unwrap();
        let whole = Contents::read(&path).unwrap();
        assert_eq!((stored.id, &stored.header), (whole.id, &whole.header));
        let found = stored
            .chunks
            .list()
            .map(|(k, _)| (k, stored.chunks.read(k).unwrap()));
        assert!(found.eq(whole.chunks));
        // And written again.
        let again = folder.path().join("b.fan");
        let chunks: Vec<(u32, u64)> = stored.chunks.list().collect();
        let parts = (&stored.header, stored.id, &stored.space);
        let size = write_chunks(&again, parts, &chunks, |k| stored.chunks.read(k)).unwrap();
        assert!(fs::read(&again).unwrap() == shard() && size == shard().len() as u64);
        let gone = |_| Err(Error::input("1.fan", "is gone"));
        let error = write_chunks(&again, parts, &chunks, gone).unwrap_err();
        assert_eq!(error.to_string(), "1.fan: is gone");
        assert!(fs::read(&again).unwrap() == shard(), "the old file stays");
        assert!(stored.chunks.read(0).is_err() && stored.chunks.read(6).is_err());
        // Changed since it was opened.
        let mut bytes = fs::read(&path).unwrap();
        let at = bytes.len() - HASH - CHECKSUM - 1;
        bytes[at] ^= 1;
        fs::write(&path, bytes).unwrap();
        assert!(stored.chunks.read(3).is_ok() && stored.chunks.read(5).is_err());
    }

    #[test]
    fn damage_is_told_as_of_a_file_read_whole() {
        let bytes = shard();
        let told = |damaged: &[u8]| {
            let whole = container::decode(damaged).map(|_| ()).unwrap_err();
            let stored = opened(damaged).unwrap_err().to_string();
            assert!(stored.contains(&whole.to_string()), "{stored}, {whole}");
        };
        let bits = [
            0,
            6,
            11,
            40,
            5000,
            bytes.len() / 2,
            bytes.len() - 45,
            bytes.len() - 1,
        ];
        for byte in bits {
            let mut damaged = bytes.clone();
            damaged[byte] ^= 1;
            told(&damaged);
        }
        for length in [0, 5, 12, 14, 30, 60, 5000, bytes.len() - 40] {
            told(&bytes[..length]);
        }
    }

    #[test]
    fn a_header_that_would_not_fit_and_files_that_cannot_be_searched_are_refused() {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(container::VERSION.to_le_bytes());
        bytes.push(BlockKind::Header as u8);
        bytes.extend([0; 4]);
        bytes.extend(MOST_BYTES.to_le_bytes());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.fan");
        fs::write(&path, bytes).unwrap();
        // Holes take no room on the disk.
        fs::File::options()
            .append(true)
            .open(&path)
            .unwrap()
            .set_len(2 * MOST_BYTES)
            .unwrap();
        let error = StoredContents::open(&path).unwrap_err().to_string();
        assert!(error.contains("bytes of its header"), "{error}");
        assert!(StoredContents::open(folder.path()).is_err());
    }
}
