//! A space loaded from the disk, as the viewer's engines and pages need it, and its files as a page carries them.
//!
//! In: the paths of a scene or manifold file and perhaps of a bundle. Out: a [`LoadedSpace`]: what draws, what
//! sessions are told, and every file that was read for it; and of that the files that a page needs, with their paths:
//! meshes, skies and samples packed ([`geofan_render::scene::pack_meshes`], [`geofan_render::picture::pack`],
//! [`geofan_core::field::read::pack`]), all others as they are. What only made the packed ones (materials, textures,
//! further slices of samples) is left out.

use crate::{DrawSpace, SessionSpace, StartScene};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    field::read::pack as pack_samples,
    manifold::Manifold,
    reading::{FileSource, exists, noting, read_file, read_text, with_source},
};
use geofan_light::cache;
use geofan_render::{
    Stage, picture,
    scene::{Cuts, Mesh, ObjectEntry, Points, SceneFile, SkyEntry, pack_meshes, placed_once},
};
use std::{
    path::{Path, PathBuf},
    rc::Rc,
};

/// A file: its path and its bytes.
type Named = (PathBuf, Vec<u8>);

/// Where a space comes from.
#[derive(Debug, Clone)]
pub struct SpaceSource {
    /// The scene file, or a manifold file.
    pub file: PathBuf,
    /// The bundle.
    pub bundle: Option<PathBuf>,
    /// Arc length over which exact paths are followed, if the user says.
    pub length: Option<f64>,
}

/// A space in memory.
pub struct LoadedSpace {
    /// Draws it.
    pub draw: DrawSpace,
    /// Tells sessions of it.
    pub session: SessionSpace,
    /// The user's own bundle draws it, and not a table that was made behind.
    pub has_own_bundle: bool,
    /// The scene's path, which for a bare manifold is on no disk.
    pub scene: PathBuf,
    /// The files that are on no disk.
    pub made: Vec<(PathBuf, Vec<u8>)>,
    /// All files that were read for it.
    pub files: Vec<PathBuf>,
}

/// Arc length over which paths are followed where nothing says so.
const LENGTH: f64 = 10.0;

/// Name of the scene that is made for a bare manifold.
const START_SCENE: &str = "geofan-start-scene.toml";

impl LoadedSpace {
    /// Tells what is doubtful about the scene; of files that were made here, nobody needs to be warned.
    pub fn warnings(&self) -> impl Iterator<Item = &str> {
        let of_made = |warning: &str| {
            let mut names = self.made.iter().map(|(path, _)| path.display().to_string());
            names.any(|name| warning.starts_with(&name))
        };
        let warnings = self.draw.stage.world.warnings.iter().map(String::as_str);
        warnings.filter(move |warning| !of_made(warning))
    }
}

