//! Cutting a mesh to what fits the space: the part of it near its origin, and triangles so small that placed they are
//! as bent as the space.
//!
//! In: a mesh and the half side of a cube about its origin. Out: the mesh cut at the sides of the cube
//! (I. Sutherland, G. Hodgman, *Reentrant polygon clipping*, 1974). Triangles that share an edge share
//! the vertices in which it is cut.
//!
//! In: a mesh and the map that places its points. Out: a mesh with more triangles whose edges,
//! straight in the chart, depart from the geodesic between their ends, and from the image of the
//! straight edge, by at most [`SAG`] of the object's size.
//!
//! An edge is split for both triangles at it, so no gap opens; where the mesh has two edges in one place (a seam of
//! texture), a gap is at most as wide as the tolerance. A triangle is cut by the middles of those of its edges that are
//! split. The sides of triangles are sorted by their vertices: counting takes a third of the time that comparing takes
//! on two threads.

use super::{Mesh, placement::bend};
use geofan_core::{manifold::Manifold, parallel::*};
use glam::DVec3;
use std::{
    borrow::Cow,
    collections::{HashMap, HashSet},
};

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

/// Chart point and normal covector of every vertex.
pub type Points = Vec<(DVec3, DVec3)>;

/// Largest departure of an edge, as a share of the object's radius: half a pixel of an object that
/// is 1000 pixels in radius. Each halving costs up to twice the triangles.
pub const SAG: f64 = 5e-4;

/// Most halvings of one edge, and most triangles of one object: an edge that is still bent after
/// them runs through a place where no mesh will do.
const MOST_ROUNDS: usize = 10;
pub(super) const MOST_TRIANGLES: usize = 4_000_000;

/// Most triangles of an object that has been clipped: it fills its space, and where lengths grow
/// exponentially no number is enough.
pub(super) const MOST_OF_CLIPPED: usize = 200_000;

/// A subdivided mesh.
pub(super) struct Subdivided<'m> {
    pub mesh: Cow<'m, Mesh>,
    /// Its vertices, placed.
    pub vertices: Points,
    /// The edges split in each round.
    pub rounds: Vec<Vec<Edge>>,
    /// The number of edges that should be split still.
    pub left: usize,
}

/// Subdivides a mesh. `radius` is the object's, in the metric, and it may have at most `most_triangles`; `place` turns
/// mesh points and normals into [`Points`], or fails.
pub(super) fn subdivided<'m>(
    manifold: &Manifold,
    mut mesh: Cow<'m, Mesh>,
    (radius, most_triangles): (f64, usize),
    place: impl Fn(&[DVec3], &[DVec3]) -> Option<Points>,
) -> Option<Subdivided<'m>> {
    let mut vertices = place(&mesh.positions, &mesh.normals)?;
    let mut fate: HashMap<Edge, Fate> = HashMap::new();
    let mut rounds = Vec::new();
    let departures = |middles: &Middles, vertices: &Points| -> Option<Vec<f64>> {
        let placed = place(&middles.positions, &middles.normals)?;
        let of = |(edge, middle): (&Edge, &(DVec3, DVec3))| {
            let [a, b] = edge.map(|v| vertices[v as usize].0);
            departure(manifold, a, b, middle.0)
        };
        Some(middles.edges.par_iter().zip(&placed).map(of).collect())
    };
    let mut edges = all_edges(&mesh);
    let sample = Middles::of(&mesh, sampled(&edges));
    let found = departures(&sample, &vertices)?;
    let rates = found.iter().zip(&sample.edges);
    let rate = rates
        .map(|(d, e)| d / squared_length(&mesh, e))
        .fold(0.0, |a, b| if b <= a { a } else { b });
    for round in 0.. {
        let new = |e: &Edge| {
            let expected = SAFETY * rate * squared_length(&mesh, e);
            !fate.contains_key(e) && !(expected <= SAG * radius)
        };
        let middles = Middles::of(&mesh, edges.into_par_iter().filter(new).collect());
        let found = departures(&middles, &vertices)?;
        let split: Vec<bool> = found.iter().map(|d| !(*d <= SAG * radius)).collect();
        let left = split.iter().filter(|s| **s).count();
        let full = mesh.triangles.len() + 3 * left > most_triangles;
        if left == 0 || round == MOST_ROUNDS || full {
            return Some(Subdivided {
                mesh,
                vertices,
                rounds,
                left,
            });
        }
        for (edge, _) in middles
            .edges
            .iter()
            .zip(&split)
            .filter(|(_, split)| !**split)
        {
            fate.insert(*edge, None);
        }
        let bent = middles
            .edges
            .iter()
            .zip(&split)
            .filter(|(_, split)| **split);
        let middles = Middles::of(&mesh, with_longest(&mesh, bent.map(|(e, _)| *e).collect()));
        let placed = place(&middles.positions, &middles.normals)?;
        vertices.extend(placed);
        split_edges(mesh.to_mut(), &middles, &mut fate);
        rounds.push(middles.edges);
        edges = all_edges(&mesh);
    }
    None
}

