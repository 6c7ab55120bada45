//! The material libraries that an OBJ file names, and finding the files that any file names.
//!
//! In: what stands after each `mtllib`. Out: [`Libraries`], which make materials of names. Several
//! libraries may stand on a line, and names may hold spaces: the longest name that is there counts.

use super::{
    material::Material,
    material_shelf::Shelf,
    mtl::{Entry, entries},
    text::{decoded, joined, without_comment},
};
use geofan_core::reading::{MOST_OF_A_FILE, exists, read_file};
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

/// The materials of all libraries of a mesh.
pub(super) struct Libraries {
    /// Materials with the folder of their library, in order.
    entries: Vec<(Entry, PathBuf)>,
    /// Numbers of the last of each name, as it is written and without what may be a comment.
    whole: HashMap<String, usize>,
    bare: HashMap<String, usize>,
    /// The folder of the mesh.
    folder: PathBuf,
    shelf: Shelf,
}

impl Libraries {
    /// Reads the libraries `named` by a mesh in `folder`.
    pub(super) fn load(named: &[&str], folder: &Path, warnings: &mut Vec<String>) -> Self {
        let mut libraries = Self {
            entries: Vec::new(),
            whole: HashMap::new(),
            bare: HashMap::new(),
            folder: folder.to_owned(),
            shelf: Shelf::default(),
        };
        let mut seen: HashSet<&str> = HashSet::new();
        let named = named.iter().filter(|names| seen.insert(names));
        let mut known: Vec<PathBuf> = Vec::new();
        for path in named.flat_map(|names| paths(names, folder)) {
            if known.contains(&path) {
                continue;
            }
            if known.len() == MOST_LIBRARIES {
                warnings.push(format!(
                    "materials of more than {MOST_LIBRARIES} libraries left out"
                ));
                break;
            }
            libraries.read(&path, warnings);
            known.push(path);
        }
        libraries
    }

    fn read(&mut self, path: &Path, warnings: &mut Vec<String>) {
        match read_file(path, &[], MOST_OF_A_FILE) {
            Ok(bytes) => {
                let (name, text) = (path.display().to_string(), decoded(&bytes));
                let folder = path.parent().unwrap_or(Path::new("")).to_owned();
                for entry in entries(&name, &joined(&text), warnings) {
                    let (name, number) = (&entry.material.name, self.entries.len());
                    self.whole.insert(name.clone(), number);
                    self.bare.insert(without_comment(name).to_owned(), number);
                    self.entries.push((entry, folder.clone()));
                }
            }
            Err(e) => warnings.push(format!("materials left out: {e}")),
        }
    }

    /// Returns the material called `name`, which may have a comment behind it. Of several, the last.
    pub(super) fn material(&mut self, name: &str, warnings: &mut Vec<String>) -> Option<Material> {
        let bare = without_comment(name);
        let whole = [name.trim_end(), bare];
        let whole = whole.iter().find_map(|name| self.whole.get(*name));
        let (entry, folder) = &self.entries[*whole.or_else(|| self.bare.get(bare))?];
        let folders = [folder.as_path(), &self.folder];
        Some(self.shelf.material(entry, &folders, warnings))
    }
}

/// Most libraries of a mesh, most words that stand on a line of them, and most words of a name: more are
/// in no file that a program has written, and each is looked for.
const MOST_LIBRARIES: usize = 64;
const MOST_WORDS: usize = 256;
const MOST_IN_A_NAME: usize = 16;

/// Most folders of a path from another machine under which a file is looked for.
const MOST_FOLDERS: usize = 64;

/// Returns the files that `names` means.
fn paths(names: &str, folder: &Path) -> Vec<PathBuf> {
    let whole = names.trim().trim_matches('"');
    if let Some(path) = located(whole, &[folder]) {
        return vec![path];
    }
    let words = without_comment(names).split_whitespace();
    let words: Vec<&str> = words.take(MOST_WORDS).collect();
    let mut paths = Vec::new();
    let mut begin = 0;
    while begin < words.len() {
        let ends = (begin + 1..=words.len().min(begin + MOST_IN_A_NAME)).rev();
        let names = ends.map(|end| (end, words[begin..end].join(" ")));
        let found = names
            .filter_map(|(end, name)| located(name.trim_matches('"'), &[folder]).map(|p| (end, p)));
        let (end, path) = found.into_iter().next().unwrap_or_else(|| {
            let ends_here = |w: &str| w.to_lowercase().ends_with(".mtl");
            let length = words[begin..].iter().position(|w| ends_here(w));
            let end = length.map_or(words.len(), |length| begin + length + 1);
            let name = words[begin..end].join(" ").replace('\\', "/");
            (end, folder.join(name))
        });
        paths.push(path);
        begin = end;
    }
    paths
}

/// Returns the file called `name` in one of `folders`: as it is named, else by ever less of its path, which may
/// be of another machine, else without regard to capitals.
pub(super) fn located(name: &str, folders: &[&Path]) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    let parts: Vec<&str> = name.split('/').collect();
    if parts.last().is_none_or(|last| last.is_empty()) {
        return None;
    }
    let deepest = parts.len().saturating_sub(MOST_FOLDERS).max(1);
    let shorter = (deepest..parts.len()).map(|from| parts[from..].join("/"));
    let names: Vec<String> = std::iter::once(name.clone())
        .chain(shorter)
        .filter(|n| !n.is_empty())
        .collect();
    let paths = || {
        names
            .iter()
            .flat_map(|name| folders.iter().map(move |f| f.join(name)))
    };
    paths()
        .find(|path| exists(path) && path.is_file())
        .or_else(|| paths().find_map(|path| in_capitals(&path)))
}

/// Returns the file in the folder of `path` whose name differs from its by capitals alone.
fn in_capitals(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty());
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    let files = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let same = files
        .flatten()
        .filter(|file| file.file_name().to_string_lossy().to_lowercase() == name);
    let mut same: Vec<PathBuf> = same
        .map(|file| file.path())
        .filter(|path| path.is_file())
        .collect();
    same.sort();
    same.into_iter().next()
}
