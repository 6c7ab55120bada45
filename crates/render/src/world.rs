//! A scene placed in its manifold: triangles in chart coordinates, materials, skies.
//!
//! In: a [`SceneFile`] and its [`Manifold`]. Out: a [`World`] that rays can be intersected with and
//! hits be shaded from.

use super::{
    accel::{Accelerator, HoledTriangle, OPEN},
    copies::SceneCopies,
    intersect::{Hit, Seen},
    lightmap::Lightmap,
    moving_objects::{DelayedObject, ObjectPath, SeenInterval, at_time},
    placement_checks::{
        any_reaches, check_delay, check_extent, check_place, lamps_out_of_sight, out_of_sight,
        unreachable, unshifted,
    },
    redshift::ObjectState,
    scene::{LightEntry, Material, Mesh, ObjectEntry, Placed, Points, SceneFile, place},
    sky::{self, Sky, load_skies},
};
use geofan_core::{
    diagnostic::Diagnostic, error::Result, geodesic::check_point, manifold::Manifold,
};
use glam::DVec3;
use std::{borrow::Cow, fmt::Debug, io::Write, path::PathBuf, sync::Arc};

/// A triangle as shading needs it.
#[derive(Debug, Clone)]
pub struct Face {
    /// Index of the object in the scene file.
    pub object: u32,
    /// Index into [`World::materials`].
    pub material: u32,
    /// Indices into [`World::corners`].
    pub corners: [u32; 3],
}

/// A corner of triangles as shading needs it: most are shared by six.
#[derive(Debug, Clone)]
pub struct FaceCorner {
    /// Normal, as a covector of the chart (not of unit length).
    pub normal: DVec3,
    /// Texture coordinates.
    pub uv: [f32; 2],
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
    /// The space with light followed from lamps into the future: its cover, where that tells how paths go on.
    pub lamplight: Arc<Manifold>,
    /// The space that covers a glued one, else the same.
    pub cover: Arc<Manifold>,
    /// Where a glued space shows things again.
    pub copies: Option<SceneCopies>,
    /// The triangles in chart coordinates.
    pub accelerator: Accelerator,
    /// One for each triangle.
    pub faces: Vec<Face>,
    /// The corners of all triangles.
    pub corners: Vec<FaceCorner>,
    /// Linear red, green, blue and opacity at the corners of each triangle, times those of its
    /// material; empty where no mesh has any.
    pub colours: Vec<[[f32; 4]; 3]>,
    /// All materials.
    pub materials: Vec<Material>,
    /// Motion and heat of each object of the scene file.
    pub(crate) states: Vec<ObjectState>,
    /// Set if light is weighed with what happens to its frequency on the way.
    pub redshift: bool,
    /// About how many points the light of lamps is worked out at.
    pub light_points: usize,
    /// The sky of each exit, and last the one of paths that end by their length.
    pub skies: Vec<Option<Sky>>,
    /// Lights without extent.
    pub lights: Vec<PointLight>,
    /// Their light on the triangles, where it has been baked; without, the only lamp is at the
    /// camera.
    pub light: Option<Lightmap>,
    /// Set if anything can be seen through.
    pub clear: bool,
    /// Warnings about what was mended or left out while loading.
    pub warnings: Vec<String>,
    /// Meshes by their files and creases, kept for objects that move.
    meshes: Vec<(PathBuf, f64, Arc<Mesh>)>,
}

/// An object of the scene file where it is seen.
struct PlacedObject<'m> {
    /// Its number there.
    index: u32,
    mesh: Cow<'m, Mesh>,
    poses: Poses,
}

/// The vertices of an object.
enum Poses {
    /// At one place for all light.
    Still(Points),
    /// Wherever light that takes time comes from.
    Delayed(Vec<SeenInterval>),
}

impl Poses {
    /// Returns the number of places.
    fn count(&self) -> usize {
        match self {
            Self::Still(_) => 1,
            Self::Delayed(intervals) => intervals.len(),
        }
    }
}

impl World {
    /// Loads meshes and skies of `scene` and places them in `manifold`, objects that move as they are at `time`.
    ///
    /// # Errors
    /// Files that cannot be read, objects outside the domain, skies of exits that do not exist.
    pub fn new(scene: &SceneFile, manifold: Arc<Manifold>, time: f64) -> Result<Self> {
        Self::furnished(scene, (manifold, time), Vec::new())
    }

