//! Files that are either whole or not there.
//!
//! In: a path and something that writes bytes. Out: the file under that path, complete and on the
//! disk, or the state from before: a reader never meets half a file, and a full disk or a killed
//! process leaves the last good one in place. Temporary files that a killed process leaves behind are
//! removed by the next one that writes into the folder ([`check_output`]).

use crate::error::{Error, Result};
use std::{
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

/// Beginning and end of the names of temporary files.
const TEMPORARY: [&str; 2] = [".geofan-", ".part"];

/// The most symbolic links followed from one path, as on Linux.
const MOST_LINKS: usize = 40;

/// Refuses an output that could not be written, before work is spent on it: a folder, a device, a place in
/// a folder that is not there or takes no files. Removes what killed processes left in that folder.
///
/// # Errors
/// It could not be written: why, and what to do.
pub fn check_output(path: &Path) -> Result<()> {
    let target = resolved_target(path)?;
    let folder = existing_folder(path, &target)?;
    remove_unfinished(folder);
    new_temporary(folder)
        .map(drop)
        .map_err(|source| Error::Environment {
            path: path.display().to_string(),
            source,
        })
}

/// Refuses an output that is one of the `files` that are read for it: it would take their place.
///
/// # Errors
/// Names it.
pub fn check_not_read(output: &Path, files: &[PathBuf]) -> Result<()> {
    let Ok(target) = fs::canonicalize(output) else {
        return Ok(());
    };
    let same = |file: &PathBuf| fs::canonicalize(file).is_ok_and(|file| file == target);
    match files.iter().any(same) {
        true => Err(Error::input(
            output.display().to_string(),
            "is read for this, and would be replaced; name another output",
        )),
        false => Ok(()),
    }
}

/// Makes a folder for outputs, if it is not there, and removes what killed processes left in it.
///
/// # Errors
/// It cannot be made.
pub fn make_output_folder(folder: &Path) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        let name = folder.display().to_string();
        return Err(Error::input(name, "is a file; a folder is needed"));
    }
    fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    remove_unfinished(folder);
    Ok(())
}

/// Removes temporary files of processes that are gone from `folder`; whatever cannot be removed stays.
pub fn remove_unfinished(folder: &Path) {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let [start, end] = TEMPORARY;
        let ours = name.starts_with(start) && name.ends_with(end);
        if !ours || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        // Whoever still writes it holds the lock, which ends with the process.
        let Ok(file) = File::open(entry.path()) else {
            continue;
        };
        if file.try_lock().is_ok() {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Writes a file through a temporary neighbour that takes the final name only when it is complete
/// and on the disk. A symbolic link is followed: the file it points to is replaced.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    write_and_rename(path, true, write)
}

/// Writes a file like [`write_atomically`], but does not wait for the disk: for what tells when it is damaged, and can be made
/// again.
pub fn write_without_waiting(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    write_and_rename(path, false, write)
}

/// Writes a file through a temporary neighbour; `waits` until it is on the disk.
fn write_and_rename(
    path: &Path,
    waits: bool,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    let target = resolved_target(path)?;
    let folder = existing_folder(path, &target)?;
    rename_written(&target, folder, waits, write).map_err(|source| Error::Environment {
        path: path.display().to_string(),
        source,
    })
}

/// Returns the file that `path` stands for, behind any symbolic links, whether it is there or not. Anything
/// there that is not a plain file is refused: renaming over a folder fails late, and renaming over a device
/// or a pipe would remove it.
fn resolved_target(path: &Path) -> Result<PathBuf> {
    let refuse = |message: &str| Err(Error::input(path.display().to_string(), message));
    let names_a_folder = path.as_os_str().as_encoded_bytes().last();
    if path.file_name().is_none()
        || names_a_folder.is_some_and(|b| std::path::is_separator(char::from(*b)))
    {
        return refuse("is not the name of a file");
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => return refuse("is a folder, a file is needed"),
        Ok(found) if !found.is_file() => return refuse("is not a plain file"),
        Ok(_) => return fs::canonicalize(path).map_err(|e| Error::io(path, e)),
        Err(_) => {}
    }
    // Nothing is there yet; a link to it stays a link.
    let mut target = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&target) {
            Ok(next) => target = containing_folder(&target).join(next),
            Err(_) => return Ok(target),
        }
    }
    refuse("is a symbolic link to itself")
}

