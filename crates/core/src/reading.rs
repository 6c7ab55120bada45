//! Reading files within limits: what a user names may be a device that never ends.
//!
//! In: a path and the most that may be read from it. Out: its bytes or its text. Where there is no disk, or
//! where somebody must know which files are read, the caller's own source stands before it ([`with_source`]).

use crate::{
    diagnostic::SourceText,
    error::{Error, Result},
};
use std::{
    cell::RefCell,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
    rc::Rc,
    sync::Arc,
};

/// The most bytes that are read from anything but a plain file, such as a pipe.
const MOST_OF_A_STREAM: u64 = 256 << 20;

/// The most bytes of a text that people write: manifolds, scenes, camera paths.
const MOST_OF_A_TEXT: u64 = 64 << 20;

/// The most bytes of a file that may be long, such as a mesh or a picture: more does not fit into the memory
/// of the machines that have to show it.
pub const MOST_OF_A_FILE: u64 = 4 << 30;

/// Tells the bytes of the file at a path; `None` leaves it to the disk.
pub type FileSource = Rc<dyn Fn(&Path) -> Option<Vec<u8>>>;

thread_local! {
    /// Stands before the disk for this thread.
    static SOURCE: RefCell<Option<FileSource>> = const { RefCell::new(None) };
}

/// Does `work` with `source` before the disk, for all that this thread reads by [`read_file`] and
/// [`read_text`].
pub fn with_source<T>(source: FileSource, work: impl FnOnce() -> T) -> T {
    let before = SOURCE.replace(Some(source));
    let done = work();
    SOURCE.set(before);
    done
}

/// Does `work`; also returns the files that this thread asked for in it, whether they are there or not.
pub fn noting<T>(work: impl FnOnce() -> T) -> (T, Vec<PathBuf>) {
    let paths: Rc<RefCell<Vec<PathBuf>>> = Rc::default();
    let (noted, before) = (paths.clone(), SOURCE.with_borrow(Clone::clone));
    let source: FileSource = Rc::new(move |path: &Path| {
        let mut noted = noted.borrow_mut();
        if !noted.iter().any(|known| known == path) {
            noted.push(path.to_path_buf());
        }
        before.as_ref().and_then(|before| before(path))
    });
    let done = with_source(source, work);
    let noted = paths.take();
    (done, noted)
}

/// Returns the bytes that the caller's source has of a file.
fn from_source(path: &Path) -> Option<Vec<u8>> {
    let source = SOURCE.with_borrow(Clone::clone);
    source.and_then(|source| source(path))
}

/// Tells whether there is a file, in the caller's source or on the disk.
pub fn exists(path: &Path) -> bool {
    from_source(path).is_some() || path.exists()
}

/// Reads a file of at most `most` bytes whole; only its first bytes if they are not `magic`.
///
/// # Errors
/// It cannot be read, or is longer; nothing longer is read into memory.
pub fn read_file(path: &Path, magic: &[u8], most: u64) -> Result<Vec<u8>> {
    read_one_of(path, &[magic], most)
}

/// Reads a file of at most `most` bytes whole; only its first bytes if it begins like none of `magics`.
///
/// # Errors
/// As of [`read_file`].
pub fn read_one_of(path: &Path, magics: &[&[u8]], most: u64) -> Result<Vec<u8>> {
    if let Some(mut bytes) = from_source(path) {
        if !magics.iter().any(|magic| bytes.starts_with(magic)) {
            bytes.truncate(magics.iter().map(|magic| magic.len()).max().unwrap_or(0));
        }
        return match bytes.len() as u64 > most {
            true => Err(too_long(path, most)),
            false => Ok(bytes),
        };
    }
    let failed = |e| Error::io(path, e);
    let mut file = File::open(path).map_err(failed)?;
    let found = file.metadata().map_err(failed)?;
    let most = if found.is_file() {
        most
    } else {
        most.min(MOST_OF_A_STREAM)
    };
    if found.is_file() && found.len() > most {
        return Err(too_long(path, most));
    }
    let mut bytes = Vec::new();
    let part = |file: &mut File, count: u64, bytes: &mut Vec<u8>| {
        let read = file.take(count).read_to_end(bytes);
        read.map_err(failed)
    };
    let start = magics.iter().map(|magic| magic.len()).max().unwrap_or(0) as u64;
    part(&mut file, start, &mut bytes)?;
    if magics.iter().any(|magic| bytes.starts_with(magic)) {
        let rest = most.saturating_sub(start).saturating_add(1);
        part(&mut file, rest, &mut bytes)?;
    }
    match bytes.len() as u64 > most {
        true => Err(too_long(path, most)),
        false => Ok(bytes),
    }
}

