//! The files in which finished chunks are kept while a bake is under way.
//!
//! In: chunks as they are finished. Out: the chunks again after an interruption ([`ChunkFiles`]). Each is an immutable
//! file `B.fan.parts/chunk-000123`, written whole or not at all, one checksummed block with the bundle's
//! id: a damaged file, or one of another bake, is as good as none. Of a chunk under way what is decided about its boxes
//! is kept in `boxes-000123` ([`DecisionLog`]).
//!
//! One bake at a time has the folder: it holds a lock on the file `lock` in it, which says who it is and
//! ends with the process. Without, two bakes of one output would remove each other's chunks.

use crate::{
    attempts::SizeSoFar,
    refine::{DecisionLog, GENERATOR},
};
use geofan_bundle::{
    ByteReader, DecodeBudget, TensorShape, Tree,
    container::{BlockKind, Id, put_block, read_block},
    put_bytes,
};
use geofan_core::{Error, Observer, Result, files::write_atomically};
use std::{
    fs::{self, File, TryLockError},
    io::{self, Seek, Write},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
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
#[derive(Debug)]
pub struct ChunkFiles {
    folder: PathBuf,
    /// Held open, and with it the lock.
    _lock: File,
}

/// Beginnings of the names of all files that belong here: of finished chunks; of decisions about those under way; of notes
/// that a bundle is larger than so many bytes, and that its chunks are baked here; and of a write cut off.
const CHUNK: &str = "chunk-";
const BOXES: &str = "boxes-";
const EXCEEDS: &str = "exceeds-";
const PLAN: &str = "plan-";
const CUT_OFF: &str = ".geofan-";

/// Name of the file that whoever bakes holds a lock on.
const LOCK: &str = "lock";

/// Time between two tries to get the lock: short enough for a signal, long enough to cost nothing.
const BETWEEN_TRIES: Duration = Duration::from_millis(200);

impl ChunkFiles {
    /// Opens the folder beside `output`, and makes it if need be; the one that `output` lies in exists.
    ///
    /// # Errors
    /// It cannot be made, or another process bakes into it.
    pub fn open(output: &Path) -> Result<Self> {
        let folder = folder_beside(output);
        match Self::try_open(&folder)? {
            Ok(files) => Ok(files),
            Err(holder) => {
                let message = format!("{holder} bakes it; wait for that with --wait");
                Err(Error::Environment {
                    path: output.display().to_string(),
                    source: io::Error::new(io::ErrorKind::WouldBlock, message),
                })
            }
        }
    }

    /// Opens the folder like [`ChunkFiles::open`] as soon as no other process bakes into it.
    ///
    /// # Errors
    /// It cannot be made, or the observer ends the waiting.
    pub fn open_when_free(output: &Path, observer: &dyn Observer) -> Result<Self> {
        let folder = folder_beside(output);
        let mut told = String::new();
        loop {
            let holder = match Self::try_open(&folder)? {
                Ok(files) => return Ok(files),
                Err(holder) => holder,
            };
            if holder != told {
                tracing::info!("waiting: {holder} bakes {}", output.display());
                told = holder;
            }
            if observer.cancelled() {
                let resume = "it was waiting for another bake; nothing was begun".into();
                return Err(Error::Interrupted { resume });
            }
            std::thread::sleep(BETWEEN_TRIES);
        }
    }

    /// Makes the folder and locks it; or says in the inner result who has it.
    fn try_open(folder: &Path) -> Result<Result<Self, String>> {
        let failed = |source| Error::Environment {
            path: folder.display().to_string(),
            source,
        };
        let path = folder.join(LOCK);
        loop {
            match fs::create_dir(folder) {
                Err(_) if folder.is_file() => {
                    let message =
                        "is a file where chunks are to be kept; remove it, or name another output";
                    return Err(Error::input(folder.display().to_string(), message));
                }
                Err(e) if !folder.is_dir() => return Err(failed(e)),
                _ => {}
            }
            let options = File::options()
                .create(true)
                .truncate(false)
                .read(true)
                .write(true)
                .open(&path);
            let mut lock = match options {
                Ok(lock) => lock,
                // Its last holder has just removed the folder.
                Err(e) if e.kind() == io::ErrorKind::NotFound => continue,
                Err(e) => return Err(failed(e)),
            };
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(Err(holder_of(&path))),
                // Some network file systems have no locks.
                Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => {
                    tracing::warn!("{} cannot be locked: {e}", path.display());
                }
                Err(TryLockError::Error(e)) => return Err(failed(e)),
            }
            if !is_still_at(&path, &lock) {
                continue;
            }
            let written = lock.set_len(0).and_then(|()| lock.rewind());
            written
                .and_then(|()| lock.write_all(this_process().as_bytes()))
                .map_err(failed)?;
            return Ok(Ok(Self {
                folder: folder.into(),
                _lock: lock,
            }));
        }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the name of the file of `chunk`.
    fn path(&self, chunk: u32) -> PathBuf {
        self.folder.join(format!("{CHUNK}{chunk:06}"))
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
        let budget = Arc::new(DecodeBudget::for_bytes(tree.len()));
        let again = Tree::decode(&tree, shape, &budget).ok()?.encode();
        (again == tree).then_some(BakedChunk { tree, rays })
    }

    /// Opens the file of the decisions about `chunk` of the bundle `id`, whose tensors have this `shape`.
    ///
    /// # Errors
    /// The disk is full or the folder is gone.
    pub fn decisions(&self, chunk: u32, id: Id, shape: TensorShape) -> Result<DecisionLog> {
        DecisionLog::open(&self.decisions_path(chunk), chunk, id, shape)
    }

    /// Returns the name of the file of the decisions about `chunk`.
    fn decisions_path(&self, chunk: u32) -> PathBuf {
        self.folder.join(format!("{BOXES}{chunk:06}"))
    }

    /// Writes a finished chunk, and removes the decisions about it.
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
        write_atomically(&self.path(chunk), |out| out.write_all(&block))?;
        let decisions = self.decisions_path(chunk);
        match fs::remove_file(&decisions) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(Error::io(&decisions, e)),
            _ => Ok(()),
        }
    }

    /// Notes that chunks of the bundle `id` are baked here. To `resume`, they must not be there of other bundles alone.
    ///
    /// # Errors
    /// All that is there belongs to another space, or to other options; or as [`ChunkFiles::store`].
    pub fn begin(&self, id: Id, resume: bool) -> Result<()> {
        let own = self.named(PLAN, id);
        let names = self.names()?;
        let count = |start: &str| names.iter().filter(|name| name.starts_with(start)).count();
        let chunks = count(CHUNK) + count(BOXES);
        if resume && chunks > 0 && count(PLAN) > 0 && !own.exists() {
            let message = format!(
                "holds {chunks} chunks, finished or begun, of a bake of another space or with other options; go on with what that \
                 was begun with, name another output, or leave out --resume, which discards them"
            );
            return Err(Error::input(self.folder.display().to_string(), message));
        }
        write_atomically(&own, |_| Ok(()))
    }

    /// Notes that the bundle `id` takes more than this.
    ///
    /// # Errors
    /// As [`ChunkFiles::store`].
    pub fn note_size(&self, id: Id, size: SizeSoFar) -> Result<()> {
        write_atomically(&self.note(id), |out| out.write_all(&size.to_bytes()))
    }

    /// Returns the size that the bundle `id` was noted to exceed.
    pub fn noted_size(&self, id: Id) -> Option<SizeSoFar> {
        SizeSoFar::from_bytes(&fs::read(self.note(id)).ok()?)
    }

    /// Returns the name of the note about the size of the bundle `id`.
    fn note(&self, id: Id) -> PathBuf {
        self.named(EXCEEDS, id)
    }

    /// Returns the name of a file about the bundle `id`.
    fn named(&self, start: &str, id: Id) -> PathBuf {
        let name: String = id.iter().map(|b| format!("{b:02x}")).collect();
        self.folder.join(format!("{start}{name}"))
    }

    /// Lists the names of the folder's files.
    fn names(&self) -> Result<Vec<String>> {
        let failed = |e| Error::io(&self.folder, e);
        let entries = fs::read_dir(&self.folder).map_err(failed)?;
        let name = |entry: io::Result<fs::DirEntry>| {
            let name = entry.map_err(failed)?.file_name();
            Ok(name.to_string_lossy().into_owned())
        };
        entries.map(name).collect()
    }

    /// Removes all chunks, of any bake, finished or under way; returns how many there were.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn discard(&self) -> Result<usize> {
        let mut chunks = 0;
        for name in self.names()? {
            let is = |starts: &[&str]| starts.iter().any(|start| name.starts_with(start));
            if is(&[CHUNK, BOXES, EXCEEDS, PLAN, CUT_OFF]) {
                let path = self.folder.join(&name);
                fs::remove_file(&path).map_err(|e| Error::io(&path, e))?;
                chunks += usize::from(is(&[CHUNK, BOXES]));
            }
        }
        Ok(chunks)
    }

    /// Removes the folder if nothing has been written into it.
    ///
    /// # Errors
    /// As [`ChunkFiles::discard`].
    pub fn remove_unused(&self) -> Result<()> {
        let is_unused = self.names()?.iter().all(|name| name == LOCK);
        if is_unused { self.remove() } else { Ok(()) }
    }

    /// Removes the folder with all chunks; other files in it stay, and it with them.
    ///
    /// # Errors
    /// As [`ChunkFiles::discard`].
    pub fn remove(&self) -> Result<()> {
        self.discard()?;
        // Only now may another process lock the folder.
        let lock = self.folder.join(LOCK);
        fs::remove_file(&lock).map_err(|e| Error::io(&lock, e))?;
        if let Err(error) = fs::remove_dir(&self.folder) {
            tracing::warn!("{} stays: {error}", self.folder.display());
        }
        Ok(())
    }
}