/// Returns the folder of `target`, the file that `path` stands for; a bare name lies in the current folder.
fn existing_folder<'t>(path: &Path, target: &'t Path) -> Result<&'t Path> {
    let folder = containing_folder(target);
    if folder.is_dir() {
        return Ok(folder);
    }
    let message = format!("the folder {} does not exist", folder.display());
    Err(Error::input(path.display().to_string(), message))
}

/// Returns the folder of `path`; a bare name lies in the current folder.
pub fn containing_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Writes beside the target, forces the bytes to the disk, renames, and forces the rename too.
fn rename_written(
    target: &Path,
    folder: &Path,
    waits: bool,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    let mut temporary = new_temporary(folder)?;
    let mut writer = BufWriter::new(temporary.as_file_mut());
    write(&mut writer)?;
    writer.flush()?;
    drop(writer);
    if waits {
        temporary.as_file().sync_all()?;
    }
    // The file stays open, and with it its lock, until it has its name.
    let (_file, own_path) = temporary.keep().map_err(|e| e.error)?;
    fs::rename(&own_path, target).inspect_err(|_| {
        let _ = fs::remove_file(&own_path);
    })?;
    match waits {
        true => sync_folder(folder),
        false => Ok(()),
    }
}

/// Makes a temporary file that is locked as long as it is open, so that [`remove_unfinished`] leaves it
/// alone.
fn new_temporary(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    loop {
        let temporary = unlocked_temporary(folder)?;
        // Where files cannot be locked none is removed either.
        let _ = temporary.as_file().lock();
        // It may have been taken for a left-over just before.
        if temporary.path().exists() {
            return Ok(temporary);
        }
    }
}

/// Makes a temporary file with the permissions of an ordinary one: 0666 less the umask, where the
/// temporary-file default of 0600 would hide finished pictures from everybody else.
fn unlocked_temporary(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY[0]).suffix(TEMPORARY[1]);
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

    /// Lists the names of the files in a folder.
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

    #[test]
    #[cfg(unix)]
    fn a_link_to_nothing_yet_becomes_a_link_to_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::os::unix::fs::symlink("file", &link).unwrap();
        check_output(&link).unwrap();
        write_atomically(&link, |out| out.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        // Into a folder that is not there, and in a circle.
        let lost = folder.path().join("lost");
        std::os::unix::fs::symlink("no-such-folder/file", &lost).unwrap();
        assert_eq!(check_output(&lost).unwrap_err().exit_code(), 2);
        let circle = folder.path().join("circle");
        std::os::unix::fs::symlink("circle", &circle).unwrap();
        assert_eq!(check_output(&circle).unwrap_err().exit_code(), 2);
    }

    #[test]
    fn an_output_that_could_not_be_written_is_refused_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| check_output(path).unwrap_err().exit_code();
        assert_eq!(refused(folder.path()), 2);
        assert_eq!(refused(&folder.path().join("a.fan/")), 2);
        assert_eq!(refused(&folder.path().join("no-such-folder/a.fan")), 2);
        if cfg!(target_os = "linux") {
            assert_eq!(refused(Path::new("/dev/full")), 2);
            // No one can make files there.
            assert_eq!(refused(Path::new("/proc/a.fan")), 3);
        }
        check_output(&folder.path().join("a.fan")).unwrap();
        assert!(names_in(folder.path()).is_empty(), "nothing is left");
    }

    #[test]
    fn files_of_killed_processes_are_removed_and_those_being_written_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let left = folder.path().join(".geofan-dead00.part");
        fs::write(&left, b"half").unwrap();
        fs::write(folder.path().join(".geofan-notes"), b"mine").unwrap();
        let path = folder.path().join("a.bin");
        write_atomically(&path, |out| {
            out.write_all(b"whole")?;
            remove_unfinished(folder.path());
            Ok(())
        })
        .unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        let mut names = names_in(folder.path());
        names.sort();
        assert_eq!(names, [".geofan-notes", "a.bin"]);
    }
}