/// Cuts a mesh by edges that were split another time; `None` if it has other vertices.
pub(super) fn cut_again<'m>(
    mut mesh: Cow<'m, Mesh>,
    rounds: &[Vec<Edge>],
) -> Option<Cow<'m, Mesh>> {
    let mut fate: HashMap<Edge, Fate> = HashMap::new();
    for edges in rounds {
        let known = |edge: &Edge| edge.iter().all(|v| (*v as usize) < mesh.positions.len());
        if !edges.iter().all(known) {
            return None;
        }
        let middles = Middles::of(&mesh, edges.clone());
        split_edges(mesh.to_mut(), &middles, &mut fate);
    }
    Some(mesh)
}

/// Makes the middles of edges vertices, and cuts the triangles at them.
fn split_edges(mesh: &mut Mesh, middles: &Middles, fate: &mut HashMap<Edge, Fate>) {
    for (i, edge) in middles.edges.iter().enumerate() {
        fate.insert(*edge, Some(middles.append(i, mesh)));
    }
    cut(mesh, fate);
}

/// Two vertices, the lower first.
pub(super) type Edge = [u32; 2];

/// The vertex in the middle of an edge that is split.
type Fate = Option<u32>;

fn edge(a: u32, b: u32) -> Edge {
    [a.min(b), a.max(b)]
}

fn edges([a, b, c]: [u32; 3]) -> [Edge; 3] {
    [edge(a, b), edge(b, c), edge(c, a)]
}

/// Measures how far (in the metric) the chart line from `a` to `b` is from its geodesic, or its middle from
/// where it should be: a bend by the angle θ over the length ℓ makes a sagitta of θ ℓ / 8.
fn departure(manifold: &Manifold, a: DVec3, b: DVec3, middle: DVec3) -> f64 {
    let half = 0.5 * (a + b);
    let into = manifold.standard_frame(half).inverse();
    let sagitta = bend(manifold, a, b, 1) * (into * (b - a)).length() / 8.0;
    sagitta.max((into * (middle - half)).length())
}

/// The edges to split, in order, and with them the longest edge of every triangle that one of them
/// belongs to: otherwise a long edge whose middle happens to be right would leave ever thinner
/// triangles (M.-C. Rivara, *Mesh refinement processes based on the generalized bisection of
/// simplices*, 1984).
fn with_longest(mesh: &Mesh, mut split: HashSet<Edge>) -> Vec<Edge> {
    loop {
        let before = split.len();
        for triangle in &mesh.triangles {
            let sides = edges(*triangle);
            if sides.iter().any(|e| split.contains(e)) {
                let longer = |a: &Edge, b: &Edge| {
                    squared_length(mesh, a)
                        .total_cmp(&squared_length(mesh, b))
                        .then(a.cmp(b))
                };
                split.extend(sides.into_iter().max_by(longer));
            }
        }
        if split.len() == before {
            let mut all: Vec<Edge> = split.into_iter().collect();
            all.sort_unstable();
            return all;
        }
    }
}

/// All edges, each once, in order.
fn all_edges(mesh: &Mesh) -> Vec<Edge> {
    let of = |side: usize| {
        let triangle = mesh.triangles[side / 3];
        edge(triangle[side % 3], triangle[(side + 1) % 3])
    };
    let mut all = sorted(3 * mesh.triangles.len(), of, |edge| edge[0]);
    all.dedup();
    all
}

/// Edges by which the rest are judged: departures grow with the square of the length, so the largest
/// rate of a few thousand says which edges cannot reach the tolerance. A mesh of a million
/// triangles is then placed without following a geodesic to the middle of every edge.
const SAMPLED: usize = 4096;

/// Factor by which the rate of another edge may exceed the largest sampled one: the rate of another edge might be.
const SAFETY: f64 = 4.0;

fn sampled(edges: &[Edge]) -> Vec<Edge> {
    let stride = edges.len().div_ceil(SAMPLED).max(1);
    edges.iter().step_by(stride).copied().collect()
}

fn squared_length(mesh: &Mesh, [a, b]: &Edge) -> f64 {
    mesh.positions[*a as usize].distance_squared(mesh.positions[*b as usize])
}

/// The middles of edges.
struct Middles {
    edges: Vec<Edge>,
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    uvs: Vec<[f32; 2]>,
    /// Empty where the mesh has none.
    colours: Vec<[f32; 4]>,
}

