//! A triangle mesh in groups of one material each: built by the shapes, checked, written as OBJ.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use glam::{DVec2, DVec3};

/// Diffuse colour, specular colour and exponent, as in an MTL file.
pub struct Material {
    pub name: &'static str,
    pub diffuse: [f64; 3],
    pub specular: f64,
    pub shininess: f64,
}

/// Position, unit normal and texture coordinates.
#[derive(Clone, Copy)]
pub struct Vertex {
    pub position: DVec3,
    pub normal: DVec3,
    pub uv: DVec2,
}

/// Triangles index into `vertices`; `groups[i]` has material `materials[i]`.
pub struct Mesh {
    pub name: &'static str,
    pub closed: bool,
    pub has_uv: bool,
    pub materials: Vec<Material>,
    pub vertices: Vec<Vertex>,
    pub groups: Vec<Vec<[usize; 3]>>,
}

/// Files carry five decimals; positions are rounded at once so that checks see what is written.
fn rounded(p: DVec3) -> DVec3 {
    (p * 1e5).round() / 1e5
}

/// A rounded position as a key for joining vertices that differ in normal or texture only.
fn key(p: DVec3) -> [i64; 3] {
    (p * 1e5).round().to_array().map(|c| c as i64)
}

impl Mesh {
    pub fn new(name: &'static str, materials: Vec<Material>) -> Self {
        let groups = materials.iter().map(|_| Vec::new()).collect();
        Self {
            name,
            closed: true,
            has_uv: true,
            materials,
            vertices: Vec::new(),
            groups,
        }
    }

    pub fn vertex(&mut self, position: DVec3, normal: DVec3, uv: DVec2) -> usize {
        self.vertices.push(Vertex {
            position: rounded(position),
            normal: normal.normalize(),
            uv,
        });
        self.vertices.len() - 1
    }

    /// Adds a triangle unless two of its corners coincide, as they do around a pole.
    pub fn triangle(&mut self, material: usize, corners: [usize; 3]) {
        let [a, b, c] = corners.map(|i| key(self.vertices[i].position));
        if a != b && b != c && c != a {
            self.groups[material].push(corners);
        }
    }

    /// Adds a quadrilateral given anticlockwise, split along its shorter diagonal.
    pub fn quad(&mut self, material: usize, [a, b, c, d]: [usize; 4]) {
        let at = |i: usize| self.vertices[i].position;
        let halves = if at(a).distance(at(c)) <= at(b).distance(at(d)) {
            [[a, b, c], [a, c, d]]
        } else {
            [[a, b, d], [b, c, d]]
        };
        halves.into_iter().for_each(|t| self.triangle(material, t));
    }

    /// Adds a sheet of (columns + 1) × (rows + 1) vertices; `material` chooses by column and row.
    /// Columns then rows turn anticlockwise as seen from outside.
    pub fn sheet(
        &mut self,
        [columns, rows]: [usize; 2],
        vertex: impl Fn(usize, usize) -> Vertex,
        material: impl Fn(usize, usize) -> usize,
    ) {
        let first = self.vertices.len();
        for j in 0..=rows {
            for i in 0..=columns {
                let v = vertex(i, j);
                self.vertex(v.position, v.normal, v.uv);
            }
        }
        let at = |i: usize, j: usize| first + j * (columns + 1) + i;
        for j in 0..rows {
            for i in 0..columns {
                let corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                self.quad(material(i, j), corners);
            }
        }
    }

    pub fn triangle_count(&self) -> usize {
        self.groups.iter().map(Vec::len).sum()
    }

    fn triangles(&self) -> impl Iterator<Item = [Vertex; 3]> {
        self.groups
            .iter()
            .flatten()
            .map(|t| t.map(|i| self.vertices[i]))
    }

    /// Stops the program at a mesh that should not be written.
    pub fn check(&self) {
        let name = self.name;
        let finite = |v: &Vertex| v.position.is_finite() && v.normal.is_finite();
        assert!(self.vertices.iter().all(finite), "{name}: not finite");
        let radius = self
            .vertices
            .iter()
            .map(|v| v.position.length())
            .fold(0.0, f64::max);
        assert!((0.8..1.25).contains(&radius), "{name}: radius {radius}");
        for [a, b, c] in self.triangles() {
            let face = (b.position - a.position).cross(c.position - a.position);
            let shaded = a.normal + b.normal + c.normal;
            assert!(
                face.dot(shaded) > 0.0,
                "{name}: wound against its normal near {}",
                a.position
            );
        }
        let volume: f64 = self
            .triangles()
            .map(|[a, b, c]| a.position.dot(b.position.cross(c.position)))
            .sum();
        assert!(volume > 0.0, "{name}: inside out");
        self.check_edges();
    }

    /// No directed edge twice; in a closed mesh each with its opposite.
    fn check_edges(&self) {
        let mut edges = HashMap::new();
        for corners in self.triangles() {
            let [a, b, c] = corners.map(|v| key(v.position));
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_insert(0) += 1;
            }
        }
        for (&(a, b), &count) in &edges {
            assert_eq!(count, 1, "{}: edge {a:?} {b:?} used twice", self.name);
            let matched = edges.contains_key(&(b, a));
            assert!(
                matched || !self.closed,
                "{}: hole at {a:?} {b:?}",
                self.name
            );
        }
    }

    /// Writes `name.obj` and `name.mtl`, leaving out vertices that no triangle uses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        for (ending, text) in [("obj", self.obj()?), ("mtl", self.mtl()?)] {
            let path = folder.join(format!("{}.{ending}", self.name));
            std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        }
        Ok(())
    }

    fn obj(&self) -> Result<String> {
        let mut out = format!("mtllib {0}.mtl\no {0}\n", self.name);
        let mut numbers = vec![0; self.vertices.len()];
        let mut used = Vec::new();
        for &i in self.groups.iter().flatten().flatten() {
            if numbers[i] == 0 {
                used.push(self.vertices[i]);
                numbers[i] = used.len();
            }
        }
        for v in &used {
            let [x, y, z] = (v.position + 0.0).to_array();
            writeln!(out, "v {x:.5} {y:.5} {z:.5}")?;
        }
        for v in used.iter().filter(|_| self.has_uv) {
            writeln!(out, "vt {:.4} {:.4}", v.uv.x, v.uv.y)?;
        }
        for v in &used {
            let [x, y, z] = ((v.normal * 1e4).round() / 1e4 + 0.0).to_array();
            writeln!(out, "vn {x:.4} {y:.4} {z:.4}")?;
        }
        for (material, group) in self.materials.iter().zip(&self.groups) {
            writeln!(out, "usemtl {}", material.name)?;
            for t in group {
                let corner = |i: usize| self.corner(numbers[i]);
                writeln!(out, "f {} {} {}", corner(t[0]), corner(t[1]), corner(t[2]))?;
            }
        }
        Ok(out)
    }

    fn corner(&self, n: usize) -> String {
        if self.has_uv {
            format!("{n}/{n}/{n}")
        } else {
            format!("{n}//{n}")
        }
    }

    fn mtl(&self) -> Result<String> {
        let mut out = String::new();
        for m in &self.materials {
            let [r, g, b] = m.diffuse;
            writeln!(out, "newmtl {}\nKd {r} {g} {b}", m.name)?;
            writeln!(
                out,
                "Ks {0} {0} {0}\nNs {1}\nillum 2\n",
                m.specular, m.shininess
            )?;
        }
        Ok(out)
    }
}
