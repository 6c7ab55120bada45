//! OBJ files as meshes.
//!
//! In: the text, and the folder that other files are relative to. Out: a [`Draft`] of its triangles ([`Obj`]), with
//! materials from the libraries that it names.

use super::{
    libraries::Libraries,
    material::Material,
    mesh::{Mesh, unit_or_none},
    obj::{Corner, Obj},
    smoothing::Draft,
    text::joined,
};
use geofan_core::error::{Error, Result};
use std::path::Path;

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