impl SpaceSource {
    /// Loads the space with these parameters of its manifold. A `table` stands in for the bundle's file where that is
    /// of another manifold, or where there is none.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(&self, settings: &[(String, f64)], table: Option<Bundle>) -> Result<LoadedSpace> {
        let (made, mut files) = noting(|| self.start_scene(settings));
        let made = made?;
        let scene = made.first().map_or(&self.file, |(path, _)| path).clone();
        let is_made = |path: &Path| made.iter().any(|(name, _)| name == path);
        let load = || noting(|| Stage::load(&scene, settings));
        let (stage, read) = with_source(before_disk(&made), load);
        let mut stage = stage?;
        let new = |path: &PathBuf| !is_made(path) && !files.contains(path);
        let read: Vec<PathBuf> = read.into_iter().filter(new).collect();
        files.extend(read);
        let own = self.bundle.as_ref().map(|path| Bundle::read(path));
        let manifold = stage.world.manifold.clone();
        let fits = |b: &Bundle| manifold.differences_of_covers(&b.manifold).is_empty();
        let own = own.transpose()?.filter(fits);
        let has_own_bundle = own.is_some();
        let bundle = own.or(table.filter(fits));
        let length = self.length.or(manifold.length).unwrap_or(LENGTH);
        let followed = bundle.as_ref().map_or(length, |b| b.table.length);
        cache::light_up(
            &mut stage.world,
            // The light beside a bundle is of its own space.
            self.bundle.as_deref().filter(|_| has_own_bundle),
            followed,
            |_, _| {},
        );
        let session = SessionSpace::new(&stage.scene, &manifold, bundle.as_ref(), length)?;
        files.extend(self.bundle.clone());
        Ok(LoadedSpace {
            draw: DrawSpace::new(stage, bundle, length),
            session,
            has_own_bundle,
            scene,
            made,
            files,
        })
    }

    /// Loads the space, whose bundle, if there is one, must be of its manifold.
    ///
    /// # Errors
    /// As [`Self::load`]; also if the bundle is of another manifold.
    pub fn load_with_bundle(&self, settings: &[(String, f64)]) -> Result<LoadedSpace> {
        let loaded = self.load(settings, None)?;
        match self.bundle.is_some() && !loaded.has_own_bundle {
            true => Err(bundle_of_another()),
            false => Ok(loaded),
        }
    }

    /// Makes the files of a first scene, the scene's first, if the file is a manifold's; else none.
    fn start_scene(&self, settings: &[(String, f64)]) -> Result<Vec<Named>> {
        let text = read_text(&self.file)?;
        if !StartScene::is_manifold(&text.text) {
            return Ok(Vec::new());
        }
        let manifold = Manifold::from_source(text, settings)?;
        let length = self.length.or(manifold.length).unwrap_or(LENGTH);
        let name = self.file.file_name().unwrap_or_default().to_string_lossy();
        let scene = StartScene::new(&manifold, &name, length)?;
        let folder = self.file.parent().unwrap_or(Path::new(""));
        let all = [(START_SCENE.to_string(), scene.text)]
            .into_iter()
            .chain(scene.files);
        Ok(all
            .map(|(name, text)| (folder.join(name), text.into_bytes()))
            .collect())
    }
}

/// Says that the user's bundle is of another manifold than the scene.
pub fn bundle_of_another() -> Error {
    let message =
        "it was baked from another manifold than the scene's; bake again, or give the same --set";
    Error::input("--bundle", message)
}

/// Puts the files that are on no disk before the disk.
fn before_disk(made: &[Named]) -> FileSource {
    let made = made.to_vec();
    Rc::new(move |path: &Path| {
        let found = made.iter().find(|(name, _)| name == path);
        found.map(|(_, bytes)| bytes.clone())
    })
}

/// Returns the files of the page of `loaded`, which came from `source`.
pub fn packed(source: &SpaceSource, loaded: &LoadedSpace) -> Result<Vec<Named>> {
    let scene = &loaded.draw.stage.scene;
    let (meshes, read) = reading(loaded, || meshes(scene))?;
    let (others, _) = reading(loaded, || {
        let mut files = skies(scene)?;
        files.extend(samples(loaded));
        let known = |path: &PathBuf| {
            let packed = meshes.iter().chain(&files).any(|(known, _)| known == path);
            let table = source.bundle.as_ref() == Some(path) && scene.manifold != *path;
            packed || read.contains(path) || table
        };
        let needed: Vec<PathBuf> = needed(loaded).into_iter().filter(|p| !known(p)).collect();
        for path in needed.into_iter().filter(|path| exists(path)) {
            let bytes = read_file(&path, &[], u64::MAX)?;
            files.push((path, bytes));
        }
        Ok(files)
    })?;
    Ok(meshes.into_iter().chain(others).collect())
}

/// Does `work` with the files before the disk that are on none; tells which files it read.
fn reading<T>(loaded: &LoadedSpace, work: impl FnOnce() -> Result<T>) -> Result<(T, Vec<PathBuf>)> {
    let (done, noted) = with_source(before_disk(&loaded.made), || noting(work));
    Ok((done?, noted))
}

