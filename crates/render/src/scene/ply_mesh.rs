//! PLY files (Stanford's polygon format) as meshes.
//!
//! In: the bytes of a text or binary file. Out: a [`Draft`]. What is read, by the names that programs
//! use: `x y z`, `nx ny nz`, `red green blue alpha`, texture coordinates (`s t`, `u v`, `texture_u
//! texture_v`) of vertices; `vertex_indices`, `texcoord`, `texnumber` and colours of faces; strips of
//! triangles; `TextureFile` comments. Colours are as a screen shows them (sRGB).
//!
//! `ply-rs-bw` parses. The format: G. Turk, *The PLY Polygon File Format*, 1994.

use super::{
    material::Material,
    mesh::{Mesh, unit_or_none},
    mtl::Shelf,
    polygon::Cutter,
    smoothing::{Draft, SmoothingKey},
};
use crate::picture::srgb_decode;
use geofan_core::error::{Error, Result};
use glam::DVec3;
use ply_rs_bw::{
    parser::{ParseError, Parser, Reader},
    ply::{Property, PropertyAccess, PropertyAccessResult},
};
use std::{collections::HashMap, path::Path};

/// A vertex, a face or a strip: whichever of these the file gives it.
#[derive(Debug, Default, Clone)]
struct Element {
    position: [f64; 3],
    normal: [f64; 3],
    /// Red, green, blue and opacity as a screen shows them.
    colour: [Option<f32>; 4],
    uv: [f32; 2],
    /// Numbers of vertices; −1 ends a strip.
    indices: Vec<i64>,
    /// Texture coordinates of the corners, two each.
    corners: Vec<f64>,
    /// Number of the texture.
    texture: usize,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let value = number(&property).unwrap_or(0.0);
        match name {
            "x" | "y" | "z" => self.position[place(name, "xyz")] = value,
            "nx" | "ny" | "nz" => self.normal[place(&name[1..], "xyz")] = value,
            "s" | "u" | "texture_u" => self.uv[0] = value as f32,
            "t" | "v" | "texture_v" => self.uv[1] = value as f32,
            "vertex_indices" | "vertex_index" => self.indices = list(&property, |x| x as i64),
            "texcoord" => self.corners = list(&property, |x| x),
            "texnumber" => self.texture = value.max(0.0) as usize,
            "red" | "green" | "blue" | "alpha" | "r" | "g" | "b" | "a" | "diffuse_red"
            | "diffuse_green" | "diffuse_blue" => {
                let name = name.strip_prefix("diffuse_").unwrap_or(name);
                self.colour[place(&name[..1], "rgba")] = Some(share(&property));
            }
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

fn place(name: &str, of: &str) -> usize {
    of.find(name).unwrap_or(0)
}

fn number(property: &Property) -> Option<f64> {
    Some(match property {
        Property::Char(x) => (*x).into(),
        Property::UChar(x) => (*x).into(),
        Property::Short(x) => (*x).into(),
        Property::UShort(x) => (*x).into(),
        Property::Int(x) => (*x).into(),
        Property::UInt(x) => (*x).into(),
        Property::Float(x) => (*x).into(),
        Property::Double(x) => *x,
        _ => return None,
    })
}

fn list<T>(property: &Property, of: impl Fn(f64) -> T) -> Vec<T> {
    match property {
        Property::ListChar(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListUChar(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListShort(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListUShort(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListInt(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListUInt(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListFloat(all) => all.iter().map(|x| of((*x).into())).collect(),
        Property::ListDouble(all) => all.iter().map(|x| of(*x)).collect(),
        _ => Vec::new(),
    }
}

/// Returns a part of a colour in [0, 1]: whole numbers are shares of the largest of their type, of bytes of 255.
fn share(property: &Property) -> f32 {
    let full = match property {
        Property::UChar(_) | Property::Char(_) => 255.0,
        Property::UShort(_) | Property::Short(_) => 65535.0,
        // Colours in wider numbers are bytes all the same.
        Property::UInt(_) | Property::Int(_) => 255.0,
        _ => 1.0,
    };
    let value = number(property).unwrap_or(full);
    (value / full).clamp(0.0, 1.0) as f32
}

/// What the standard library says of a file that ends early.
const NO_MORE_BYTES: &str = "failed to fill whole buffer";

/// Returns the beginning of a line, counted from 1, of a file that is text there.
fn line_of(bytes: &[u8], number: Option<usize>) -> Option<String> {
    let line = bytes.split(|b| *b == b'\n').nth(number?.checked_sub(1)?)?;
    let text = str::from_utf8(line).ok()?.trim_end();
    Some(text.chars().take(MOST_OF_A_LINE).collect())
}

/// Letters of a line that are shown.
const MOST_OF_A_LINE: usize = 60;

/// Reads the file that the user calls `name`; textures are beside it, in `folder`.
pub(super) fn read(name: &str, bytes: &[u8], folder: &Path) -> Result<Draft> {
    let failed = |e: ParseError| {
        let place = e
            .line()
            .map_or(name.to_owned(), |line| format!("{name}:{line}"));
        // Inside it says what, around it on more lines where.
        let text = e.to_string();
        let what = text.rsplit("Error: ").next().unwrap_or_default();
        let what = what.lines().next().unwrap_or_default();
        // Of numbers in binary the line is none.
        if what.contains(NO_MORE_BYTES) {
            return Error::input(
                name,
                "ends before all of its numbers have come: copy it again",
            );
        }
        // Which characters the grammar has there says little; what stands there says more.
        if ["expected", "ParseIntError", "ParseFloatError"]
            .iter()
            .any(|word| what.contains(word))
            && let Some(text) = line_of(bytes, e.line())
        {
            return Error::input(
                place,
                format!("`{text}` is nothing that a PLY file has there"),
            );
        }
        let line = format!("Line {}: ", e.line().unwrap_or(0));
        Error::input(place, what.strip_prefix(&line).unwrap_or(what))
    };
    let mut reader = Reader::new(bytes);
    let parser = Parser::<Element>::new();
    let header = parser.read_header(&mut reader).map_err(failed)?;
    let mut payload = parser.read_payload(&mut reader, &header).map_err(failed)?;
    let mut take = |key: &str| payload.shift_remove(key).unwrap_or_default();
    let (vertices, mut faces) = (take("vertex"), take("face"));
    for strip in take("tristrips").iter().chain(&take("tristrip")) {
        faces.extend(strip_triangles(strip));
    }
    if faces.is_empty() && !vertices.is_empty() {
        let message = "holds points and no faces: make a surface of them first, for example in MeshLab (Filters, Remeshing, Surface Reconstruction)";
        return Err(Error::input(name, message));
    }
    let mut builder = PlyMeshBuilder::new(&vertices, &faces);
    for (number, face) in faces.iter().enumerate() {
        let added = builder.add(number, face);
        added.map_err(|message| Error::input(name, format!("face {number}: {message}")))?;
    }
    let textures = header.comments.iter().filter_map(|c| texture_name(c));
    Ok(builder.finish(name, &textures.collect::<Vec<_>>(), folder))
}

/// Returns the file that a comment names as a texture.
fn texture_name(comment: &str) -> Option<&str> {
    let (key, name) = comment.trim().split_once(char::is_whitespace)?;
    key.eq_ignore_ascii_case("TextureFile").then(|| name.trim())
}

/// Returns the triangles of strips, each with the corners in the order of the first.
fn strip_triangles(strip: &Element) -> Vec<Element> {
    let mut triangles = Vec::new();
    for run in strip.indices.split(|i| *i < 0) {
        for (k, three) in run.windows(3).enumerate() {
            let [a, b, c] = [three[0], three[1], three[2]];
            triangles.push(Element {
                indices: if k % 2 == 0 {
                    vec![a, b, c]
                } else {
                    vec![b, a, c]
                },
                ..Element::default()
            });
        }
    }
    triangles
}

/// A mesh being made.
struct PlyMeshBuilder<'a> {
    vertices: &'a [Element],
    /// Set if vertices, or faces, have colours.
    coloured: [bool; 2],
    draft: Draft,
    /// Vertices of the mesh by those of the file and what else the corner has: texture coordinates and a colour, as bits.
    known: HashMap<(u32, [u32; 2], [u32; 4]), u32>,
    cutter: Cutter,
    cut: Vec<[u32; 3]>,
    crossing: usize,
}

impl<'a> PlyMeshBuilder<'a> {
    fn new(vertices: &'a [Element], faces: &[Element]) -> Self {
        let coloured = |all: &[Element]| all.iter().any(|e| e.colour[..3] != [None; 3]);
        Self {
            vertices,
            coloured: [coloured(vertices), coloured(faces)],
            draft: Draft::default(),
            known: HashMap::new(),
            cutter: Cutter::default(),
            cut: Vec::new(),
            crossing: 0,
        }
    }

    fn add(&mut self, number: usize, face: &Element) -> Result<(), String> {
        let count = self.vertices.len();
        let valid = |i: &i64| usize::try_from(*i).ok().filter(|i| *i < count);
        let indices: Option<Vec<usize>> = face.indices.iter().map(valid).collect();
        let Some(indices) = indices else {
            let wrong = face.indices.iter().find(|i| valid(i).is_none());
            let wrong = wrong.copied().unwrap_or(0);
            return Err(format!("vertex {wrong}, but the file has {count} (from 0)"));
        };
        if indices.len() < 3 {
            return Ok(());
        }
        let points: Vec<DVec3> = indices
            .iter()
            .map(|i| self.vertices[*i].position.into())
            .collect();
        let mut cut = std::mem::take(&mut self.cut);
        if !self.cutter.cut(&points, &mut cut) {
            self.crossing += 1;
        }
        for triangle in &cut {
            let corners = triangle.map(|k| self.corner(face, k as usize, indices[k as usize]));
            let mesh = &mut self.draft.mesh;
            mesh.triangles.push(corners);
            mesh.material_of
                .push(u32::try_from(face.texture).unwrap_or(u32::MAX));
            self.draft.smoothing.push(SmoothingKey {
                face: number as u32,
                group: None,
            });
        }
        self.cut = cut;
        Ok(())
    }

    /// Returns the mesh's vertex for corner `k` of a face.
    fn corner(&mut self, face: &Element, k: usize, vertex: usize) -> u32 {
        let from = &self.vertices[vertex];
        let uv = match face.corners.get(2 * k..2 * k + 2) {
            Some(uv) => [uv[0] as f32, uv[1] as f32],
            None => from.uv,
        };
        let colour = if self.coloured[0] {
            from.colour
        } else {
            face.colour
        };
        let [r, g, b, a] = colour.map(|c| c.unwrap_or(1.0));
        let [r, g, b] = [r, g, b].map(srgb_decode);
        let colour = [r, g, b, a];
        let key = (
            vertex as u32,
            uv.map(f32::to_bits),
            colour.map(f32::to_bits),
        );
        let mesh = &mut self.draft.mesh;
        let coloured = self.coloured[0] || self.coloured[1];
        *self.known.entry(key).or_insert_with(|| {
            mesh.positions.push(from.position.into());
            mesh.normals.push(unit_or_none(from.normal.into()));
            mesh.uvs
                .push(uv.map(|x| if x.is_finite() { x } else { 0.0 }));
            if coloured {
                mesh.colours.push(colour);
            }
            (mesh.positions.len() - 1) as u32
        })
    }

    /// Returns the mesh with a material for each texture that is used.
    fn finish(self, name: &str, textures: &[&str], folder: &Path) -> Draft {
        let mut draft = self.draft;
        let coloured = !draft.mesh.colours.is_empty();
        let mesh: &mut Mesh = &mut draft.mesh;
        if self.crossing > 0 {
            let count = self.crossing;
            let note = format!(
                "{name}: {count} faces cross themselves; their inside is a guess: divide them"
            );
            mesh.warnings.push(note);
        }
        let mut shelf = Shelf::default();
        let mut numbers: HashMap<u32, u32> = HashMap::new();
        for of in &mut mesh.material_of {
            *of = *numbers.entry(*of).or_insert_with(|| {
                let file = textures.get(*of as usize);
                let material = match file {
                    Some(file) => shelf.textured(file, (name, folder), &mut mesh.warnings),
                    None => Material::default(),
                };
                let plain = file.is_none() && coloured;
                // The colours of the mesh are all there is.
                let kd = if plain { [1.0; 3] } else { material.kd };
                mesh.materials.push(Material { kd, ..material });
                (mesh.materials.len() - 1) as u32
            });
        }
        draft
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(bytes: &[u8]) -> Result<Mesh> {
        read("a.ply", bytes, Path::new("/nonexistent"))
            .and_then(|draft| draft.finished("a.ply", 30.0))
    }

    const HEAD: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n";
    const SQUARE: &str = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";

    #[test]
    fn colours_as_bytes_become_linear_and_positions_stay_double() {
        let text = format!(
            "{HEAD}property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n{SQUARE}\
             4000000.4 0 0 255 0 188 255\n4000001.4 0 0 255 0 188 255\n4000001.4 1 0 255 0 188 255\n4000000.4 1 0 255 0 188 51\n4 0 1 2 3\n"
        );
        let mesh = load(text.as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[0].x, 4_000_000.4);
        let [red, green, blue, alpha] = mesh.colours[3];
        assert_eq!((red, green, alpha), (1.0, 0.0, 0.2));
        assert!((blue - 0.503).abs() < 1e-3, "{blue}");
        assert_eq!(mesh.materials[0].kd, [1.0; 3]);
        assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    }

    #[test]
    fn binary_files_of_both_orders_give_the_same_as_text() {
        let places = [
            [0.0_f64, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        for big in [false, true] {
            let order = if big { "big" } else { "little" };
            let head = HEAD.replace("ascii", &format!("binary_{order}_endian"));
            let mut bytes = format!("{head}{SQUARE}").into_bytes();
            let mut put = |little: &[u8]| match big {
                true => bytes.extend(little.iter().rev()),
                false => bytes.extend(little),
            };
            for [x, y, z] in places {
                put(&x.to_le_bytes());
                put(&(y as f32).to_le_bytes());
                put(&(z as f32).to_le_bytes());
            }
            put(&[4]);
            (0..4_i32).for_each(|i| put(&i.to_le_bytes()));
            let mesh = load(&bytes).unwrap();
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert!(
                mesh.positions
                    .iter()
                    .zip(places)
                    .all(|(p, q)| p.to_array() == q)
            );
            assert!(mesh.colours.is_empty() && mesh.normals.iter().all(|n| *n == DVec3::Z));
        }
    }

    #[test]
    fn corners_may_have_texture_coordinates_and_faces_colours_of_their_own() {
        let text = format!(
            "{HEAD}element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
             0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1 255 0 0\n3 0 2 3 6 0.5 0.5 1 1 0 1 0 255 0\n"
        );
        let mesh = load(text.as_bytes()).unwrap();
        let of = |t: usize, k: usize| mesh.triangles[t][k] as usize;
        assert_eq!(
            [mesh.uvs[of(0, 0)], mesh.uvs[of(1, 0)]],
            [[0.0, 0.0], [0.5, 0.5]]
        );
        assert_eq!(mesh.colours[of(0, 2)][..3], [1.0, 0.0, 0.0]);
        assert_eq!(mesh.colours[of(1, 2)][..3], [0.0, 1.0, 0.0]);
    }

    #[test]
    fn strips_are_cut_into_triangles_that_turn_the_same_way() {
        let text = format!(
            "{HEAD}element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 1 2\n"
        );
        let mesh = load(text.as_bytes()).unwrap();
        let at = |t: &[u32; 3]| t.map(|v| mesh.positions[v as usize].truncate().to_array());
        let places: Vec<_> = mesh.triangles.iter().map(at).collect();
        let [a, b, c, d] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        assert_eq!(places, [[a, b, c], [c, b, d], [a, b, c]]);
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        let told = |text: &str| load(text.as_bytes()).unwrap_err().to_string();
        let points = format!("{HEAD}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n");
        assert!(told(&points).contains("holds points and no faces"));
        let square = format!("{HEAD}{SQUARE}0 0 0\n1 0 0\n1 1 0\n0 1 0\n");
        let message = told(&format!("{square}4 0 1 2 4\n"));
        assert!(
            message.contains("face 0: vertex 4, but the file has 4"),
            "{message}"
        );
        let message = told(&format!("{HEAD}{SQUARE}0 0 0\n1 0 x\n"));
        assert!(message.starts_with("a.ply:11: "), "{message}");
        assert!(told("ply\nformat ascii 2.0\nend_header\n").starts_with("a.ply"));
    }

    #[test]
    fn damaged_files_never_panic() {
        let text = format!("{HEAD}{SQUARE}0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n");
        for cut in 0..text.len() {
            let _ = load(&text.as_bytes()[..cut]);
            for odd in ["-1", "9", " ", "\n", "e", "99999999999999999999"] {
                let _ = load(format!("{}{odd}{}", &text[..cut], &text[cut..]).as_bytes());
            }
        }
    }
}
