//! OBJ files as meshes, with the material libraries that they name.
//!
//! In: the text, and the folder that other files are relative to. Out: a [`Draft`] of its triangles ([`Obj`]), with
//! materials from the libraries that it names.
//!
//! In: what stands after each `mtllib`. Out: [`Libraries`], which make materials of names. Several
//! libraries may stand on a line, and names may hold spaces: the longest name that is there counts.

use super::{
    formats::{decoded, joined, located, without_comment},
    material::Material,
    mesh::{Mesh, unit_or_none},
    mtl::{Entry, Shelf, entries},
    obj::{Corner, Obj},
    smoothing::Draft,
};
use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_file},
};
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

/// Reads the OBJ text that the user calls `name`; other files are relative to `folder`.
pub(super) fn read(name: &str, text: &str, folder: &Path) -> Result<Draft> {
    let text = joined(text);
    let mut obj = Obj::of(name, &text)?;
    let triangulated = obj.triangulated();
    if triangulated.smoothing.is_empty() && obj.tally.has_free_form() {
        let message = "holds free-form surfaces and no faces: export it as polygons";
        return Err(Error::input(name, message));
    }
    let mut mesh = vertices(&mut obj, &triangulated.vertices);
    mesh.triangles = triangulated.triangles;
    let mut warnings = obj.tally.warnings(name);
    let mut libraries = Libraries::load(&obj.libraries, folder, &mut warnings);
    let mut materials = ObjMaterials {
        mesh: &mut mesh,
        numbers: vec![None; obj.names.len()],
        plain: None,
    };
    for of in &triangulated.material_of {
        let number = materials.number(*of, |k| {
            let called = obj.names[k];
            let found = libraries.material(called, &mut warnings);
            if found.is_none() {
                warnings.push(format!(
                    "{name}: material `{called}` is not defined, grey is used"
                ));
            }
            found
        });
        materials.mesh.material_of.push(number);
    }
    mesh.warnings = warnings;
    Ok(Draft {
        mesh,
        smoothing: triangulated.smoothing,
    })
}

/// Returns a mesh of these vertices, without triangles.
fn vertices(obj: &mut Obj<'_>, corners: &[Corner]) -> Mesh {
    let colours = obj.colours();
    let colour = |corner: &Corner| {
        let found = colours.get(corner[0] as usize - 1);
        found.copied().unwrap_or([1.0; 4])
    };
    let coloured = match colours.is_empty() {
        true => &[],
        false => corners,
    };
    let all = corners.iter();
    Mesh {
        positions: all.clone().map(|c| obj.position(*c)).collect(),
        normals: all
            .clone()
            .map(|c| unit_or_none(obj.normal_of(*c)))
            .collect(),
        uvs: all.map(|c| obj.uv(*c)).collect(),
        colours: coloured.iter().map(colour).collect(),
        ..Default::default()
    }
}

/// The materials of a mesh as they come into use.
struct ObjMaterials<'m> {
    mesh: &'m mut Mesh,
    /// Those of the names after `usemtl` that have been asked for.
    numbers: Vec<Option<u32>>,
    /// The one of triangles that have none.
    plain: Option<u32>,
}

impl ObjMaterials<'_> {
    /// Returns the number of the material with the name of number `name`, which `find` finds.
    fn number(&mut self, name: Option<u32>, find: impl FnOnce(usize) -> Option<Material>) -> u32 {
        let Some(name) = name.map(|name| name as usize) else {
            return self.plain();
        };
        if let Some(number) = self.numbers[name] {
            return number;
        }
        let number = match find(name) {
            Some(material) => self.push(material),
            None => self.plain(),
        };
        self.numbers[name] = Some(number);
        number
    }

    fn plain(&mut self) -> u32 {
        if let Some(number) = self.plain {
            return number;
        }
        let mut grey = Material::default();
        if !self.mesh.colours.is_empty() {
            // The colours of the vertices are all there is.
            grey.kd = [1.0; 3];
        }
        let number = self.push(grey);
        self.plain = Some(number);
        number
    }

    fn push(&mut self, material: Material) -> u32 {
        self.mesh.materials.push(material);
        (self.mesh.materials.len() - 1) as u32
    }
}

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
            let ends_here = |w: &str| w.to_ascii_lowercase().ends_with(".mtl");
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
