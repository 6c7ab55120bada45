//! A scene placed in its manifold: triangles in chart coordinates, materials, skies.
//!
//! In: a [`SceneFile`] and its [`Manifold`]. Out: a [`World`] that rays can be intersected with and
//! hits be shaded from; together with the file, a [`Stage`].

use super::{
    accel::Accelerator,
    intersect::Hit,
    lightmap::Lightmap,
    scene::{CameraEntry, LightEntry, Material, Mesh, ObjectEntry, SceneFile, place},
    sky::Sky,
    view::{View, camera_point},
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    geodesic::check_point,
    manifold::Manifold,
};
use glam::DVec3;
use std::{path::Path, sync::Arc};

/// The corners of a triangle as shading needs them.
#[derive(Debug, Clone)]
pub struct Face {
    /// Index of the object in the scene file.
    pub object: u32,
    /// Index into [`World::materials`].
    pub material: u32,
    /// Normals at the corners, as covectors of the chart (not of unit length).
    pub normals: [DVec3; 3],
    /// Texture coordinates at the corners.
    pub uvs: [[f32; 2]; 3],
}

/// A light without extent that shines equally in all directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLight {
    /// Chart point.
    pub u: DVec3,
    /// Linear red, green and blue per unit solid angle.
    pub intensity: [f32; 3],
}

/// Everything that can be seen.
pub struct World {
    /// The manifold.
    pub manifold: Arc<Manifold>,
    /// The same with light followed from lamps into the future.
    pub lamplight: Arc<Manifold>,
    /// The triangles in chart coordinates.
    pub accelerator: Accelerator,
    /// One for each triangle.
    pub faces: Vec<Face>,
    /// All materials.
    pub materials: Vec<Material>,
    /// The sky of each exit, and last the one of paths that end nowhere.
    pub skies: Vec<Option<Sky>>,
    /// Lights without extent.
    pub lights: Vec<PointLight>,
    /// Their light on the triangles, where it has been baked; without, the only lamp is at the
    /// camera.
    pub light: Option<Lightmap>,
    /// Warnings about what was mended or left out while loading.
    pub warnings: Vec<String>,
}

/// The key under `[sky]` for paths that end by their length.
const NOWHERE: &str = "length";

impl World {
    /// Loads meshes and skies of `scene` and places them in `manifold`.
    ///
    /// # Errors
    /// Files that cannot be read, objects outside the domain, skies of exits that do not exist.
    pub fn new(scene: &SceneFile, manifold: Arc<Manifold>) -> Result<Self> {
        let skies = load_skies(scene, &manifold)?;
        let lamplight = match manifold.has_wind() {
            true => Arc::new(manifold.forward()?.into_owned()),
            false => manifold.clone(),
        };
        let mut world = Self {
            accelerator: Accelerator::build(&[]),
            faces: Vec::new(),
            materials: Vec::new(),
            skies,
            lights: lights(scene, &manifold)?,
            light: None,
            warnings: Vec::new(),
            lamplight,
            manifold,
        };
        let mut triangles = Vec::new();
        let mut shelf: Vec<(&Path, Arc<Mesh>)> = Vec::new();
        for (index, object) in scene.objects.iter().enumerate() {
            let mesh = match shelf.iter().find(|(path, _)| *path == object.mesh) {
                Some((_, mesh)) => mesh.clone(),
                None => {
                    let mesh = Arc::new(Mesh::load(&object.mesh)?);
                    world.warnings.extend(mesh.warnings.iter().cloned());
                    shelf.push((&object.mesh, mesh.clone()));
                    mesh
                }
            };
            world.place(scene, index as u32, object, &mesh, &mut triangles)?;
        }
        world.accelerator = Accelerator::build(&triangles);
        Ok(world)
    }

    /// Computes a hash of the triangles and their normals.
    pub fn geometry_fingerprint(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (corners, face) in self.accelerator.triangles().iter().zip(&self.faces) {
            for x in corners
                .iter()
                .chain(&face.normals)
                .flat_map(|p| p.to_array())
            {
                hasher.update(&x.to_le_bytes());
            }
        }
        *hasher.finalize().as_bytes()
    }

    /// Returns the chart point of a hit, inside the limits of glued coordinates.
    pub fn point(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.accelerator.triangles()[hit.triangle as usize];
        let [y, z] = hit.barycentric.map(f64::from);
        let u = a * (1.0 - y - z) + b * y + c * z;
        self.manifold.domain.wrap(u)
    }

    /// Returns the normal of a hit as a covector of the chart, not of unit length.
    pub fn covector(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.faces[hit.triangle as usize].normals;
        let [y, z] = hit.barycentric.map(f64::from);
        a * (1.0 - y - z) + b * y + c * z
    }

    /// Returns the change of texture coordinates on the plane of a triangle along the displacement `way`.
    pub fn texture_change(&self, triangle: u32, way: DVec3) -> [f32; 2] {
        let [a, b, c] = self.accelerator.triangles()[triangle as usize];
        let uvs = self.faces[triangle as usize].uvs;
        let (e, f) = (b - a, c - a);
        let (ee, ef, ff) = (e.dot(e), e.dot(f), f.dot(f));
        let (we, wf) = (way.dot(e), way.dot(f));
        let determinant = ee * ff - ef * ef;
        let y = ((ff * we - ef * wf) / determinant) as f32;
        let z = ((ee * wf - ef * we) / determinant) as f32;
        let change = |k: usize| y * (uvs[1][k] - uvs[0][k]) + z * (uvs[2][k] - uvs[0][k]);
        let change = [change(0), change(1)];
        if change.iter().all(|x| x.is_finite()) {
            change
        } else {
            [0.0; 2]
        }
    }

