//! A scene placed in its manifold: triangles in chart coordinates, materials, skies.
//!
//! In: a [`SceneFile`] and its [`Manifold`]. Out: a [`World`] that rays can be intersected with and
//! hits be shaded from. Placement: DESIGN §2; normals are carried as covectors, by the inverse
//! transpose of the placement's differential.

use super::{
    accel::Accelerator,
    intersect::Hit,
    scene::{Material, Mesh, ObjectEntry, Placement, SceneFile},
    sky::Sky,
};
use crate::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    geodesic::{Ray, Settings, ends, perpendiculars},
    manifold::{Carried, Manifold},
};
use glam::{DMat3, DVec3};
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

/// Everything that can be seen.
pub struct World {
    /// The manifold.
    pub manifold: Arc<Manifold>,
    /// The triangles in chart coordinates.
    pub accelerator: Accelerator,
    /// One for each triangle.
    pub faces: Vec<Face>,
    /// All materials.
    pub materials: Vec<Material>,
    /// The sky of each exit, and last the one of paths that end nowhere.
    pub skies: Vec<Option<Sky>>,
    /// What was mended or left out while loading.
    pub warnings: Vec<String>,
}

/// The key under `[sky]` for paths that end by their length.
const NOWHERE: &str = "length";

/// Tolerance of the geodesics that carry exponentially placed vertices.
const PLACEMENT_TOLERANCE: f64 = 1e-9;

impl World {
    /// Loads meshes and skies of `scene` and places them in `manifold`.
    ///
    /// # Errors
    /// Files that cannot be read, objects outside the domain, skies of exits that do not exist.
    pub fn new(scene: &SceneFile, manifold: Arc<Manifold>) -> Result<Self> {
        let skies = load_skies(scene, &manifold)?;
        let mut world = Self {
            accelerator: Accelerator::build(&[]),
            faces: Vec::new(),
            materials: Vec::new(),
            skies,
            warnings: Vec::new(),
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
        if !scene.lights.is_empty() {
            world.warnings.push(
                "lights of the scene are not followed yet: objects are lit from the camera".into(),
            );
        }
        world.accelerator = Accelerator::build(&triangles);
        Ok(world)
    }

    /// The chart point of a hit, inside the limits of glued coordinates.
    pub fn point(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.accelerator.triangles()[hit.triangle as usize];
        let [y, z] = hit.barycentric.map(f64::from);
        let u = a * (1.0 - y - z) + b * y + c * z;
        self.manifold.domain.wrap(u)
    }

    /// The normal of a hit as a covector of the chart, not of unit length.
    pub fn covector(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.faces[hit.triangle as usize].normals;
        let [y, z] = hit.barycentric.map(f64::from);
        a * (1.0 - y - z) + b * y + c * z
    }

    /// How texture coordinates change on the plane of a triangle by the way `way`.
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
        let vertices = match object.placement {
            Placement::Linear => linear(&self.manifold, object, mesh),
            Placement::Exponential => exponential(&self.manifold, object, mesh)
                .ok_or_else(|| self.unreachable(scene, object))?,
        };
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

/// Chart point and normal covector of every vertex: `u0 + S R x`, `(S R)⁻ᵀ n`.
fn linear(manifold: &Manifold, object: &ObjectEntry, mesh: &Mesh) -> Vec<(DVec3, DVec3)> {
    let axes = manifold.standard_frame(object.at) * DMat3::from_quat(object.rotation);
    let covector = axes.inverse().transpose();
    let place = |(x, n): (&DVec3, &DVec3)| (object.at + axes * *x * object.scale, covector * *n);
    mesh.positions
        .iter()
        .zip(&mesh.normals)
        .map(place)
        .collect()
}

/// Chart point and normal covector of every vertex: `exp(S R x)`, its differential from the
/// tangent and the deviation columns at the end. `None` if a geodesic does not get there.
fn exponential(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &Mesh,
) -> Option<Vec<(DVec3, DVec3)>> {
    let turned: Vec<DVec3> = mesh
        .positions
        .iter()
        .map(|x| object.rotation * *x * object.scale)
        .collect();
    let settings = Settings {
        tolerance: PLACEMENT_TOLERANCE,
        carried: Carried {
            frame: false,
            deviation: true,
        },
        events: false,
    };
    let rays = turned.iter().map(|x| {
        let d = x.try_normalize().unwrap_or(DVec3::X);
        Ray::new(manifold, object.at, d, x.length())
    });
    let ends = ends(manifold, settings, rays);
    let axes = manifold.standard_frame(object.at);
    let mut placed = Vec::new();
    for ((x, n), end) in turned.iter().zip(&mesh.normals).zip(&ends) {
        let n = object.rotation * *n;
        let length = x.length();
        let Some((step, reached)) = end else {
            placed.push((object.at, axes.inverse().transpose() * n));
            continue;
        };
        if *reached < length {
            return None;
        }
        let d = *x / length;
        let [e1, e2] = perpendiculars(d);
        let [j1, j2] = step.deviation(length)?;
        let to = DMat3::from_cols(step.tangent(length), j1 / length, j2 / length);
        let from = DMat3::from_cols(d, e1, e2);
        // The differential takes d, e1, e2 to the columns of `to`; covectors go by its inverse
        // transpose.
        placed.push((
            step.position(length),
            to.inverse().transpose() * (from.transpose() * n),
        ));
    }
    Some(placed)
}

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
