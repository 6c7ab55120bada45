//! Meshes as files have them, and the normals that files leave out.
//!
//! In: a [`Draft`]: a mesh with normals that may be missing and triangles that may have no area, and which of its
//! triangles share normals ([`SmoothingKey`]). Out: a finished [`Mesh`], with a normal for every vertex; a vertex gets
//! copies where its faces do not share theirs.
//!
//! Two triangles that meet in an edge share the normals at its ends if they are parts of one face, if
//! the file puts both into one smoothing group, or, where it says nothing about groups, if the
//! surface turns by no more than the crease angle there. So all triangles around a place that can be
//! reached from each other over such edges have one normal: the mean of theirs, each weighed by its
//! angle there, which does not depend on how faces are cut into triangles (G. Thürmer, C. Wüthrich,
//! *Computing vertex normals from polygonal facets*, 1998).

use super::{Mesh, cutting::sorted};
use geofan_core::{
    error::{Error, Result},
    parallel::*,
};
use glam::DVec3;
use std::collections::HashMap;

/// A mesh as a file has it: normals may be missing (zero) and triangles have no area.
#[derive(Default)]
pub(super) struct Draft {
    /// The mesh.
    pub mesh: Mesh,
    /// For each triangle, the normals it shares.
    pub smoothing: Vec<SmoothingKey>,
}

impl Draft {
    /// Returns the finished mesh, without triangles that have no area and with all normals.
    pub(super) fn finished(mut self, name: &str, crease: f64) -> Result<Mesh> {
        let mesh = &mut self.mesh;
        if mesh.positions.iter().any(|p| !p.is_finite()) {
            return Err(Error::input(name, "has a vertex that is not finite"));
        }
        if u32::try_from(3 * mesh.triangles.len() + mesh.positions.len()).is_err() {
            return Err(Error::input(name, "has more than 4294967295 corners"));
        }
        let keep: Vec<bool> = mesh
            .triangles
            .iter()
            .map(|t| mesh.doubled_area(*t) != DVec3::ZERO)
            .collect();
        let degenerate = keep.iter().filter(|keep| !**keep).count();
        if degenerate > 0 {
            retain(&mut mesh.triangles, &keep);
            retain(&mut mesh.material_of, &keep);
            retain(&mut self.smoothing, &keep);
            let note = format!("{name}: {degenerate} triangles without area left out");
            mesh.warnings.push(note);
        }
        if mesh.triangles.is_empty() {
            return Err(Error::input(name, "holds no triangle with an area"));
        }
        fill_normals(mesh, &self.smoothing, crease);
        Ok(self.mesh)
    }
}

/// Keeps what is to be kept.
fn retain<T>(of: &mut Vec<T>, keep: &[bool]) {
    let mut next = keep.iter();
    of.retain(|_| next.next().copied().unwrap_or(true));
}

/// The group of faces that are not smoothed (`s off` or `s 0` in OBJ).
pub(super) const FLAT: u32 = 0;

/// With which others a triangle shares normals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SmoothingKey {
    /// The face that it is a part of.
    pub face: u32,
    /// Its smoothing group; `None` where the file has not named one.
    pub group: Option<u32>,
}

/// Gives the vertices of `mesh` without a normal (zero) theirs; `smoothing` has one for each triangle,
/// and edges that turn by more than `crease` degrees are sharp.
pub(super) fn fill_normals(mesh: &mut Mesh, smoothing: &[SmoothingKey], crease: f64) {
    let lacks = |t: &[u32; 3]| t.iter().any(|v| mesh.normals[*v as usize] == DVec3::ZERO);
    if !mesh.triangles.iter().any(lacks) {
        return;
    }
    let corners = Corners::of(mesh);
    let mut fans = Fans::new(3 * mesh.triangles.len());
    let least = match crease < 180.0 {
        // Rounding must not make an edge of just this angle sharp.
        true => crease.to_radians().cos() - 1e-9,
        false => -2.0,
    };
    corners.join(smoothing, least, &mut fans);
    let roots: Vec<u32> = (0..fans.parents.len() as u32)
        .map(|c| fans.root(c))
        .collect();
    let angles = |t: &[u32; 3]| Corners::angles(mesh, t);
    let angles: Vec<[f64; 3]> = mesh.triangles.par_iter().map(angles).collect();
    let mut sums = vec![DVec3::ZERO; roots.len()];
    for (corner, root) in roots.iter().enumerate() {
        sums[*root as usize] += corners.normals[corner / 3] * angles[corner / 3][corner % 3];
    }
    hand_out(mesh, &roots, &sums);
}

/// Puts the normals of fans into the vertices that lack one. The first fan that a vertex is met in
/// keeps it; others get copies.
fn hand_out(mesh: &mut Mesh, roots: &[u32], sums: &[DVec3]) {
    let lacking: Vec<bool> = mesh.normals.iter().map(|n| *n == DVec3::ZERO).collect();
    let mut first: Vec<Option<u32>> = vec![None; lacking.len()];
    let mut copies: HashMap<(u32, u32), u32> = HashMap::new();
    for (corner, root) in roots.iter().enumerate() {
        let vertex = mesh.triangles[corner / 3][corner % 3];
        if !lacking[vertex as usize] {
            continue;
        }
        let own = first[vertex as usize].get_or_insert(*root) == root;
        let number = match own {
            true => vertex,
            false => *copies
                .entry((vertex, *root))
                .or_insert_with(|| mesh.copy_vertex(vertex)),
        };
        let sum = sums[*root as usize];
        // Opposite faces can cancel; any unit vector will do then, shading is two-sided.
        mesh.normals[number as usize] = sum.try_normalize().unwrap_or(DVec3::Z);
        mesh.triangles[corner / 3][corner % 3] = number;
    }
    // Of vertices that belong to no triangle.
    let lost = mesh.normals.iter_mut().filter(|n| **n == DVec3::ZERO);
    lost.for_each(|n| *n = DVec3::Z);
}

