//! The user's cache: tables of the viewer, and what scenes with large meshes take long to start with.
//!
//! In: work to be done. Out: its result; what it keeps ([`geofan_core::keeping`]) is in files that a later run of the
//! same program finds. Each has its bytes and their checksum (XXH3, 8 bytes); one that is damaged is as good as none. Files
//! are written while the work goes on, and the least recently used ones go when there are too many.

use geofan_core::{
    Error, Result,
    files::{make_output_folder, write_without_waiting},
    keeping::{ResultKey, ResultStore, with_store},
};
use std::{
    cell::RefCell,
    env,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    rc::Rc,
    thread::JoinHandle,
    time::SystemTime,
};
use xxhash_rust::xxh3::xxh3_64;

/// Most bytes of all results together: five scenes with a mesh of a million triangles.
const MOST_BYTES: u64 = 1 << 30;

/// Bytes of a checksum.
const CHECKSUM: usize = 8;

/// Returns a folder of the user's cache; `None` where the user wants none or the system names none. The variable
/// `GEOFAN_CACHE` names another folder, or, empty, none.
pub fn folder(name: &str) -> Option<PathBuf> {
    if let Some(own) = env::var_os("GEOFAN_CACHE") {
        return (!own.is_empty()).then(|| PathBuf::from(own).join(name));
    }
    let set = |name: &str| env::var_os(name).filter(|value| !value.is_empty());
    let base = match env::consts::OS {
        "windows" => PathBuf::from(set("LOCALAPPDATA")?),
        "macos" => PathBuf::from(set("HOME")?).join("Library/Caches"),
        _ => match set("XDG_CACHE_HOME") {
            Some(folder) => PathBuf::from(folder),
            None => PathBuf::from(set("HOME")?).join(".cache"),
        },
    };
    Some(base.join("geofan").join(name))
}

/// Does `work`, with the results that this thread keeps in the user's cache.
pub fn with_kept_results<T>(work: impl FnOnce() -> T) -> T {
    match (folder("starts"), build()) {
        (Some(folder), Some(build)) => with_results_in(folder, build, work),
        _ => work(),
    }
}

/// Does `work`, with the results that this thread keeps in files of `folder`, for the program `build`.
fn with_results_in<T>(folder: PathBuf, build: blake3::Hash, work: impl FnOnce() -> T) -> T {
    let store = Rc::new(CacheFolder {
        folder,
        build,
        writes: RefCell::default(),
    });
    let done = with_store(store.clone(), work);
    for write in store.writes.take() {
        // What could not be written is made again.
        let _ = write.join();
    }
    done
}

/// Names this very program: another may make other results of the same input.
fn build() -> Option<blake3::Hash> {
    let file = fs::metadata(env::current_exe().ok()?).ok()?;
    let written = file.modified().ok()?.duration_since(SystemTime::UNIX_EPOCH);
    let mut hasher = blake3::Hasher::new();
    hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
    hasher.update(&file.len().to_le_bytes());
    hasher.update(&written.ok()?.as_nanos().to_le_bytes());
    Some(hasher.finalize())
}

/// Results in the files of a folder.
struct CacheFolder {
    folder: PathBuf,
    build: blake3::Hash,
    /// Files that are being written.
    writes: RefCell<Vec<JoinHandle<Result<()>>>>,
}

impl CacheFolder {
    /// Returns the name of the file of `key`.
    fn path(&self, key: &ResultKey) -> PathBuf {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.build.as_bytes());
        hasher.update(key);
        self.folder.join(&hasher.finalize().to_hex()[..32])
    }
}

impl ResultStore for CacheFolder {
    fn get(&self, key: &ResultKey) -> Option<Vec<u8>> {
        let path = self.path(key);
        let mut bytes = fs::read(&path).ok()?;
        let (result, checksum) = bytes.split_last_chunk::<CHECKSUM>()?;
        if xxh3_64(result) != u64::from_le_bytes(*checksum) {
            return None;
        }
        bytes.truncate(bytes.len() - CHECKSUM);
        // It is the last to go.
        let file = File::options().write(true).open(&path);
        let _ = file.and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    fn put(&self, key: &ResultKey, bytes: Vec<u8>) {
        let (path, folder) = (self.path(key), self.folder.clone());
        let write = move || write(&path, &folder, &bytes);
        let thread = std::thread::Builder::new().name("cache".into());
        if let Ok(write) = thread.spawn(write) {
            self.writes.borrow_mut().push(write);
        }
    }
}

/// Writes a result, and makes room for it.
fn write(path: &Path, folder: &Path, bytes: &[u8]) -> Result<()> {
    make_output_folder(folder)?;
    write_without_waiting(path, |out| {
        out.write_all(bytes)?;
        out.write_all(&xxh3_64(bytes).to_le_bytes())
    })?;
    make_room(folder, MOST_BYTES).map_err(|e| Error::io(folder, e))
}

/// Removes the least recently used files, until all together have at most `most` bytes.
fn make_room(folder: &Path, most: u64) -> io::Result<()> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let file = entry.metadata()?;
        files.push((file.modified()?, file.len(), entry.path()));
    }
    files.sort();
    let mut all: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
    for (_, bytes, path) in files {
        if all <= most {
            break;
        }
        fs::remove_file(path)?;
        all -= bytes;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::keeping::{Keeping, kept};
    use std::time::Duration;

    /// Returns a text that is kept, and whether it had to be made.
    fn text(folder: &Path, build: &[u8]) -> (Vec<u8>, bool) {
        let mut made = false;
        let keeping = Keeping {
            key: || [1; 32],
            read: |bytes: &[u8]| Some(bytes.to_vec()),
            write: |bytes: &Vec<u8>| Some(bytes.clone()),
        };
        let work = || {
            kept(keeping, || {
                made = true;
                Ok::<_, ()>(b"a text".to_vec())
            })
        };
        let text = with_results_in(folder.into(), blake3::hash(build), work);
        (text.unwrap(), made)
    }

    #[test]
    fn results_are_found_again_by_the_same_program_unless_they_are_damaged() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("starts");
        let expected = |made| (b"a text".to_vec(), made);
        assert_eq!(text(&folder, b"one"), expected(true));
        assert_eq!(text(&folder, b"one"), expected(false));
        assert_eq!(text(&folder, b"another"), expected(true));
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let mut bytes = fs::read(&path).unwrap();
            bytes[2] ^= 1;
            fs::write(path, bytes).unwrap();
        }
        assert_eq!(text(&folder, b"one"), expected(true));
        assert_eq!(text(&folder, b"one"), expected(false));
    }

    #[test]
    fn what_was_not_asked_for_longest_makes_room() {
        let place = tempfile::tempdir().unwrap();
        for age in 0..4 {
            let path = place.path().join(age.to_string());
            fs::write(&path, [0; 10]).unwrap();
            let time = SystemTime::now() - Duration::from_secs(60 * age);
            File::options()
                .write(true)
                .open(path)
                .and_then(|file| file.set_modified(time))
                .unwrap();
        }
        make_room(place.path(), 25).unwrap();
        let left = |age: u64| place.path().join(age.to_string()).exists();
        assert_eq!([0, 1, 2, 3].map(left), [true, true, false, false]);
    }

    #[test]
    fn a_folder_that_takes_no_files_is_no_matter() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, b"").unwrap();
        assert_eq!(
            text(&file.join("starts"), b"one"),
            (b"a text".to_vec(), true)
        );
    }
}
