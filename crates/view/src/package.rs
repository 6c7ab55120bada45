//! A scene with all of its files in one piece, for where there is no disk, and what a page's package holds besides.
//!
//! In: files by their paths. Out: bytes, and from bytes a source that files are read from
//! ([`geofan_core::reading::with_source`]). Layout, little-endian: the magic, the checksum (XXH3, u64) of all
//! that follows, the number of files (u32), and for each the length of its name (u32), the name, the
//! length of its content (u32), and the content. Names are those of paths from a common folder, so that a package
//! tells nothing about the disk that it was made on.
//!
//! Besides the scene's files a page has: the settings that the scene is loaded with, as JSON; how its meshes are cut
//! where they are placed ([`geofan_render::scene::pack_cuts`]) and their vertices
//! ([`geofan_render::scene::pack_points`]); and the light of its lamps, as numbers: the points of the even layout asked
//! for, the facets divided and the points (u32 each), the facets divided (u32), six f32 a point; little-endian.

use crate::{DrawSpace, SessionSpace};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    manifold::Manifold,
    reading::{FileSource, with_source},
};
use geofan_render::{
    Lightmap, Stage, World,
    lightmap::{DirectedLights, FacetLayout, Light},
    load_manifold,
    scene::{SceneFile, read_cuts, read_points},
};
use serde::{Deserialize, Serialize};
use std::{
    path::{Component, Path, PathBuf},
    rc::Rc,
    sync::Arc,
};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 16] = b"geofan package2\n";

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
        bytes.extend_from_slice(&xxh3_64(&body).to_le_bytes());
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
        let (sum, body) = rest.split_first_chunk::<8>().ok_or_else(damaged)?;
        if xxh3_64(body) != u64::from_le_bytes(*sum) {
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

/// The settings of a page's scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PageAbout {
    /// Name of the scene's file in the package.
    pub scene: String,
    /// Parameters of the manifold that were replaced.
    pub settings: Vec<(String, f64)>,
    /// Arc length over which exact paths are followed.
    pub length: f64,
}

impl PageAbout {
    /// Name of these settings in a package. No file of a scene has such a name.
    pub const NAME: &str = "?about";
    /// Name of the bundle.
    pub const BUNDLE: &str = "?bundle";
    /// Name of the light.
    pub const LIGHT: &str = "?light";
    /// Name of the cuts of meshes.
    pub const CUTS: &str = "?cuts";
    /// Name of the vertices of objects that take long to be placed.
    pub const POINTS: &str = "?points";

    /// Writes the settings.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Reads the settings of a package.
    ///
    /// # Errors
    /// It has none.
    pub fn of(package: &Package) -> Result<Self> {
        let about = package
            .get(Self::NAME)
            .and_then(|bytes| serde_json::from_slice(bytes).ok());
        about.ok_or_else(|| Error::input("page", "says nothing about its scene"))
    }

    /// Loads what a session must know of the scene of `package`: its manifold and cameras, not its meshes; with these
    /// parameters, all of them, if they are not those that it was packed with.
    ///
    /// # Errors
    /// Whatever is wrong with its scene or its manifold.
    pub fn open_session(
        package: &Package,
        settings: Option<&[(String, f64)]>,
    ) -> Result<SessionSpace> {
        let about = Self::of(package)?;
        let settings = settings.unwrap_or(&about.settings);
        let load = || {
            let scene = SceneFile::load(Path::new(&about.scene))?;
            let manifold = load_manifold(&scene.manifold, settings)?;
            Ok::<_, Error>((scene, Arc::new(manifold)))
        };
        let (scene, manifold) = with_source(package.clone().source(), load)?;
        let bundle = Self::bundle(package, &manifold)?;
        let space = SessionSpace::new(&scene, &manifold, bundle.as_ref(), about.length)?;
        let reason = match package.get(Self::BUNDLE) {
            Some(_) => "this page's table is of the parameters that it was made with",
            None => "this page carries no table",
        };
        Ok(space.without_table(Some(reason)))
    }

    /// Reads the bundle of `package`, if there is one and it is of `manifold`.
    fn bundle(package: &Package, manifold: &Manifold) -> Result<Option<Bundle>> {
        let bundle = package
            .get(Self::BUNDLE)
            .map(Bundle::from_bytes)
            .transpose();
        let bundle = bundle.map_err(|e| Error::input("bundle", e.to_string()))?;
        Ok(bundle.filter(|b| manifold.differences_of_covers(&b.manifold).is_empty()))
    }