/// Complains about a file of more than `most` bytes.
fn too_long(path: &Path, most: u64) -> Error {
    let message = format!("is longer than {most} bytes");
    Error::input(path.display().to_string(), message)
}

/// Reads a whole text file.
///
/// # Errors
/// It cannot be read, is too long, or is not text.
pub fn read_text(path: &Path) -> Result<Arc<SourceText>> {
    let name = path.display().to_string();
    let bytes = read_file(path, &[], MOST_OF_A_TEXT)?;
    match String::from_utf8(bytes) {
        Ok(text) if !text.contains('\0') => Ok(SourceText::new(name, text)),
        Ok(_) => Err(Error::input(name, "is not text: it holds NUL bytes")),
        Err(_) if path.extension().is_some_and(|e| e == "fan") => Err(Error::input(
            name,
            "is no text; if it is a bundle, give it with --bundle, or look at it with `geofan info`",
        )),
        Err(_) => Err(Error::input(name, "is not UTF-8 text")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn reading_has_a_limit_and_begins_with_the_magic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        fs::write(&path, b"magic and more").unwrap();
        assert_eq!(read_file(&path, b"magic", 14).unwrap(), b"magic and more");
        assert_eq!(read_file(&path, b"", 99).unwrap(), b"magic and more");
        assert_eq!(read_file(&path, b"other", 99).unwrap(), b"magic");
        assert_eq!(read_file(&path, b"magic", 13).unwrap_err().exit_code(), 2);
        let either: [&[u8]; 2] = [b"longer magic", b"magic"];
        assert_eq!(read_one_of(&path, &either, 14).unwrap(), b"magic and more");
        assert_eq!(
            read_one_of(&path, &either[..1], 14).unwrap(),
            b"magic and mo"
        );
        assert_eq!(read_one_of(&path, &either, 13).unwrap_err().exit_code(), 2);
        if cfg!(unix) {
            let endless = Path::new("/dev/zero");
            assert_eq!(read_file(endless, b"magic", u64::MAX).unwrap(), [0; 5]);
            assert_eq!(read_file(endless, b"", 1 << 20).unwrap_err().exit_code(), 2);
        }
    }

    #[test]
    fn a_source_of_the_caller_stands_before_the_disk_while_its_work_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let [known, other] = ["known", "other"].map(|name| folder.path().join(name));
        fs::write(&other, b"disk").unwrap();
        let name = known.clone();
        let source: FileSource = Rc::new(move |path| (path == name).then(|| b"memory".to_vec()));
        with_source(source, || {
            assert!(exists(&known) && exists(&other));
            assert_eq!(read_file(&known, b"", 6).unwrap(), b"memory");
            assert_eq!(read_file(&known, b"", 5).unwrap_err().exit_code(), 2);
            assert_eq!(read_file(&known, b"other", 99).unwrap(), b"memor");
            assert_eq!(read_file(&other, b"", 99).unwrap(), b"disk");
        });
        assert!(!exists(&known));
    }

    #[test]
    fn a_device_is_no_text() {
        if cfg!(unix) {
            assert_eq!(
                read_text(Path::new("/dev/zero")).unwrap_err().exit_code(),
                2
            );
        }
    }

    #[test]
    fn what_is_read_is_noted_once_and_comes_from_the_source_before() {
        let source: FileSource =
            Rc::new(|path: &Path| path.ends_with("made").then(|| b"x".to_vec()));
        let work = || {
            for _ in 0..2 {
                assert!(read_file(Path::new("no/such/file"), &[], 9).is_err());
            }
            read_file(Path::new("made"), &[], 9).unwrap()
        };
        let (read, noted) = with_source(source, || noting(work));
        assert_eq!(read, b"x");
        assert_eq!(noted, ["no/such/file", "made"].map(PathBuf::from));
    }
}