    /// Places an object: its triangles, their faces and materials.
    fn place(
        &mut self,
        scene: &SceneFile,
        index: u32,
        object: &ObjectEntry,
        mesh: &Mesh,
        triangles: &mut Vec<[DVec3; 3]>,
    ) -> Result<()> {
        if self.manifold.domain.violation(object.at).is_some() {
            let complaint = Diagnostic::new(
                &scene.source,
                object.at_span.clone(),
                "this object is outside the manifold's domain",
            );
            return Err(complaint
                .with_hint("see [domain] in the manifold file")
                .into());
        }
        let Some(placed) = place(&self.manifold, object, mesh) else {
            return Err(self.unreachable(scene, object));
        };
        self.warnings.extend(placed.warning);
        let (mesh, vertices) = (placed.mesh, placed.vertices);
        let first = self.materials.len() as u32;
        self.materials.extend(mesh.materials.iter().cloned());
        for (corners, material) in mesh.triangles.iter().zip(&mesh.material_of) {
            let corner = corners.map(|c| c as usize);
            triangles.push(corner.map(|c| vertices[c].0));
            self.faces.push(Face {
                object: index,
                material: first + material,
                normals: corner.map(|c| vertices[c].1),
                uvs: corner.map(|c| mesh.uvs[c]),
            });
        }
        Ok(())
    }

    /// Complains about an object that cannot be placed.
    fn unreachable(&self, scene: &SceneFile, object: &ObjectEntry) -> Error {
        Diagnostic::new(
            &scene.source,
            object.span.clone(),
            "the geodesics that place this object leave the manifold",
        )
        .with_hint("make it smaller or move it away from the edge of the domain")
        .into()
    }
}

/// Places the lights of `scene`, all inside the domain.
fn lights(scene: &SceneFile, manifold: &Manifold) -> Result<Vec<PointLight>> {
    let light = |entry: &LightEntry| match check_point(manifold, "the light", entry.at) {
        Ok(()) => Ok(PointLight {
            u: entry.at,
            intensity: entry.intensity,
        }),
        Err(fault) => {
            let span = entry.at_span.clone();
            Err(Diagnostic::new(&scene.source, span, fault.to_string()).into())
        }
    };
    scene.lights.iter().map(light).collect()
}

/// Loads the skies of `scene`: one for each exit, and last the one of paths that end nowhere.
fn load_skies(scene: &SceneFile, manifold: &Manifold) -> Result<Vec<Option<Sky>>> {
    let mut skies: Vec<Option<Sky>> = Vec::new();
    skies.resize_with(manifold.exits.len() + 1, || None);
    for (name, span, entry) in &scene.skies {
        let index = match name.as_str() {
            NOWHERE => Some(manifold.exits.len()),
            name => manifold.exit_named(name),
        };
        let Some(index) = index else {
            let known: Vec<&str> = manifold.exits.iter().map(|e| e.name.as_str()).collect();
            let complaint = Diagnostic::new(
                &scene.source,
                span.clone(),
                format!("the manifold has no exit `{name}`"),
            );
            let known = known.join(", ");
            return Err(complaint
                .with_hint(format!("its exits: {known}, {NOWHERE}"))
                .into());
        };
        skies[index] = Some(Sky::load(entry)?);
    }
    Ok(skies)
}

/// A scene with everything it names.
pub struct Stage {
    /// The file.
    pub scene: SceneFile,
    /// Everything that can be seen.
    pub world: World,
}

impl Stage {
    /// Loads the scene at `path`; `settings` replace parameters of its manifold.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(path: &Path, settings: &[(String, f64)]) -> Result<Self> {
        let scene = SceneFile::load(path)?;
        let manifold = Manifold::load(&scene.manifold, settings).map_err(|e| match e {
            // A missing file is the scene's fault, and the scene says where it is named.
            Error::Input { message, .. } if !scene.manifold.exists() => Diagnostic::new(
                &scene.source,
                scene.manifold_span.clone(),
                format!("{}: {message}", scene.manifold.display()),
            )
            .with_hint("paths are relative to the scene file")
            .into(),
            other => other,
        })?;
        let world = World::new(&scene, Arc::new(manifold))?;
        Ok(Self { scene, world })
    }

    /// Returns the camera called `name`, or the main one.
    ///
    /// # Errors
    /// There is no such camera.
    pub fn camera(&self, name: Option<&str>) -> Result<&CameraEntry> {
        let Some(name) = name else {
            return Ok(&self.scene.camera);
        };
        self.scene.view(name).ok_or_else(|| {
            let known: Vec<&str> = self
                .scene
                .views
                .iter()
                .filter_map(|v| v.name.as_deref())
                .collect();
            let known = match known.is_empty() {
                true => "none".into(),
                false => known.join(", "),
            };
            Error::input(
                "--view",
                format!("the scene has no view `{name}`; it has: {known}"),
            )
        })
    }

    /// Returns the view of a camera of this scene.
    ///
    /// # Errors
    /// The camera is outside the domain.
    pub fn view(&self, camera: &CameraEntry, size: (usize, usize)) -> Result<View> {
        let u = camera_point(&self.world.manifold, &self.scene.source, camera)?;
        Ok(View::new(camera, u, size))
    }
}
