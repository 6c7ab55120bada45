//! Files that are either whole or not there.
//!
//! In: a path and something that writes bytes. Out: the file under that path, complete and on the
//! disk, or the state from before: a reader never meets half a file, and a full disk or a killed
//! process leaves the last good one in place.

use crate::error::{Error, Result};
use std::{
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

/// Writes a file through a temporary neighbour that takes the final name only when it is complete
/// and on the disk. A symbolic link is followed: the file it points to is replaced.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    let target = resolved_target(path)?;
    let folder = containing_folder(&target);
    if !folder.is_dir() {
        let message = format!("the folder {} does not exist", folder.display());
        return Err(Error::input(path.display().to_string(), message));
    }
    write_and_rename(&target, folder, write).map_err(|source| Error::Environment {
        path: path.display().to_string(),
        source,
    })
}

/// The file that `path` stands for. Anything there that is not a plain file is refused: renaming
/// over a folder fails late, and renaming over a device or a pipe would remove it.
fn resolved_target(path: &Path) -> Result<PathBuf> {
    let refuse = |message: &str| Err(Error::input(path.display().to_string(), message));
    if path.file_name().is_none() {
        return refuse("is not the name of a file");
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => refuse("is a folder, a file is needed"),
        Ok(found) if !found.is_file() => refuse("is not a plain file"),
        Ok(_) => fs::canonicalize(path).map_err(|e| Error::io(path, e)),
        Err(_) => Ok(path.to_path_buf()),
    }
}

/// The folder of `path`; a bare name lies in the current folder.
fn containing_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Writes beside the target, forces the bytes to the disk, renames, and forces the rename too.
fn write_and_rename(
    target: &Path,
    folder: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    let mut temporary = new_temporary(folder)?;
    let mut writer = BufWriter::new(temporary.as_file_mut());
    write(&mut writer)?;
    writer.flush()?;
    drop(writer);
    temporary.as_file().sync_all()?;
    temporary.persist(target).map_err(|e| e.error)?;
    sync_folder(folder)
}

/// A temporary file with the permissions of an ordinary one: 0666 less the umask, where the
/// temporary-file default of 0600 would hide finished pictures from everybody else.
fn new_temporary(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".geofan-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let open_to_all = fs::Permissions::from_mode(0o666);
        builder.permissions(open_to_all).tempfile_in(folder)
    }
    #[cfg(not(unix))]
    builder.tempfile_in(folder)
}

/// Puts the folder's entry for a new name on the disk; only Unix opens folders as files.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn a_written_file_holds_the_bytes_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_atomically(&path, |out| out.write_all(b"first")).unwrap();
        write_atomically(&path, |out| out.write_all(b"second")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(names_in(folder.path()), ["a.bin"]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let failure = write_atomically(&path, |out| {
            out.write_all(&[0; 100_000])?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert_eq!(failure.unwrap_err().exit_code(), 3);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["a.bin"]);
    }

    #[test]
    fn a_missing_folder_is_named_as_bad_input() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no-such-folder").join("a.bin");
        let failure = write_atomically(&path, |_| Ok(())).unwrap_err();
        assert_eq!(failure.exit_code(), 2);
        assert!(
            failure
                .to_string()
                .contains("no-such-folder does not exist")
        );
    }

    #[test]
    fn a_folder_or_a_device_in_the_way_is_refused_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let failure = write_atomically(folder.path(), |_| Ok(())).unwrap_err();
        assert_eq!(failure.exit_code(), 2);
        assert!(folder.path().is_dir());
        if cfg!(unix) {
            assert!(resolved_target(Path::new("/dev/null")).is_err());
        }
    }

    #[test]
    #[cfg(unix)]
    fn permissions_are_those_of_an_ordinary_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (atomic, ordinary) = (folder.path().join("a"), folder.path().join("b"));
        write_atomically(&atomic, |_| Ok(())).unwrap();
        fs::write(&ordinary, b"").unwrap();
        let mode = |path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&atomic), mode(&ordinary));
    }

    #[test]
    #[cfg(unix)]
    fn a_symbolic_link_keeps_pointing_at_the_replaced_file() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, b"old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomically(&link, |out| out.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
    }
}