/// Returns the next corner of the same triangle.
fn next(corner: usize) -> usize {
    corner - corner % 3 + (corner + 1) % 3
}

/// Triangles around an edge up to which each is held against each: surfaces modelled from both sides
/// have four. Beyond it only neighbours in the file are, so that no file takes for ever.
const MOST_AROUND: usize = 16;

/// The corners of all triangles.
struct Corners {
    /// Unit normal of each triangle.
    normals: Vec<DVec3>,
    /// The places of its corners: vertices in one place are one, because seams of texture split them.
    places: Vec<[u32; 3]>,
}

/// Returns the place of each point: the lowest number of a point that is there.
fn places(points: &[DVec3]) -> Vec<u32> {
    let point = |i: usize| {
        // Adding zero turns -0 into 0, which has other bits but is the same place.
        let bits = (points[i] + DVec3::ZERO).to_array().map(f64::to_bits);
        (bits, i as u32)
    };
    let mut sorted: Vec<([u64; 3], u32)> = (0..points.len()).into_par_iter().map(point).collect();
    sorted.par_sort_unstable();
    let mut places = vec![0; points.len()];
    for there in sorted.chunk_by(|a, b| a.0 == b.0) {
        for (_, i) in there {
            places[*i as usize] = there[0].1;
        }
    }
    places
}

impl Corners {
    fn of(mesh: &Mesh) -> Self {
        let of_vertex = places(&mesh.positions);
        let normal = |t: &[u32; 3]| {
            let across = mesh.doubled_area(*t);
            // Dividing by the largest component first keeps squares from underflowing.
            (across / across.abs().max_element()).normalize_or_zero()
        };
        let place = |t: &[u32; 3]| t.map(|v| of_vertex[v as usize]);
        Self {
            normals: mesh.triangles.par_iter().map(normal).collect(),
            places: mesh.triangles.par_iter().map(place).collect(),
        }
    }

    /// Returns the place of a corner.
    fn place(&self, corner: usize) -> u32 {
        self.places[corner / 3][corner % 3]
    }

    /// Returns the angles of a triangle at its corners.
    fn angles(mesh: &Mesh, triangle: &[u32; 3]) -> [f64; 3] {
        let at = triangle.map(|v| mesh.positions[v as usize]);
        let angle = |k: usize| (at[(k + 1) % 3] - at[k]).angle_between(at[(k + 2) % 3] - at[k]);
        [0, 1, 2].map(angle)
    }

    /// Returns the sides of all triangles, those in one place one after another: the places at the ends of each, the
    /// lower number first, and the corner that it begins at.
    fn sides(&self) -> Vec<([u32; 2], u32)> {
        let side = |corner: usize| {
            let [from, to] = [corner, next(corner)].map(|c| self.place(c));
            ([from.min(to), from.max(to)], corner as u32)
        };
        sorted(3 * self.places.len(), side, |(ends, _)| ends[0])
    }

    /// Joins the corners of triangles at both ends of every edge across which normals are shared; `least` is the least
    /// cosine between the normals of triangles that share theirs.
    fn join(&self, smoothing: &[SmoothingKey], least: f64, fans: &mut Fans) {
        let sides = self.sides();
        for around in sides.chunk_by(|a, b| a.0 == b.0) {
            let far = if around.len() > MOST_AROUND {
                2
            } else {
                around.len()
            };
            for (i, one) in around.iter().enumerate() {
                for other in around.iter().skip(i + 1).take(far - 1) {
                    let [a, b] = [one.1, other.1].map(|c| c as usize);
                    if self.is_smooth([a, b], smoothing, least) {
                        fans.join(a, next(b));
                        fans.join(next(a), b);
                    }
                }
            }
        }
    }

    /// Tells whether the triangles with sides that begin at these corners share normals across them.
    fn is_smooth(&self, [a, b]: [usize; 2], smoothing: &[SmoothingKey], least: f64) -> bool {
        // Sides of neighbours run against each other, or one of them is inside out.
        if self.place(a) == self.place(b) {
            return false;
        }
        let [one, other] = [a, b].map(|corner| smoothing[corner / 3]);
        let normals = [a, b].map(|corner| self.normals[corner / 3]);
        one.face == other.face
            || match (one.group, other.group) {
                (None, None) => normals[0].dot(normals[1]) >= least,
                (one, other) => one == other && one != Some(FLAT),
            }
    }
}

/// Sets of corners with one normal: a forest in which every tree is a set.
struct Fans {
    parents: Vec<u32>,
}

impl Fans {
    fn new(corners: usize) -> Self {
        Self {
            parents: (0..corners as u32).collect(),
        }
    }

    fn root(&mut self, corner: u32) -> u32 {
        let mut corner = corner;
        while self.parents[corner as usize] != corner {
            let above = self.parents[self.parents[corner as usize] as usize];
            self.parents[corner as usize] = above;
            corner = above;
        }
        corner
    }

    /// Joins two sets; the lower number stays the root, so that nothing depends on the order.
    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a as u32), self.root(b as u32));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}