impl Middles {
    fn of(mesh: &Mesh, new: Vec<Edge>) -> Self {
        let half = |of: &[DVec3]| -> Vec<DVec3> {
            let middle = |[a, b]: &Edge| 0.5 * (of[*a as usize] + of[*b as usize]);
            new.iter().map(middle).collect()
        };
        let uv = |[a, b]: &Edge| mean(mesh.uvs[*a as usize], mesh.uvs[*b as usize]);
        let colour = |[a, b]: &Edge| mean(mesh.colours[*a as usize], mesh.colours[*b as usize]);
        let coloured = if mesh.colours.is_empty() {
            0
        } else {
            new.len()
        };
        Self {
            positions: half(&mesh.positions),
            // Not of unit length: so they interpolate as the whole edge's do.
            normals: half(&mesh.normals),
            uvs: new.iter().map(uv).collect(),
            colours: new.iter().take(coloured).map(colour).collect(),
            edges: new,
        }
    }

    /// Makes middle `i` a vertex of `mesh`.
    fn append(&self, i: usize, mesh: &mut Mesh) -> u32 {
        mesh.positions.push(self.positions[i]);
        mesh.normals.push(self.normals[i]);
        mesh.uvs.push(self.uvs[i]);
        mesh.colours.extend(self.colours.get(i));
        (mesh.positions.len() - 1) as u32
    }
}

fn mean<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    std::array::from_fn(|k| 0.5 * (a[k] + b[k]))
}

/// Cuts every triangle by the middles of its split edges.
fn cut(mesh: &mut Mesh, fate: &HashMap<Edge, Fate>) {
    let triangles = std::mem::take(&mut mesh.triangles);
    let materials = std::mem::take(&mut mesh.material_of);
    for (triangle, material) in triangles.into_iter().zip(materials) {
        let middles = edges(triangle).map(|e| fate.get(&e).copied().flatten());
        let parts = parts(triangle, middles);
        mesh.material_of.extend(parts.iter().map(|_| material));
        mesh.triangles.extend(parts);
    }
}

/// The parts of a triangle whose edges ab, bc, ca have these middles.
fn parts([a, b, c]: [u32; 3], middles: [Option<u32>; 3]) -> Vec<[u32; 3]> {
    match middles {
        [None, None, None] => vec![[a, b, c]],
        [Some(m), None, None] => vec![[a, m, c], [m, b, c]],
        [Some(m), Some(n), None] => vec![[m, b, n], [a, m, n], [a, n, c]],
        [Some(m), Some(n), Some(o)] => vec![[a, m, o], [m, b, n], [o, n, c], [m, n, o]],
        // Turned until the split edges come first.
        [x, y, Some(z)] if x.is_some() => parts([c, a, b], [Some(z), x, y]),
        [x, y, z] => parts([b, c, a], [y, z, x]),
    }
}

/// Sorts `count` items, of which `item` makes each from its place, by their numbers and, where those are equal, by
/// comparing: numbers must come first in the order of items.
pub(super) fn sorted<T: Copy + Default + Ord>(
    count: usize,
    item: impl Fn(usize) -> T,
    number: impl Fn(&T) -> u32,
) -> Vec<T> {
    let of = |i: usize| number(&item(i)) as usize;
    let numbers = (0..count).map(of).max().map_or(0, |most| most + 1);
    // Where the items of each number begin, then where the next of them goes.
    let mut next = vec![0_u32; numbers + 1];
    (0..count).for_each(|i| next[of(i) + 1] += 1);
    for k in 1..next.len() {
        next[k] += next[k - 1];
    }
    let mut sorted = vec![T::default(); count];
    for item in (0..count).map(item) {
        let slot = &mut next[number(&item) as usize];
        sorted[*slot as usize] = item;
        *slot += 1;
    }
    for equal in sorted.chunk_by_mut(|a, b| number(a) == number(b)) {
        equal.sort_unstable();
    }
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;
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

    #[test]
    fn every_way_of_cutting_keeps_area_and_orientation() {
        // Corners 0, 1, 2 and the middles 3 (of 01), 4 (of 12), 5 (of 20).
        let at = [
            [0.0, 0.0],
            [1.0, 0.0],
            [0.0, 1.0],
            [0.5, 0.0],
            [0.5, 0.5],
            [0.0, 0.5],
        ];
        for mask in 0..8_usize {
            let middles = [0, 1, 2].map(|k| (mask >> k & 1 == 1).then_some(3 + k as u32));
            let found = parts([0, 1, 2], middles);
            assert_eq!(found.len(), 1 + mask.count_ones() as usize);
            let doubled = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|i| at[i as usize]);
                (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            };
            assert!(found.iter().all(|t| doubled(t) > 0.0), "{mask}: {found:?}");
            assert_eq!(found.iter().map(doubled).sum::<f64>(), 1.0);
        }
    }

    #[test]
    fn items_are_sorted_as_by_comparing() {
        let mut random = Stream::new(&[3]);
        let pair = |random: &mut Stream| [0; 2].map(|_| random.between(0.0, 50.0) as u32);
        for count in [0, 1, 2, 1000] {
            let pairs: Vec<[u32; 2]> = (0..count).map(|_| pair(&mut random)).collect();
            let mut compared = pairs.clone();
            compared.sort_unstable();
            assert_eq!(sorted(count, |i| pairs[i], |p| p[0]), compared);
        }
    }
}