    /// As [`World::new`], but takes the meshes that `shelf` has, by the paths that the scene gives them, from there.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn furnished(
        scene: &SceneFile,
        (manifold, time): (Arc<Manifold>, f64),
        shelf: Vec<(PathBuf, Arc<Mesh>)>,
    ) -> Result<Self> {
        let skies = load_skies(scene, &manifold)?;
        let lights = lights(scene, &manifold)?;
        check_delay(scene, &manifold)?;
        let cover = match manifold.gluing() {
            Some(_) => Arc::new(manifold.cover().into_owned()),
            None => manifold.clone(),
        };
        let developed = manifold.developed();
        let lamplight = match manifold.has_wind() {
            true => developed.forward()?.into_owned(),
            false => developed.into_owned(),
        };
        let mut warnings = sky::warnings(&skies);
        warnings.extend(lamps_out_of_sight(&manifold, &lights));
        let mut world = Self {
            accelerator: Accelerator::build(&[]),
            faces: Vec::new(),
            corners: Vec::new(),
            colours: Vec::new(),
            materials: Vec::new(),
            states: Vec::new(),
            redshift: scene.redshift,
            light_points: scene.light_points,
            skies,
            lights,
            light: None,
            lamplight: Arc::new(lamplight),
            cover,
            copies: None,
            clear: false,
            warnings,
            meshes: Vec::new(),
            manifold,
        };
        for object in &scene.objects {
            world.load_mesh(object, &shelf)?;
        }
        world.furnish(scene, time)?;
        if !scene.moves() {
            world.meshes = Vec::new();
        }
        Ok(world)
    }

    /// Moves the objects of `scene`, which must be this world's, to where they are at `time`. What light falls
    /// on them ([`World::light`]) is to be computed anew.
    ///
    /// # Errors
    /// An object cannot be placed there; all are missing then.
    pub fn set_time(&mut self, scene: &SceneFile, time: f64) -> Result<()> {
        if !scene.moves() {
            return Ok(());
        }
        self.faces.clear();
        self.corners.clear();
        self.colours.clear();
        self.materials.clear();
        self.states.clear();
        self.light = None;
        self.accelerator = Accelerator::default();
        self.copies = None;
        let told = std::mem::take(&mut self.warnings);
        let placed = self.furnish(scene, time);
        let new = std::mem::replace(&mut self.warnings, told);
        for warning in new {
            if !self.warnings.contains(&warning) {
                self.warnings.push(warning);
            }
        }
        placed
    }

    /// Loads the mesh of an object, unless it is known, or on the `shelf`.
    fn load_mesh(&mut self, object: &ObjectEntry, shelf: &[(PathBuf, Arc<Mesh>)]) -> Result<()> {
        if self.mesh_of(object).is_some() {
            return Ok(());
        }
        let given = shelf.iter().find(|(path, _)| *path == object.mesh);
        let mesh = match given {
            Some((_, mesh)) => mesh.clone(),
            None => {
                let mesh = Arc::new(Mesh::load_creased(&object.mesh, object.crease)?);
                self.warnings.extend(mesh.warnings.iter().cloned());
                mesh
            }
        };
        self.meshes.push((object.mesh.clone(), object.crease, mesh));
        Ok(())
    }

    /// Finds the mesh of an object.
    fn mesh_of(&self, object: &ObjectEntry) -> Option<Arc<Mesh>> {
        let wanted = (&object.mesh, object.crease);
        let mut meshes = self.meshes.iter();
        let found = meshes.find(|(path, crease, _)| (path, *crease) == wanted);
        found.map(|(.., mesh)| mesh.clone())
    }

    /// Places all objects as they are at `time`, or as light brings them then to a camera.
    fn furnish(&mut self, scene: &SceneFile, time: f64) -> Result<()> {
        let meshes: Vec<_> = scene.objects.iter().map(|o| self.mesh_of(o)).collect();
        let mut objects = self.placed(scene, &meshes, time)?;
        // The last triangles are those that move.
        objects.sort_by_key(|object| matches!(object.poses, Poses::Delayed(_)));
        // Lists that grow by themselves would be twice as long while they do.
        let counts = |of: fn(&PlacedObject<'_>) -> usize| objects.iter().map(of).sum();
        let count = counts(|object| object.mesh.triangles.len() * object.poses.count());
        let mut triangles = Vec::with_capacity(count);
        self.faces.reserve_exact(count);
        let corners = counts(|object| object.mesh.positions.len() * object.poses.count());
        self.corners.reserve_exact(corners);
        let mut moving = Vec::new();
        for PlacedObject { index, mesh, poses } in objects {
            let object = (index, self.add_materials(&mesh));
            match poses {
                Poses::Still(vertices) => self.add(object, &mesh, &vertices, &mut triangles),
                Poses::Delayed(intervals) => {
                    for interval in intervals {
                        self.add(object, &mesh, &interval.middle, &mut triangles);
                        moving.extend(kept(&mesh).map(|k| interval.triangle(mesh.triangles[k])));
                    }
                }
            }
        }
        self.accelerator = Accelerator::build_all(triangles, moving, self.holed());
        self.copies = SceneCopies::of(&self.manifold, &self.accelerator);
        self.clear = self.materials.iter().any(Material::is_clear)
            || self.colours.iter().flatten().any(|c| c[3] < 1.0);
        Ok(())
    }

    /// Finds where all objects, which have these meshes, are seen at `time`.
    fn placed<'m>(
        &mut self,
        scene: &SceneFile,
        meshes: &'m [Option<Arc<Mesh>>],
        time: f64,
    ) -> Result<Vec<PlacedObject<'m>>> {
        let manifold = self.manifold.clone();
        let mut all = Vec::new();
        for ((index, object), mesh) in scene.objects.iter().enumerate().zip(meshes) {
            let path = ObjectPath::of(object, &manifold, &scene.source)?;
            let object = &*at_time(object, path.as_ref(), time)?;
            let Some(mesh) = mesh else { continue };
            let placed = self.place(scene, object, mesh)?;
            // What has not begun to move stands still for all light.
            let path = path.filter(|path| scene.delay.is_some() && time > path.during()[0]);
            let delayed = path.as_ref().map(|path| DelayedObject {
                path,
                manifold: &manifold,
                mesh,
                cuts: Arc::new(placed.cuts),
                triangles: placed.mesh.triangles.len(),
                time,
            });
            all.push(PlacedObject {
                index: index as u32,
                mesh: placed.mesh,
                poses: match delayed {
                    Some(delayed) => Poses::Delayed(delayed.intervals()?),
                    None => Poses::Still(placed.vertices),
                },
            });
        }
        Ok(all)
    }

    /// Tells whether the scene has a sky for paths that end by their length.
    pub fn has_length_sky(&self) -> bool {
        self.skies.last().is_some_and(Option::is_some)
    }

    /// Returns the triangles with opacity maps.
    fn holed(&self) -> Vec<HoledTriangle> {
        let faces = self.faces.iter().enumerate();
        let holed = faces.filter_map(|(i, face)| {
            let map = self.materials[face.material as usize].map_d.clone()?;
            Some(HoledTriangle {
                triangle: i as u32,
                uvs: self.uvs(i),
                map,
            })
        });
        holed.collect()
    }

    /// Returns what multiplies the material's colour and opacity at a hit.
    pub fn colour(&self, hit: &Hit) -> [f32; 4] {
        let Some([p, q, r]) = self.colours.get(hit.triangle as usize) else {
            return [1.0; 4];
        };
        let [b, c] = hit.barycentric;
        std::array::from_fn(|k| p[k] * (1.0 - b - c) + q[k] * b + r[k] * c)
    }

    /// Returns the share of the light that a hit's surface stops: 1 solid, 0 not there.
    pub fn opacity(&self, hit: &Hit) -> f32 {
        let face = &self.faces[hit.triangle as usize];
        self.materials[face.material as usize].solid() * self.coverage(hit)
    }

    /// Returns the share of a hit's place that is covered by its material, whatever that does to light.
    pub fn coverage(&self, hit: &Hit) -> f32 {
        let face = &self.faces[hit.triangle as usize];
        let map = &self.materials[face.material as usize].map_d;
        let [p, q, r] = self.uvs(hit.triangle as usize);
        let [b, c] = hit.barycentric;
        let uv = [0, 1].map(|k| p[k] * (1.0 - b - c) + q[k] * b + r[k] * c);
        map.as_ref().map_or(1.0, |map| map.at(uv)) * self.colour(hit)[3]
    }

    /// Returns a hash of the triangles, their normals and their opacity.
    pub fn geometry_fingerprint(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (i, corners) in self.accelerator.triangles().iter().enumerate() {
            for x in corners
                .iter()
                .chain(&self.normals(i))
                .flat_map(|p| p.to_array())
            {
                hasher.update(&x.to_le_bytes());
            }
        }
        for moving in (0..self.faces.len()).filter_map(|i| self.accelerator.motion(i as u32)) {
            hasher.update(format!("{moving:?}").as_bytes());
        }
        self.hash_opacity(&mut hasher);
        *hasher.finalize().as_bytes()
    }

    /// Adds what decides how much light passes, where any does.
    fn hash_opacity(&self, hasher: &mut blake3::Hasher) {
        if !self.clear {
            return;
        }
        for (i, face) in self.faces.iter().enumerate() {
            let material = &self.materials[face.material as usize];
            let colours = self.colours.get(i).map(|all| all.map(|c| c[3]));
            let told = (material.dissolve, colours, self.uvs(i), face.material);
            hasher.update(format!("{told:?} {}", material.is_glass()).as_bytes());
        }
        for map in self.materials.iter().filter_map(|m| m.map_d.as_ref()) {
            hasher.update(format!("{:?}", map.mapping).as_bytes());
            for x in map.values.iter() {
                hasher.update(&x.to_le_bytes());
            }
        }
    }

    /// Computes a hash of everything that can be seen: triangles, materials with their textures, lamps and
    /// skies.
    pub fn fingerprint(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.geometry_fingerprint());
        // Of pictures a digest of their pixels is written.
        let seen = (
            self.written_faces(),
            &self.colours,
            &self.materials,
            &self.lights,
            &self.skies,
        );
        write!(hasher, "{seen:?}").expect("a hash takes everything");
        if let Some(told) = self.said_of_frequencies() {
            hasher.update(told.as_bytes());
        }
        *hasher.finalize().as_bytes()
    }

    /// Returns the faces with their corners, as they are written into a hash.
    fn written_faces(&self) -> impl Debug {
        #[derive(Debug)]
        #[expect(dead_code, reason = "they are only written")]
        struct WrittenFace {
            object: u32,
            material: u32,
            normals: [DVec3; 3],
            uvs: [[f32; 2]; 3],
        }
        let faces = self.faces.iter().enumerate();
        let written = faces.map(|(i, face)| WrittenFace {
            object: face.object,
            material: face.material,
            normals: self.normals(i),
            uvs: self.uvs(i),
        });
        written.collect::<Vec<_>>()
    }

    /// Returns the normals at the corners of a triangle, as covectors of the chart (not of unit length).
    pub fn normals(&self, triangle: usize) -> [DVec3; 3] {
        let corners = self.faces[triangle].corners;
        corners.map(|corner| self.corners[corner as usize].normal)
    }

    /// Returns the texture coordinates at the corners of a triangle.
    pub fn uvs(&self, triangle: usize) -> [[f32; 2]; 3] {
        let corners = self.faces[triangle].corners;
        corners.map(|corner| self.corners[corner as usize].uv)
    }

    /// Tells whether anything is there where a line of sight ends: a surface, or a sky that the scene gives.
    pub fn shows(&self, seen: &Seen) -> bool {
        match seen {
            Seen::Surface(_) => true,
            Seen::Sky { exit, .. } => self.skies[*exit as usize].is_some(),
            Seen::Nothing | Seen::Length | Seen::Singular => self.has_length_sky(),
        }
    }

    /// Tells whether all that leaves through an exit sees the same light.
    pub fn has_one_colour(&self, exit: usize) -> bool {
        self.skies.get(exit).is_some_and(sky::has_one_colour)
    }

    /// Returns the chart point of a hit, inside the limits of glued coordinates.
    pub fn point(&self, hit: &Hit) -> DVec3 {
        self.manifold.domain.wrap(self.point_on_triangle(hit))
    }

    /// Returns the chart point of a hit on the triangle as it is placed, which may lie across such limits.
    pub(crate) fn point_on_triangle(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.accelerator.corners(hit.triangle, hit.s.into());
        let [y, z] = hit.barycentric.map(f64::from);
        a * (1.0 - y - z) + b * y + c * z
    }

    /// Returns the normal of a hit as a covector of the chart, not of unit length.
    pub fn covector(&self, hit: &Hit) -> DVec3 {
        let [a, b, c] = self.normals(hit.triangle as usize);
        let [y, z] = hit.barycentric.map(f64::from);
        a * (1.0 - y - z) + b * y + c * z
    }

    /// Returns the change of texture coordinates on the plane of a triangle along the displacement `way`.
    pub fn texture_change(&self, triangle: u32, way: DVec3) -> [f32; 2] {
        let [a, b, c] = self.accelerator.triangles()[triangle as usize];
        let uvs = self.uvs(triangle as usize);
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

    /// Places an object, and adds its motion and its warnings.
    fn place<'m>(
        &mut self,
        scene: &SceneFile,
        object: &ObjectEntry,
        mesh: &'m Mesh,
    ) -> Result<Placed<'m>> {
        check_place(scene, &self.manifold, object)?;
        let Some(mut placed) = place(&self.manifold, object, mesh) else {
            return Err(unreachable(scene, object));
        };
        check_extent(scene, &self.manifold, object, &placed.vertices)?;
        self.warnings.append(&mut placed.warnings);
        self.warnings.extend(unshifted(scene, object));
        let name = object.mesh.display().to_string();
        if object.cuts.is_none() {
            let corners = placed.vertices.iter().map(|(u, _)| *u);
            let (manifold, vertices) = (&self.manifold, &placed.vertices);
            let between = || any_reaches(manifold, vertices, &placed.mesh.triangles);
            let warning = out_of_sight(manifold, &name, corners, between);
            self.warnings.extend(warning);
        }
        self.add_state(scene, object, &placed.vertices)?;
        Ok(placed)
    }

    /// Adds motion and heat of an object; none of its vertices may be as fast as light, or of no temperature.
    fn add_state(
        &mut self,
        scene: &SceneFile,
        object: &ObjectEntry,
        vertices: &Points,
    ) -> Result<()> {
        let state = ObjectState::new(object, &self.manifold, &scene.source)?;
        state.check(object, &self.manifold, &scene.source, vertices)?;
        self.states.push(state);
        Ok(())
    }

    /// Adds the materials of a mesh; returns the index of the first.
    fn add_materials(&mut self, mesh: &Mesh) -> u32 {
        let first = self.materials.len() as u32;
        self.materials.extend(mesh.materials.iter().cloned());
        first
    }

    /// Adds the triangles of a placed mesh of an object, the first of whose materials has this index, but for those that
    /// are not there at all.
    fn add(
        &mut self,
        (object, first): (u32, u32),
        mesh: &Mesh,
        vertices: &Points,
        triangles: &mut Vec<[DVec3; 3]>,
    ) {
        let first_corner = self.corners.len() as u32;
        let corners = vertices.iter().zip(&mesh.uvs);
        self.corners
            .extend(corners.map(|((_, normal), uv)| FaceCorner {
                normal: *normal,
                uv: *uv,
            }));
        for k in kept(mesh) {
            let (corners, material) = (mesh.triangles[k], mesh.material_of[k]);
            if !(mesh.colours.is_empty() && self.colours.is_empty()) {
                self.colours.resize(self.faces.len(), [[1.0; 4]; 3]);
                self.colours.push(colours(mesh, k));
            }
            triangles.push(corners.map(|c| vertices[c as usize].0));
            self.faces.push(Face {
                object,
                material: first + material,
                corners: corners.map(|c| first_corner + c),
            });
        }
    }
}

/// Returns the colours at the corners of a mesh's triangle.
fn colours(mesh: &Mesh, triangle: usize) -> [[f32; 4]; 3] {
    let colour = |c: u32| mesh.colours.get(c as usize).copied();
    mesh.triangles[triangle].map(|c| colour(c).unwrap_or([1.0; 4]))
}

/// Returns the numbers of a mesh's triangles but for those that are not there at all.
fn kept(mesh: &Mesh) -> impl Iterator<Item = usize> {
    (0..mesh.triangles.len()).filter(|k| {
        let alpha = colours(mesh, *k);
        let alpha = alpha.iter().fold(0.0, |most: f32, c| most.max(c[3]));
        mesh.materials[mesh.material_of[*k] as usize].solid() * alpha >= OPEN
    })
}

/// Returns the lights of `scene`, all inside the domain.
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
