//! Files of finished chunks while a bake is under way.
//!
//! In: chunks as they are finished. Out: the chunks again after an interruption. Each is an immutable file
//! `B.fan.parts/chunk-000123`, written whole or not at all, one checksummed block with the bundle's
//! id: a damaged file, or one of another bake, is as good as none.

use geofan_bundle::{
    ByteReader, TensorShape, Tree,
    container::{BlockKind, Id, put_block, read_block},
    put_bytes,
};
use geofan_core::{Error, Result, files::write_atomically};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// A chunk and the rays that it took.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BakedChunk {
    /// The coded tree.
    pub tree: Vec<u8>,
    /// Rays integrated for it.
    pub rays: u64,
}

/// The folder beside one output file with its finished chunks.
#[derive(Debug, Clone)]
pub struct ChunkFiles {
    folder: PathBuf,
}

/// Chunks of another version are baked again: its refinement may differ.
const GENERATOR: &str = env!("CARGO_PKG_VERSION");

/// Beginnings of the names of all files that belong here; the last is that of a write cut off.
const NAMES: [&str; 3] = ["chunk-", "exceeds-", ".geofan-"];

impl ChunkFiles {
    /// Opens the folder beside `output`, and makes it if need be; the one that `output` lies in exists.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn open(output: &Path) -> Result<Self> {
        let mut name = output.as_os_str().to_owned();
        name.push(".parts");
        let folder = PathBuf::from(name);
        if folder.is_dir() {
            return Ok(Self { folder });
        }
        match fs::create_dir(&folder) {
            Ok(()) => Ok(Self { folder }),
            Err(source) => Err(Error::Environment {
                path: folder.display().to_string(),
                source,
            }),
        }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the name of the file of `chunk`.
    fn path(&self, chunk: u32) -> PathBuf {
        self.folder.join(format!("chunk-{chunk:06}"))
    }

    /// Reads a finished chunk, if it is there, whole, and of the bundle `id` with tensors of this `shape`.
    pub fn load(&self, chunk: u32, id: Id, shape: TensorShape) -> Option<BakedChunk> {
        let bytes = fs::read(self.path(chunk)).ok()?;
        let payload = read_block(&bytes, BlockKind::Part, chunk, id)?;
        let mut input = ByteReader(payload);
        if input.bytes().ok()? != GENERATOR.as_bytes() {
            return None;
        }
        let rays = u64::from_le_bytes(input.bytes().ok()?.try_into().ok()?);
        let tree = input.0.to_vec();
        // Only what this version would have written: the same bytes again.
        let again = Tree::decode(&tree, shape).ok()?.encode();
        (again == tree).then_some(BakedChunk { tree, rays })
    }

    /// Writes a finished chunk.
    ///
    /// # Errors
    /// The disk is full or the folder is gone.
    pub fn store(&self, chunk: u32, id: Id, baked: &BakedChunk) -> Result<()> {
        let mut payload = Vec::new();
        put_bytes(&mut payload, GENERATOR.as_bytes());
        put_bytes(&mut payload, &baked.rays.to_le_bytes());
        payload.extend(&baked.tree);
        let mut block = Vec::new();
        put_block(&mut block, BlockKind::Part, chunk, id, &payload);
        write_atomically(&self.path(chunk), |out| out.write_all(&block))
    }

    /// Notes that the bundle `id` takes more than `bytes`.
    ///
    /// # Errors
    /// As [`ChunkFiles::store`].
    pub fn note_size(&self, id: Id, bytes: u64) -> Result<()> {
        write_atomically(&self.note(id), |out| out.write_all(&bytes.to_le_bytes()))
    }

    /// Returns the size that the bundle `id` was noted to exceed.
    pub fn noted_size(&self, id: Id) -> Option<u64> {
        let bytes = fs::read(self.note(id)).ok()?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    }

    /// Returns the name of the note about the bundle `id`.
    fn note(&self, id: Id) -> PathBuf {
        let name: String = id.iter().map(|b| format!("{b:02x}")).collect();
        self.folder.join(format!("exceeds-{name}"))
    }

    /// Removes all chunks, of any bake; returns how many there were.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn discard(&self) -> Result<usize> {
        let failed = |e| Error::io(&self.folder, e);
        let mut chunks = 0;
        for entry in fs::read_dir(&self.folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if NAMES.iter().any(|start| name.starts_with(start)) {
                fs::remove_file(entry.path()).map_err(|e| Error::io(&entry.path(), e))?;
                chunks += usize::from(name.starts_with(NAMES[0]));
            }
        }
        Ok(chunks)
    }

    /// Removes the folder with all chunks; other files in it stay, and it with them.
    ///
    /// # Errors
    /// As [`ChunkFiles::discard`].
    pub fn remove(&self) -> Result<()> {
        self.discard()?;
        if let Err(error) = fs::remove_dir(&self.folder) {
            tracing::warn!("{} stays: {error}", self.folder.display());
        }
        Ok(())
    }
}
