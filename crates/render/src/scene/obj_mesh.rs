//! OBJ files as meshes.
//!
//! In: the text, and the folder that other files are relative to. Out: a [`Draft`]. The text is
//! brought into a form that `tobj` reads ([`Obj`]); `tobj` makes single vertices of what stands at the
//! corners, and what it has no place for is put back: colours, materials, which faces are smooth.

use super::{
    draft::Draft,
    libraries::Libraries,
    material::Material,
    mesh::{Mesh, unit_or_none},
    obj::{Obj, Triangulated},
    text::joined,
};
use geofan_core::error::{Error, Result};
use glam::DVec3;
use std::path::Path;

/// Reads the OBJ text that the user calls `name`; other files are relative to `folder`.
pub(super) fn read(name: &str, text: &str, folder: &Path) -> Result<Draft> {
    let text = joined(text);
    let mut obj = Obj::of(name, &text)?;
    let colours = obj.colours();
    let triangulated = obj.triangulated();
    if triangulated.smoothing.is_empty() && obj.tally.has_free_form() {
        let message = "holds free-form surfaces and no faces: export it as polygons";
        return Err(Error::input(name, message));
    }
    let mut mesh = vertices(name, &triangulated, &colours)?;
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

/// Returns a mesh of the triangles, without materials.
fn vertices(name: &str, from: &Triangulated, colours: &[[f32; 4]]) -> Result<Mesh> {
    let mut reader = from.text.as_bytes();
    let options = tobj::LoadOptions {
        single_index: true,
        ..Default::default()
    };
    let no_materials = |_: &Path| tobj::load_mtl_buf(&mut &b""[..]);
    let loaded = tobj::load_obj_buf(&mut reader, &options, no_materials);
    let (models, _) = loaded.map_err(|e| Error::input(name, e.to_string()))?;
    let part = models.into_iter().next().map(|model| model.mesh);
    let part = part.unwrap_or_default();
    let triples = |values: &[f64]| -> Vec<DVec3> {
        let triples = values.chunks_exact(3);
        triples.map(DVec3::from_slice).collect()
    };
    let positions = triples(&part.positions);
    let mut normals = triples(&part.normals);
    normals.iter_mut().for_each(|n| *n = unit_or_none(*n));
    normals.resize(positions.len(), DVec3::ZERO);
    let pairs = part.texcoords.chunks_exact(2);
    let mut uvs: Vec<[f32; 2]> = pairs.map(|t| [t[0] as f32, t[1] as f32]).collect();
    uvs.resize(positions.len(), [0.0; 2]);
    // The first "colour" is the number of the vertex.
    let number = |n: &[f64]| colours.get(n[0] as usize).copied().unwrap_or([1.0; 4]);
    let mut mesh = Mesh {
        colours: part.vertex_color.chunks_exact(3).map(number).collect(),
        positions,
        normals,
        uvs,
        ..Default::default()
    };
    let triangles = part.indices.chunks_exact(3);
    mesh.triangles.extend(triangles.map(|t| [t[0], t[1], t[2]]));
    match mesh.triangles.len() == from.smoothing.len() {
        true => Ok(mesh),
        false => Err(Error::input(name, "its faces could not be told apart")),
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
