//! Smoothing groups of OBJ texts, and the normals that a file leaves out.
//!
//! In: the text, then the models that `tobj` made of it. Out: a text in which every line is whole
//! and the smoothing group is the name of the group, which is all that `tobj` lets through; later,
//! normals for the vertices that lack one.
//!
//! Normals are smoothed among the faces of one group. A file without any `s` line says nothing
//! about it, and most of those are scans of round things: they are smoothed as a whole.

use super::Mesh;
use glam::DVec3;
use std::{borrow::Cow, collections::HashMap};

/// The group of faces that are not smoothed (`s off` or `s 0`).
pub(super) const FLAT: u32 = 0;

/// What `tobj` sees as the name of the group of faces with a smoothing group.
const NAME: &str = "smoothing-group-";

/// Joins lines that end in a backslash with the next (a blank line takes the place of that, so that
/// line numbers stay), and turns `s` into `g`.
pub(super) fn mend_obj(text: &str) -> Cow<'_, str> {
    let is_special = |line: &str| {
        let key = line.split_whitespace().next().unwrap_or_default();
        line.trim_end().ends_with('\\') || matches!(key, "s" | "g" | "o")
    };
    if !text.lines().any(is_special) {
        return Cow::Borrowed(text);
    }
    let mut mended = String::with_capacity(text.len());
    let mut joined = 0;
    for line in text.lines() {
        if let Some(part) = line.trim_end().strip_suffix('\\') {
            mended.push_str(part);
            mended.push(' ');
            joined += 1;
            continue;
        }
        match line.split_whitespace().next() {
            // Groups and objects have no meaning here, and would take the smoothing group's place.
            Some("g" | "o") if joined == 0 => {}
            Some("s") if joined == 0 => mended.push_str(&smoothing_line(line)),
            _ => mended.push_str(line),
        }
        (0..=joined).for_each(|_| mended.push('\n'));
        joined = 0;
    }
    Cow::Owned(mended)
}

fn smoothing_line(line: &str) -> String {
    let group = match line.split_whitespace().nth(1) {
        None | Some("off") => FLAT,
        Some("on") => 1,
        Some(number) => number.parse().unwrap_or(1),
    };
    format!("g {NAME}{group}")
}

/// The smoothing group of a model called `name`; `None` where the file has not named one.
pub(super) fn group_of(name: &str) -> Option<u32> {
    name.strip_prefix(NAME)?.parse().ok()
}

/// The mesh with three vertices of its own for every triangle, so that each can have its own
/// normals.
pub(super) fn unshared(from: tobj::Mesh) -> tobj::Mesh {
    let spread = |values: &[f32], width: usize| -> Vec<f32> {
        let of = |i: &u32| values.get(*i as usize * width..(*i as usize + 1) * width);
        let all: Option<Vec<&[f32]>> = from.indices.iter().map(of).collect();
        all.unwrap_or_default().concat()
    };
    tobj::Mesh {
        positions: spread(&from.positions, 3),
        normals: spread(&from.normals, 3),
        texcoords: spread(&from.texcoords, 2),
        indices: (0..from.indices.len() as u32).collect(),
        material_id: from.material_id,
        ..Default::default()
    }
}

/// The vertices without a normal, and which faces theirs is made of.
#[derive(Default)]
pub(super) struct Lacking {
    /// The smoothing group of what is being read.
    pub group: Option<u32>,
    vertices: Vec<(u32, Option<u32>)>,
    /// Number of the first triangle after each run of triangles of one group.
    runs: Vec<(usize, Option<u32>)>,
}

/// Where a normal is shared: a place (not a vertex, because seams of texture split those) and a
/// smoothing group.
type Key = ([u64; 3], Option<u32>);

fn key(p: DVec3, group: Option<u32>) -> Key {
    // Adding zero turns -0 into 0, which has other bits but is the same place.
    ((p + DVec3::ZERO).to_array().map(f64::to_bits), group)
}

impl Lacking {
    /// These vertices of the present group lack a normal.
    pub(super) fn note(&mut self, vertices: impl Iterator<Item = u32>) {
        let group = self.group;
        self.vertices.extend(vertices.map(|v| (v, group)));
    }

    /// The triangles up to number `end` belong to the present group.
    pub(super) fn note_triangles(&mut self, end: usize) {
        self.runs.push((end, self.group));
    }

    /// Gives the vertices the area-weighted mean normal of the triangles of their group around
    /// their place; those that are not smoothed that of their own triangle.
    pub(super) fn fill(&self, mesh: &mut Mesh) {
        if self.vertices.is_empty() {
            return;
        }
        let mut sums: HashMap<Key, DVec3> = HashMap::with_capacity(self.vertices.len());
        let mut own: HashMap<u32, DVec3> = HashMap::new();
        for &(vertex, group) in &self.vertices {
            if group == Some(FLAT) {
                own.insert(vertex, DVec3::ZERO);
            } else {
                sums.insert(key(mesh.positions[vertex as usize], group), DVec3::ZERO);
            }
        }
        let mut begin = 0;
        for &(end, group) in &self.runs {
            for &triangle in &mesh.triangles[begin..end] {
                let normal = mesh.doubled_area(triangle);
                for corner in triangle {
                    let place = key(mesh.positions[corner as usize], group);
                    let sum = match group {
                        Some(FLAT) => own.get_mut(&corner),
                        _ => sums.get_mut(&place),
                    };
                    if let Some(sum) = sum {
                        *sum += normal;
                    }
                }
            }
            begin = end;
        }
        for &(vertex, group) in &self.vertices {
            let sum = match group {
                Some(FLAT) => own[&vertex],
                _ => sums[&key(mesh.positions[vertex as usize], group)],
            };
            // Opposite faces can cancel; any unit vector will do then, shading is two-sided.
            let largest = sum.abs().max_element();
            mesh.normals[vertex as usize] = (sum / largest).normalize_or(DVec3::Z);
        }
    }
}