/// Returns the folder for the chunks of `output`.
fn folder_beside(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

/// Names the process that has locked the file `path`, by what it has written there.
fn holder_of(path: &Path) -> String {
    let holder = fs::read_to_string(path).unwrap_or_default();
    match holder.trim() {
        "" => "another process".into(),
        holder => holder.into(),
    }
}

/// Tells whether the file `path` is still the one that was opened: a lock counts only there.
fn is_still_at(path: &Path, opened: &File) -> bool {
    let current = same_file::Handle::from_path(path).ok();
    let own = opened.try_clone().and_then(same_file::Handle::from_file);
    current == own.ok()
}

/// Names this process for others: its number and, where the system says it, its machine.
fn this_process() -> String {
    let number = std::process::id();
    match fs::read_to_string("/proc/sys/kernel/hostname") {
        Ok(machine) => format!("process {number} on {}", machine.trim()),
        Err(_) => format!("process {number}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::Progress;

    #[test]
    fn one_bake_at_a_time_has_the_folder() {
        let place = tempfile::tempdir().unwrap();
        let output = place.path().join("b.fan");
        let first = ChunkFiles::open(&output).unwrap();
        let second = ChunkFiles::open(&output).unwrap_err();
        assert_eq!(second.exit_code(), 3);
        let holder = format!("process {}", std::process::id());
        assert!(second.to_string().contains(&holder), "{second}");
        first.remove().unwrap();
        assert!(!place.path().join("b.fan.parts").exists());
        let third = ChunkFiles::open(&output).unwrap();
        // An interrupted bake leaves its folder, and no lock.
        drop(third);
        ChunkFiles::open(&output).unwrap();
    }

    /// Ends waiting at the first look.
    struct Impatient;

    impl Observer for Impatient {
        fn progress(&self, _: Progress<'_>) {}
        fn cancelled(&self) -> bool {
            true
        }
    }

    #[test]
    fn waiting_ends_with_the_other_bake_or_by_the_user() {
        let place = tempfile::tempdir().unwrap();
        let output = place.path().join("b.fan");
        let first = ChunkFiles::open(&output).unwrap();
        let ended = ChunkFiles::open_when_free(&output, &Impatient).unwrap_err();
        assert_eq!(ended.exit_code(), 75);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(BETWEEN_TRIES / 2);
                first.remove().unwrap();
                drop(first);
            });
            ChunkFiles::open_when_free(&output, &geofan_core::Unobserved).unwrap();
        });
    }
}
