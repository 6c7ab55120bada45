//! A space loaded from the disk, as the viewer's engines and pages need it.
//!
//! In: the paths of a scene or manifold file and perhaps of a bundle. Out: a [`LoadedSpace`]: what draws, what
//! sessions are told, and every file that was read for it.

use crate::{DrawSpace, SessionSpace, StartScene};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    manifold::Manifold,
    reading::{FileSource, noting, read_text, with_source},
};
use geofan_light::cache;
use geofan_render::Stage;
use std::{
    path::{Path, PathBuf},
    rc::Rc,
};

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
        let known = made.clone();
        let source: FileSource = Rc::new(move |path: &Path| {
            let found = known.iter().find(|(name, _)| name == path);
            found.map(|(_, bytes)| bytes.clone())
        });
        let load = || noting(|| Stage::load(&scene, settings));
        let (stage, read) = with_source(source, load);
        let mut stage = stage?;
        let new = |path: &PathBuf| !is_made(path) && !files.contains(path);
        let read: Vec<PathBuf> = read.into_iter().filter(new).collect();
        files.extend(read);
        let own = self.bundle.as_ref().map(|path| Bundle::read(path));
        let manifold = stage.world.manifold.clone();
        let fits = |b: &Bundle| manifold.differences_of_covers(&b.manifold).is_empty();
        let bundle = own.transpose()?.filter(fits).or(table.filter(fits));
        let length = self.length.or(manifold.length).unwrap_or(LENGTH);
        let followed = bundle.as_ref().map_or(length, |b| b.table.length);
        cache::light_up(
            &mut stage.world,
            self.bundle.as_deref(),
            followed,
            |_, _| {},
        )?;
        let session = SessionSpace::new(&stage.scene, &manifold, bundle.as_ref(), length)?;
        files.extend(self.bundle.clone());
        Ok(LoadedSpace {
            draw: DrawSpace::new(stage, bundle, length),
            session,
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
        if self.bundle.is_some() && loaded.draw.bundle().is_none() {
            let message = "it was baked from another manifold than the scene's; bake again, or give the same --set";
            return Err(Error::input("--bundle", message));
        }
        Ok(loaded)
    }

    /// Makes the files of a first scene, the scene's first, if the file is a manifold's; else none.
    fn start_scene(&self, settings: &[(String, f64)]) -> Result<Vec<(PathBuf, Vec<u8>)>> {
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
