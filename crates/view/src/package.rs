//! A scene with all of its files in one piece, for where there is no disk.
//!
//! In: files by their paths. Out: bytes, and from bytes a source that files are read from
//! ([`geofan_core::reading::with_source`]). Layout, little-endian: the magic, a hash (BLAKE3, 32 bytes)
//! of all that follows, the number of files (u32), and for each the length of its name (u32), the name, the
//! length of its content (u32), and the content. Names are those of
//! paths from a common folder, so that a package tells nothing about the disk that it was made on.

use geofan_core::{Error, Result, reading::FileSource};
use std::{
    path::{Component, Path, PathBuf},
    rc::Rc,
};

const MAGIC: &[u8; 16] = b"geofan package1\n";

/// Files by name; copies of it share their contents.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Package {
    files: Vec<(String, Rc<[u8]>)>,
}

/// Removes `.` and `name/..` from a path without asking the disk.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if plain.file_name().is_some_and(|name| name != "..") => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    plain
}

impl Package {
    /// Packs files of these paths; their common folder is left out of their names. Returns the new name of the
    /// first.
    pub fn of_files(files: Vec<(PathBuf, Vec<u8>)>) -> (Self, String) {
        let files: Vec<(PathBuf, Vec<u8>)> = files
            .into_iter()
            .map(|(path, bytes)| (plain(&std::path::absolute(&path).unwrap_or(path)), bytes))
            .collect();
        let mut common = files
            .first()
            .and_then(|(path, _)| path.parent())
            .map(Path::to_path_buf)
            .unwrap_or_default();
        while !files.iter().all(|(path, _)| path.starts_with(&common)) && common.pop() {}
        let name = |path: &Path| {
            let parts = path.strip_prefix(&common).unwrap_or(path).components();
            let parts: Vec<_> = parts
                .map(|part| part.as_os_str().to_string_lossy())
                .collect();
            parts.join("/")
        };
        let mut package = Self::default();
        for (path, bytes) in &files {
            package.add(&name(path), bytes.clone());
        }
        let first = files.first().map(|(path, _)| name(path));
        (package, first.unwrap_or_default())
    }

    /// Adds a file; an earlier one of that name is replaced.
    pub fn add(&mut self, name: &str, bytes: Vec<u8>) {
        self.files.retain(|(known, _)| known != name);
        self.files.push((name.into(), bytes.into()));
    }

    /// Returns the content of a file.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        let found = self.files.iter().find(|(known, _)| known == name);
        found.map(|(_, bytes)| &**bytes)
    }

    /// Makes a source of the files.
    pub fn source(self) -> FileSource {
        Rc::new(move |path: &Path| self.named_by(path).map(<[u8]>::to_vec))
    }

    /// Returns the content of the file that a text in here calls `path`: one from the root of the disk may end in a
    /// name, because the folders before it are not told.
    fn named_by(&self, path: &Path) -> Option<&[u8]> {
        let asked = plain(path);
        if !asked.has_root() {
            return self.get(&asked.to_string_lossy().replace('\\', "/"));
        }
        let ending = |(name, _): &&(String, Rc<[u8]>)| asked.ends_with(name);
        let found = self.files.iter().filter(ending);
        let found = found.max_by_key(|(name, _)| name.len());
        found.map(|(_, bytes)| &**bytes)
    }

    /// Writes the bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut body = (self.files.len() as u32).to_le_bytes().to_vec();
        for (name, content) in &self.files {
            for part in [name.as_bytes(), content.as_ref()] {
                body.extend_from_slice(&(part.len() as u32).to_le_bytes());
                body.extend_from_slice(part);
            }
        }
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(blake3::hash(&body).as_bytes());
        bytes.extend_from_slice(&body);
        bytes
    }

    /// Reads the bytes that [`Package::encode`] wrote.
    ///
    /// # Errors
    /// They are something else, or have changed.
    pub fn decode(bytes: &[u8]) -> Result<Self> {
        let wrong = |message: &str| Error::input("page", message);
        let damaged = || wrong("is damaged");
        let other = || wrong("is not a package of this version");
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(other)?;
        let (sum, body) = rest.split_first_chunk::<32>().ok_or_else(damaged)?;
        if blake3::hash(body).as_bytes() != sum {
            return Err(damaged());
        }
        let mut package = Self::default();
        let (count, mut rest) = body.split_first_chunk::<4>().ok_or_else(damaged)?;
        let mut part = || {
            let (length, after) = rest.split_first_chunk::<4>()?;
            let (part, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
            rest = after;
            Some(part)
        };
        for _ in 0..u32::from_le_bytes(*count) {
            let (name, content) = part().zip(part()).ok_or_else(damaged)?;
            let name = str::from_utf8(name).map_err(|_| damaged())?;
            package.files.push((name.into(), content.into()));
        }
        Ok(package)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::reading::{read_file, with_source};

    #[test]
    fn files_are_found_by_any_spelling_of_their_paths_and_the_disk_s_folders_are_not_told() {
        let files = [
            ("/home/me/a/scenes/s.toml", "scene"),
            ("/home/me/a/scenes/../manifolds/m.toml", "manifold"),
        ];
        let files = files.map(|(path, text)| (PathBuf::from(path), text.into()));
        let (package, scene) = Package::of_files(files.to_vec());
        assert_eq!(scene, "scenes/s.toml");
        let bytes = package.encode();
        assert!(!bytes.windows(4).any(|w| w == b"home"));
        let source = Package::decode(&bytes).unwrap().source();
        with_source(source, || {
            let read = |path: &str| read_file(Path::new(path), &[], 99).unwrap();
            assert_eq!(read("scenes/s.toml"), b"scene");
            assert_eq!(read("scenes/../manifolds/m.toml"), b"manifold");
        });
    }

    #[test]
    fn a_file_named_from_the_root_of_the_disk_is_found_too() {
        let files = [
            ("/a/b/s.toml", "scene"),
            ("/a/b/m.obj", "near"),
            ("/a/m.obj", "far"),
        ];
        let files = files.map(|(path, text)| (PathBuf::from(path), text.into()));
        let source = Package::of_files(files.to_vec()).0.source();
        let read =
            |path: &str| source(Path::new(path)).map(|bytes| String::from_utf8(bytes).unwrap());
        assert_eq!(read("/a/b/m.obj").as_deref(), Some("near"));
        assert_eq!(read("/a/b/../m.obj").as_deref(), Some("far"));
        assert_eq!(read("/a/b/n.obj"), None);
        assert_eq!(read("n.obj"), None);
    }

    #[test]
    fn files_named_from_here_and_from_the_root_have_one_common_folder() {
        let here = std::env::current_dir().unwrap();
        let files = [
            (PathBuf::from("x/s.toml"), vec![]),
            (here.join("y/m.obj"), vec![1]),
        ];
        let (package, scene) = Package::of_files(files.to_vec());
        assert_eq!(scene, "x/s.toml");
        assert_eq!(package.get("y/m.obj"), Some(&[1][..]));
    }

    #[test]
    fn a_changed_byte_or_a_missing_end_is_noticed() {
        let mut package = Package::default();
        package.add("a", vec![1, 2, 3]);
        package.add("b", vec![]);
        let bytes = package.encode();
        assert_eq!(Package::decode(&bytes).unwrap(), package);
        for i in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[i] ^= 4;
            assert!(Package::decode(&damaged).is_err());
            assert!(Package::decode(&bytes[..i]).is_err());
        }
    }
}
