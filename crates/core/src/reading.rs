//! Reading files within limits: what a user names may be a device that never ends.
//!
//! In: a path and the most that may be read from it. Out: its bytes or its text.

use crate::{
    diagnostic::SourceText,
    error::{Error, Result},
};
use std::{fs::File, io::Read, path::Path, sync::Arc};

/// The most bytes that are read from anything but a plain file, such as a pipe.
const MOST_OF_A_STREAM: u64 = 256 << 20;

/// The most bytes of a text that people write: manifolds, scenes, camera paths.
const MOST_OF_A_TEXT: u64 = 64 << 20;

/// The most bytes of a file that may be long, such as a mesh or a picture: more does not fit into the memory
/// of the machines that have to show it.
pub const MOST_OF_A_FILE: u64 = 4 << 30;

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
    let failed = |e| Error::io(path, e);
    let mut file = File::open(path).map_err(failed)?;
    let found = file.metadata().map_err(failed)?;
    let most = if found.is_file() {
        most
    } else {
        most.min(MOST_OF_A_STREAM)
    };
    let too_long = || {
        Error::input(
            path.display().to_string(),
            format!("is longer than {most} bytes"),
        )
    };
    if found.is_file() && found.len() > most {
        return Err(too_long());
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
        true => Err(too_long()),
        false => Ok(bytes),
    }
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
    fn a_device_is_no_text() {
        if cfg!(unix) {
            assert_eq!(
                read_text(Path::new("/dev/zero")).unwrap_err().exit_code(),
                2
            );
        }
    }
}