/// Finds of all objects of the scene that do not move how their meshes are cut where they are placed, and the vertices
/// of those that take long to be placed.
pub fn placements(loaded: &LoadedSpace) -> Result<Vec<(Option<Cuts>, Option<Points>)>> {
    let objects = &loaded.draw.stage.scene.objects;
    let placement = |object: &ObjectEntry| -> Result<(Option<Cuts>, Option<Points>)> {
        if object.path.is_some() {
            return Ok((None, None));
        }
        let mesh = Mesh::load_creased(&object.mesh, object.crease)?;
        let placed = placed_once(&loaded.session.manifold, object, &mesh);
        Ok(placed.map_or((None, None), |(cuts, points)| (Some(cuts), points)))
    };
    let all = || objects.iter().map(placement).collect();
    reading(loaded, all).map(|(all, _)| all)
}

/// Packs the meshes of the scene's objects, each file once.
fn meshes(scene: &SceneFile) -> Result<Vec<Named>> {
    let mut files: Vec<Named> = Vec::new();
    for object in &scene.objects {
        if files.iter().any(|(known, _)| *known == object.mesh) {
            continue;
        }
        let same = scene
            .objects
            .iter()
            .filter(|other| other.mesh == object.mesh);
        let mut creases: Vec<f64> = same.map(|object| object.crease).collect();
        creases.sort_by(f64::total_cmp);
        creases.dedup();
        let load = |crease: f64| Ok((crease, Mesh::load_creased(&object.mesh, crease)?));
        let loaded: Vec<(f64, Mesh)> = creases.into_iter().map(load).collect::<Result<_>>()?;
        let all: Vec<(f64, &Mesh)> = loaded
            .iter()
            .map(|(crease, mesh)| (*crease, mesh))
            .collect();
        files.push((object.mesh.clone(), pack_meshes(&all)));
    }
    Ok(files)
}

/// Packs the pictures of the scene's skies.
fn skies(scene: &SceneFile) -> Result<Vec<Named>> {
    let pictures = scene.skies.iter().filter_map(|(.., entry)| match entry {
        SkyEntry::Image(path) => Some(path),
        SkyEntry::Pattern(_) => None,
    });
    pictures
        .map(|path| Ok((path.clone(), picture::pack(&picture::read(path)?))))
        .collect()
}

/// Packs the samples of the manifold's fields, all slices of one as its first file.
fn samples(loaded: &LoadedSpace) -> Vec<Named> {
    let scene = &loaded.draw.stage.scene;
    let folder = scene.manifold.parent().unwrap_or(Path::new(""));
    let fields = loaded.session.manifold.fields.iter();
    fields
        .filter_map(|field| {
            let first = folder.join(field.files.first()?);
            Some((first, pack_samples(&field.samples)))
        })
        .collect()
}

/// Lists the files that were read for the space, without what samples came from, which is packed.
fn needed(loaded: &LoadedSpace) -> Vec<PathBuf> {
    let scene = &loaded.draw.stage.scene;
    let folder = scene.manifold.parent().unwrap_or(Path::new(""));
    let fields = loaded.session.manifold.fields.iter();
    let slices = fields.flat_map(|field| field.files.iter().map(|file| folder.join(file)));
    let slices: Vec<PathBuf> = slices.collect();
    let files = loaded.files.iter().filter(|path| !slices.contains(path));
    let mut needed = vec![loaded.scene.clone()];
    for path in files {
        if !needed.contains(path) {
            needed.push(path.clone());
        }
    }
    needed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::bundle;

    #[test]
    fn the_users_bundle_comes_before_a_table_of_another_space() {
        let golden = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden"));
        let source = SpaceSource {
            file: golden.join("s3.toml"),
            bundle: Some(golden.join("s3.fan")),
            length: None,
        };
        let loaded = source.load(&[], Some(bundle("three-bumps-rail"))).unwrap();
        let known = loaded.draw.bundle().unwrap();
        assert_eq!(known.table.length, bundle("s3").table.length);
    }
}