    /// Loads the scene of `package`; with these parameters, all of them, if they are not those that it was packed with.
    /// Then a bundle of another manifold is left out, and the light of lamps.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn open(package: &Package, settings: Option<&[(String, f64)]>) -> Result<DrawSpace> {
        let about = Self::of(package)?;
        let as_packed = settings.is_none();
        let settings = settings.unwrap_or(&about.settings);
        let load = || {
            let mut scene = SceneFile::load(Path::new(&about.scene))?;
            if as_packed {
                Self::give_placements(package, &mut scene);
            }
            Stage::of_scene(scene, settings, 0.0, None)
        };
        let mut stage = with_source(package.clone().source(), load)?;
        for object in &mut stage.scene.objects {
            object.vertices = None;
        }
        let light = package.get(Self::LIGHT).filter(|_| as_packed);
        stage.world.light = light.and_then(|bytes| decode_light(&stage.world, bytes));
        let bundle = Self::bundle(package, &stage.world.manifold)?;
        Ok(DrawSpace::new(stage, bundle, about.length))
    }

    /// Tells the objects of the package's scene how their meshes are cut, and their vertices where those are known.
    fn give_placements(package: &Package, scene: &mut SceneFile) {
        let count = scene.objects.len();
        let cuts = package.get(Self::CUTS);
        let cuts = cuts.and_then(|bytes| read_cuts(bytes, count));
        for (object, cuts) in scene.objects.iter_mut().zip(cuts.into_iter().flatten()) {
            object.cuts = cuts.map(Arc::new);
        }
        let points = package.get(Self::POINTS);
        let points = points.and_then(|bytes| read_points(bytes, count));
        for (object, points) in scene.objects.iter_mut().zip(points.into_iter().flatten()) {
            object.vertices = points.map(Arc::new);
        }
    }
}

/// Writes the light of a world whose even layout was asked for with `even` points.
pub fn encode_light(light: &Lightmap, even: usize) -> Vec<u8> {
    let counts = [even, light.divided().len(), light.values.len()];
    let counts = counts.into_iter().flat_map(|n| (n as u32).to_le_bytes());
    let mut bytes: Vec<u8> = counts.collect();
    bytes.extend(light.divided().iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend(light.values.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes.extend(light.directed().to_bytes());
    bytes
}

/// Reads the light of `world`; `None` if the bytes are not that.
pub fn decode_light(world: &World, bytes: &[u8]) -> Option<Lightmap> {
    let (words, []) = bytes.as_chunks::<4>() else {
        return None;
    };
    let ([even, divided, points], rest) = words.split_first_chunk::<3>()?;
    let count = |word: &[u8; 4]| u32::from_le_bytes(*word) as usize;
    let (divided, values) = rest.split_at_checked(count(divided))?;
    let (values, rest) = values.split_at_checked(count(points).checked_mul(6)?)?;
    let directed = DirectedLights::from_bytes(rest.as_flattened(), count(points))?;
    let divided: Vec<u32> = divided
        .iter()
        .map(|word| u32::from_le_bytes(*word))
        .collect();
    let light = |six: &[[u8; 4]]| -> Light { std::array::from_fn(|k| f32::from_le_bytes(six[k])) };
    let values = values.chunks_exact(6).map(light).collect();
    let layout = FacetLayout::new(world, count(even));
    Lightmap::from_values(layout, &divided, values)?.with_directions(directed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::{manifold, start_stage};
    use geofan_core::reading::read_file;

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

    #[test]
    fn light_comes_back_as_it_went_and_other_bytes_are_refused() {
        let flat = manifold("metric = { conformal = '1' }\n[cameras]\nlength = 10");
        let world = start_stage(&flat, 10.0).world;
        let layout = FacetLayout::new(&world, 500);
        let values = (0..layout.len()).map(|i| [i as f32 * 0.5, 1.0, 2.0, 0.0, 0.25, 3.0]);
        let light = Lightmap::new(layout.clone(), values.collect()).unwrap();
        let bytes = encode_light(&light, 500);
        assert_eq!(decode_light(&world, &bytes), Some(light));
        for length in [0, 4, 11, 12, bytes.len() - 4, bytes.len() - 1] {
            assert_eq!(decode_light(&world, &bytes[..length]), None);
        }
    }
}
