//! Contents of a page's package besides the scene's files.
//!
//! In and out: the settings that the scene is loaded with, as JSON; how its meshes are cut where they are placed
//! ([`geofan_render::scene::pack_cuts`]) and their vertices ([`geofan_render::scene::pack_points`]); and the light of its lamps, as numbers: the
//! points of the even layout asked for, the facets divided and the points (u32 each), the facets divided (u32),
//! six f32 a point; little-endian.

use crate::{DrawSpace, Package, SessionSpace};
use geofan_bundle::Bundle;
use geofan_core::{Error, Result, manifold::Manifold, reading::with_source};
use geofan_render::{
    Lightmap, Stage, World,
    lightmap::{DirectedLights, FacetLayout, Light},
    scene::{SceneFile, read_cuts, read_points},
};
use serde::{Deserialize, Serialize};
use std::{path::Path, sync::Arc};

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

    /// Loads what a session must know of the scene of `package`: its manifold and cameras, not its meshes.
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
            let manifold = Manifold::load(&scene.manifold, settings)?;
            Ok::<_, Error>((scene, Arc::new(manifold)))
        };
        let (scene, manifold) = with_source(package.clone().source(), load)?;
        let bundle = Self::bundle(package, &manifold)?;
        SessionSpace::new(&scene, &manifold, bundle.as_ref(), about.length)
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

    /// Loads the scene of `package`, with other `settings` of its manifold if they are given. A bundle of
    /// another manifold is left out.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn open(package: &Package, settings: Option<&[(String, f64)]>) -> Result<DrawSpace> {
        let about = Self::of(package)?;
        let settings = settings.unwrap_or(&about.settings);
        let scene = Path::new(&about.scene);
        let as_packed = settings == about.settings;
        let load = || {
            let mut scene = SceneFile::load(scene)?;
            if as_packed {
                Self::give_placements(package, &mut scene);
            }
            Stage::of_scene(scene, settings, 0.0)
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
