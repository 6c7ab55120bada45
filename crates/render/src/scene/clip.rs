//! The part of a mesh that is near its origin.
//!
//! In: a mesh and the half side of a cube about its origin. Out: the mesh cut at the sides of the cube
//! (I. Sutherland, G. Hodgman, *Reentrant polygon clipping*, 1974). Triangles that share an edge share
//! the vertices in which it is cut.

use super::Mesh;
use std::collections::HashMap;

/// Returns the part of `mesh` of which all coordinates are within ±`half`.
pub(super) fn clipped(mesh: &Mesh, half: f64) -> Mesh {
    let mut clipper = Clipper {
        mesh: mesh.clone(),
        half,
        cuts: HashMap::new(),
    };
    let triangles = std::mem::take(&mut clipper.mesh.triangles);
    let materials = std::mem::take(&mut clipper.mesh.material_of);
    for (triangle, material) in triangles.into_iter().zip(materials) {
        let sides = [0, 1, 2].into_iter().flat_map(|k| [(k, -1.0), (k, 1.0)]);
        let part = sides.fold(triangle.to_vec(), |part, side| clipper.cut(&part, side));
        for k in 2..part.len() {
            let corners = [part[0], part[k - 1], part[k]];
            if clipper.mesh.doubled_area(corners) != glam::DVec3::ZERO {
                clipper.mesh.triangles.push(corners);
                clipper.mesh.material_of.push(material);
            }
        }
    }
    used_vertices(&clipper.mesh)
}

/// A mesh that is being cut at the sides of a cube.
struct Clipper {
    mesh: Mesh,
    half: f64,
    /// The vertices in which edges are cut, by the edge (the lower vertex first), axis and side.
    cuts: HashMap<(u32, u32, usize, bool), u32>,
}

impl Clipper {
    /// Returns the part of a polygon on the inner side of the cube's side on this axis, with this sign.
    fn cut(&mut self, polygon: &[u32], (axis, sign): (usize, f64)) -> Vec<u32> {
        let mut part = Vec::with_capacity(polygon.len() + 1);
        for (i, &vertex) in polygon.iter().enumerate() {
            let next = polygon[(i + 1) % polygon.len()];
            let inside = [vertex, next].map(|v| self.depth(v, (axis, sign)) >= 0.0);
            if inside[0] {
                part.push(vertex);
            }
            if inside[0] != inside[1] {
                part.push(self.between(vertex.min(next), vertex.max(next), (axis, sign)));
            }
        }
        part
    }

    /// Returns how far a vertex is inside a side of the cube.
    fn depth(&self, vertex: u32, (axis, sign): (usize, f64)) -> f64 {
        self.half - sign * self.mesh.positions[vertex as usize][axis]
    }

    /// Returns the vertex in which a side of the cube cuts an edge.
    fn between(&mut self, a: u32, b: u32, side: (usize, f64)) -> u32 {
        let key = (a, b, side.0, side.1 > 0.0);
        if let Some(known) = self.cuts.get(&key) {
            return *known;
        }
        let (from, to) = (self.depth(a, side), self.depth(b, side));
        let t = from / (from - to);
        let number = self.mesh.copy_vertex(a);
        let (i, j, new) = (a as usize, b as usize, number as usize);
        let mesh = &mut self.mesh;
        mesh.positions[new] = mesh.positions[i].lerp(mesh.positions[j], t);
        mesh.positions[new][side.0] = side.1 * self.half;
        // Not of unit length: so they interpolate as the whole edge's do.
        mesh.normals[new] = mesh.normals[i].lerp(mesh.normals[j], t);
        mesh.uvs[new] = mixed(mesh.uvs[i], mesh.uvs[j], t as f32);
        if !mesh.colours.is_empty() {
            mesh.colours[new] = mixed(mesh.colours[i], mesh.colours[j], t as f32);
        }
        self.cuts.insert(key, number);
        number
    }
}

fn mixed<const N: usize>(a: [f32; N], b: [f32; N], t: f32) -> [f32; N] {
    std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
}

/// Copies a mesh without the vertices that no triangle has.
fn used_vertices(mesh: &Mesh) -> Mesh {
    let mut kept = Mesh {
        material_of: mesh.material_of.clone(),
        materials: mesh.materials.clone(),
        warnings: mesh.warnings.clone(),
        ..Mesh::default()
    };
    let mut numbers: HashMap<u32, u32> = HashMap::new();
    for triangle in &mesh.triangles {
        let corners = triangle.map(|vertex| {
            *numbers.entry(vertex).or_insert_with(|| {
                let from = vertex as usize;
                kept.positions.push(mesh.positions[from]);
                kept.normals.push(mesh.normals[from]);
                kept.uvs.push(mesh.uvs[from]);
                kept.colours.extend(mesh.colours.get(from));
                (kept.positions.len() - 1) as u32
            })
        });
        kept.triangles.push(corners);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// A square of side 2000 in a plane through the origin, its texture along its sides.
    fn square() -> Mesh {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let (x, y) = (DVec3::new(0.8, 0.0, 0.6), DVec3::Y);
        Mesh {
            positions: corners.map(|c| 1e3 * (x * c[0] + y * c[1])).to_vec(),
            normals: vec![x.cross(y); 4],
            uvs: corners.map(|c| c.map(|x| x as f32)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material_of: vec![0, 1],
            ..Mesh::default()
        }
    }

    #[test]
    fn what_is_left_has_its_area_texture_and_no_crack() {
        let part = clipped(&square(), 2.0);
        let area: f64 = part
            .triangles
            .iter()
            .map(|t| 0.5 * part.doubled_area(*t).length())
            .sum();
        assert!((area - 4.0 * 4.0 / 0.8).abs() < 1e-9, "{area}");
        for (p, uv) in part.positions.iter().zip(&part.uvs) {
            assert!(p.abs().max_element() <= 2.0);
            assert!((f64::from(uv[1]) - p.y / 1e3).abs() < 1e-6);
        }
        // The diagonal is cut at the same vertices for both.
        let corners: usize = part.positions.len();
        let mut apart = part.positions.clone();
        apart.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        apart.dedup_by(|a, b| a.abs_diff_eq(*b, 1e-9));
        assert_eq!(apart.len(), corners);
        assert!(part.material_of.contains(&0) && part.material_of.contains(&1));
    }

    #[test]
    fn what_is_inside_stays_and_what_is_outside_goes() {
        let inside = clipped(&square(), 2e3);
        assert_eq!(inside.triangles, square().triangles);
        let mut far = square();
        far.positions.iter_mut().for_each(|p| *p += DVec3::Y * 5e3);
        let gone = clipped(&far, 2.0);
        assert!(gone.triangles.is_empty() && gone.positions.is_empty());
    }
}
