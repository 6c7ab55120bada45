//! The files of a scene as a page carries them.
//!
//! In: a loaded space. Out: the files that it needs, with their paths: meshes, skies and samples packed
//! ([`geofan_render::scene::pack_meshes`], [`geofan_render::picture::pack`], [`geofan_core::field::read::pack`]), all
//! others as they are. What only made the packed ones (materials, textures, further slices of samples) is left out.

use crate::{LoadedSpace, SpaceSource};
use geofan_core::{
    Result,
    field::read::pack as pack_samples,
    reading::{FileSource, exists, noting, read_file, with_source},
};
use geofan_render::{
    picture,
    scene::{Cuts, Mesh, ObjectEntry, Points, SceneFile, SkyEntry, pack_meshes, placed_once},
};
use std::{
    path::{Path, PathBuf},
    rc::Rc,
};

/// A file: its path and its bytes.
type Named = (PathBuf, Vec<u8>);

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
    let made = loaded.made.clone();
    let stands_before: FileSource = Rc::new(move |path: &Path| {
        let found = made.iter().find(|(name, _)| name == path);
        found.map(|(_, bytes)| bytes.clone())
    });
    let (done, noted) = with_source(stands_before, || noting(work));
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
            Some((first, pack_samples(&field.samples, &field.plan.limits)))
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
