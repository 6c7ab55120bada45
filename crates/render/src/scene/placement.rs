//! Placing a mesh in the manifold: mesh points to chart points, normals to covectors; and how it was placed, packed
//! for pages.
//!
//! In: an [`ObjectEntry`] and its [`Mesh`]. Out: [`Placed`]: the mesh, subdivided where the space
//! asks for it, with a chart point and a normal covector for every vertex.
//!
//! With `A = S(u0) R · scale`, linear placement is `u = u0 + A x` with covectors `A⁻ᵀ n`, placement in the chart the
//! same with `A = R · scale`, and exponential placement is `u = exp_{u0}(A x)` (see [`super::exponential_map`]). What
//! nothing is seen of is not placed along geodesics: geodesics in many directions are followed until they leave the
//! space, or are as long as its paths are.
//!
//! Packed are the cuts that placing objects made, and the chart points and normal covectors of their vertices. To find
//! out how to cut takes geodesics to the middles of all edges, most of the time that placing takes, and points take one
//! to each vertex. Each component of a point comes back within 2⁻²⁵ of the extent of its object (of covectors, which
//! shade and place nothing, 2⁻¹⁸), which no picture shows.
//!
//! Bytes of cuts, little-endian, for each object: 0 where nothing is known; else 1, the radius beyond which the mesh
//! was clipped (f64; infinite where it was not), the number of rounds (u32), and for each its number of edges (u32) and
//! their two columns of vertices ([`super::packed_numbers`]).
//!
//! Bytes of points, little-endian, for each object: the number of its vertices (u32; 0 where nothing is known), then
//! points and covectors, each as the least component along every axis (three f64), the length that whole numbers are
//! over (f64), and three columns of whole numbers.

use super::{
    Mesh, ObjectEntry, Placement,
    cutting::{
        MOST_OF_CLIPPED, MOST_TRIANGLES, Points, Subdivided, clipped, cut_again, subdivided,
    },
    exponential_map::ExponentialMap,
    packed_numbers::{self as numbers, take_chunk},
};
use crate::kept;
use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::{Carried, Manifold},
    parallel::*,
    random::fibonacci_direction,
};
use glam::{DMat3, DVec3};
use std::borrow::Cow;

/// A mesh in the manifold.
pub struct Placed<'m> {
    /// The mesh, in its own units, with the triangles that are placed.
    pub mesh: Cow<'m, Mesh>,
    /// Chart point and normal covector of every vertex.
    pub vertices: Points,
    /// A warning about its placement.
    pub warnings: Vec<String>,
    /// How the mesh was cut.
    pub cuts: Cuts,
}

/// Finds how the mesh of `object`, which does not move, is cut where it is placed, and its vertices if it takes long
/// to place them; `None` if it cannot be placed.
pub fn placed_once(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &Mesh,
) -> Option<(Cuts, Option<Points>)> {
    let placed = place(manifold, object, mesh)?;
    let slow = object.placement == Placement::Exponential;
    Some((placed.cuts, slow.then_some(placed.vertices)))
}

/// Places `mesh` as `object` says; `None` if a geodesic that places it does not get there.
pub fn place<'m>(manifold: &Manifold, object: &ObjectEntry, mesh: &'m Mesh) -> Option<Placed<'m>> {
    // An object that sticks out of a glued domain is whole in the cover.
    let manifold = &*manifold.cover();
    let manifold = &*manifold.still();
    match object.placement {
        Placement::Linear if object.cuts.is_some() => Some(Placed::uncut(
            mesh,
            linear(manifold.standard_frame(object.at), object, mesh),
        )),
        Placement::Linear => {
            let vertices = linear(manifold.standard_frame(object.at), object, mesh);
            let warning = bend_warning(manifold, object, mesh, &vertices);
            Some(Placed {
                warnings: warning.into_iter().collect(),
                ..Placed::uncut(mesh, vertices)
            })
        }
        Placement::Chart => Some(Placed::uncut(mesh, linear(DMat3::IDENTITY, object, mesh))),
        Placement::Exponential => {
            let known = object.cuts.as_ref();
            let known = known.and_then(|cuts| placed_as_cut(manifold, object, mesh, cuts));
            known.or_else(|| along_geodesics(manifold, object, mesh))
        }
    }
}

/// Places by geodesics, and finds how the mesh has to be cut for that; large meshes as they were placed before.
fn along_geodesics<'m>(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &'m Mesh,
) -> Option<Placed<'m>> {
    let mut found = None;
    let (cuts, vertices, warnings) = kept::placed((manifold, object, mesh), || {
        let placed = cut_and_placed(manifold, object, mesh)?;
        found = Some(placed.mesh);
        Some((placed.cuts, placed.vertices, placed.warnings))
    })?;
    let cut = match found {
        Some(mesh) => mesh,
        None => cut_mesh(object, mesh, &cuts)?.0,
    };
    if vertices.len() != cut.positions.len() {
        return cut_and_placed(manifold, object, mesh);
    }
    Some(Placed {
        mesh: cut,
        vertices,
        warnings,
        cuts,
    })
}

/// Places by geodesics, and finds how the mesh has to be cut for that.
fn cut_and_placed<'m>(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &'m Mesh,
) -> Option<Placed<'m>> {
    let name = object.mesh.display();
    let mut warnings = Vec::new();
    let (mut mesh, mut radius) = (Cow::Borrowed(mesh), radius(object, mesh));
    let (most, mut triangles) = (reach(manifold, object.at, radius), MOST_TRIANGLES);
    let mut within = f64::INFINITY;
    // What is far beyond the space cannot be placed.
    if radius > most {
        within = most;
        triangles = MOST_OF_CLIPPED;
        mesh = Cow::Owned(clipped(&mesh, most / object.scale));
        let left = match mesh.triangles.is_empty() {
            true => "all of it",
            false => "what is beyond",
        };
        warnings.push(format!(
            "{name}: reaches {} from its middle, far beyond the space; clipped at {}, {left} is left out",
            short(radius),
            short(most),
        ));
        radius = self::radius(object, &mesh);
    }
    // What is left, edges halved until they follow geodesics.
    let map = ExponentialMap::new(manifold, object, &mesh.positions);
    let points = |x: &[DVec3], n: &[DVec3]| map.place(x, n);
    let Subdivided {
        mesh,
        vertices,
        rounds,
        left,
    } = subdivided(manifold, mesh, (radius, triangles), points)?;
    if left > 0 {
        let note = "edges are still bent after the last subdivision allowed";
        warnings.push(format!("{name}: {left} {note}"));
    }
    Some(Placed {
        mesh,
        vertices,
        warnings,
        cuts: Cuts { within, rounds },
    })
}

impl<'m> Placed<'m> {
    /// A mesh as it is, with its vertices.
    fn uncut(mesh: &'m Mesh, vertices: Points) -> Self {
        Self {
            mesh: Cow::Borrowed(mesh),
            vertices,
            warnings: Vec::new(),
            cuts: Cuts {
                within: f64::INFINITY,
                rounds: Vec::new(),
            },
        }
    }
}

/// Places by geodesics a mesh that is cut as is known; `None` if those are not cuts of this mesh.
fn placed_as_cut<'m>(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &'m Mesh,
    cuts: &Cuts,
) -> Option<Placed<'m>> {
    let (mesh, uncut) = cut_mesh(object, mesh, cuts)?;
    let told = object.vertices.as_ref();
    let vertices = match told.filter(|all| all.len() == mesh.positions.len()) {
        Some(all) => all.to_vec(),
        None => {
            // The same polynomials as when the cuts were sought.
            let map = ExponentialMap::new(manifold, object, &mesh.positions[..uncut]);
            map.place(&mesh.positions, &mesh.normals)?
        }
    };
    Some(Placed {
        mesh,
        vertices,
        warnings: Vec::new(),
        cuts: cuts.clone(),
    })
}

/// Cuts the mesh of an object as is known; also returns the number of vertices before. `None` if those are not cuts of this
/// mesh.
fn cut_mesh<'m>(
    object: &ObjectEntry,
    mesh: &'m Mesh,
    cuts: &Cuts,
) -> Option<(Cow<'m, Mesh>, usize)> {
    let whole = match cuts.within.is_finite() {
        true => Cow::Owned(clipped(mesh, cuts.within / object.scale)),
        false => Cow::Borrowed(mesh),
    };
    let uncut = whole.positions.len();
    Some((cut_again(whole, &cuts.rounds)?, uncut))
}

/// Places by `u0 + S R x`, `(S R)⁻ᵀ n` for a `frame` S.
fn linear(frame: DMat3, object: &ObjectEntry, mesh: &Mesh) -> Points {
    let (x, n) = (&mesh.positions, &mesh.normals);
    let axes = frame * DMat3::from_quat(object.rotation);
    let covector = axes.inverse().transpose();
    let place = |(x, n): (&DVec3, &DVec3)| (object.at + axes * *x * object.scale, covector * *n);
    x.iter().zip(n).map(place).collect()
}

/// Returns how far the vertices of a mesh are from its middle, at most, once it is scaled.
fn radius(object: &ObjectEntry, mesh: &Mesh) -> f64 {
    let reach = mesh.positions.iter().map(|x| x.length());
    object.scale * reach.fold(0.0, f64::max)
}

/// Rounds a length to four digits, for people.
fn short(length: f64) -> f64 {
    format!("{length:.3e}").parse().unwrap_or(length)
}

/// The angle (radians) by which the chart's straight line from `a` to `b` turns against parallel
/// transport along it: `∫ |(D_w w)⊥| / |w| dt` with `D_w w = Γ(w, w)`, by the midpoint rule.
pub(super) fn bend(manifold: &Manifold, a: DVec3, b: DVec3, pieces: usize) -> f64 {
    let w = b - a;
    let flow = manifold.flow(Carried::default());
    let rate = |t: f64| {
        let u = a + w * t;
        let o = flow.at(&[u.x, u.y, u.z, w.x, w.y, w.z]);
        // The geodesic equation's acceleration is −Γ(w, w); in the standard frame lengths are plain.
        let into = manifold.standard_frame(u).inverse();
        let (turn, along) = (into * DVec3::from_slice(&o[..3]), into * w);
        turn.reject_from(along).length() / along.length()
    };
    let at = |k: usize| rate((k as f64 + 0.5) / pieces as f64);
    (0..pieces).map(at).sum::<f64>() / pieces as f64
}

/// A line of 100 pixels that bends by this angle leaves its geodesic by 100 · 2°/8 = 0.4 pixels: a
/// smaller bend is not seen, one a few times larger is.
const NOTICED: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// Edges and lines looked at, evenly chosen: enough to find the worst part of any honest mesh in
/// milliseconds.
const LOOKED_AT: usize = 4096;

/// Warns of the angle by which linear placement bends straight parts of the mesh: the edges, and the lines from the
/// mesh's origin to its vertices.
fn bend_warning(
    manifold: &Manifold,
    object: &ObjectEntry,
    mesh: &Mesh,
    vertices: &Points,
) -> Option<String> {
    let worst = |angles: &(dyn Fn(usize) -> f64 + Sync), count: usize| {
        let stride = count.div_ceil(LOOKED_AT).max(1);
        let chosen = (0..count.div_ceil(stride)).into_par_iter();
        let all: Vec<f64> = chosen.map(|i| angles(i * stride)).collect();
        all.into_iter()
            .filter(|x| x.is_finite())
            .fold(0.0, f64::max)
    };
    let edge = |i: usize| {
        let corners = mesh.triangles[i].map(|c| vertices[c as usize].0);
        let sides = [(0, 1), (1, 2), (2, 0)];
        let bends = sides.map(|(j, k)| bend(manifold, corners[j], corners[k], 1));
        bends.into_iter().fold(0.0, f64::max)
    };
    let spoke = |i: usize| bend(manifold, object.at, vertices[i].0, 8);
    let edges: f64 = worst(&edge, mesh.triangles.len());
    let spokes: f64 = worst(&spoke, vertices.len());
    (edges.max(spokes) > NOTICED).then(|| {
        format!(
            "{}: linear placement bends edges by up to {:.1}° and straight lines from its middle by up to {:.1}° (more than {:.0}° is seen); `placement = \"exponential\"` keeps those lines straight",
            object.mesh.display(),
            edges.to_degrees(),
            spokes.to_degrees().min(360.0),
            NOTICED.to_degrees(),
        )
    })
}

/// Geodesics that are followed: neighbours are 0.2 rad apart.
const REACH_DIRECTIONS: usize = 256;

/// Between them the space may go on by so much: a corner of a box at 0.1 rad from a geodesic is a tenth
/// farther away than where that leaves the box.
const BETWEEN_DIRECTIONS: f64 = 1.25;

/// A camera sees from as far away as paths are long, and as far on the other side.
const BOTH_SIDES: f64 = 2.0;

/// Steps after which a geodesic has gone far enough: those of pictures take some hundred. To go as far with
/// every vertex of a mesh must not take for ever.
const MOST_REACH_STEPS: usize = 4096;

/// Tolerance of the geodesics: their lengths need few digits.
const REACH_TOLERANCE: f64 = 1e-6;

/// Finds how far light gets from `at`, at most `most`.
pub(super) fn reach(manifold: &Manifold, at: DVec3, most: f64) -> f64 {
    let length = manifold.length.map_or(most, |length| length.min(most));
    let events = manifold.domain.events();
    let events = events.at(&[at.x, at.y, at.z, 0.0, 0.0, 0.0]);
    let settings = Settings {
        // The point may be beyond an exit, and a part of what is around it not.
        events: events.iter().all(|event| *event <= 0.0),
        ..Settings::bare(REACH_TOLERANCE)
    };
    let directions = (0..REACH_DIRECTIONS).map(|i| fibonacci_direction(i, REACH_DIRECTIONS));
    let rays = directions.map(|d| Ray::new(manifold, at, d, length));
    let mut sink = ReachSink {
        steps: vec![0; REACH_DIRECTIONS],
        farthest: 0.0,
    };
    follow(manifold, settings, rays, &mut sink);
    (BETWEEN_DIRECTIONS * sink.farthest).min(most)
}

/// Keeps how far the farthest ray has come.
struct ReachSink {
    /// Steps of each ray.
    steps: Vec<usize>,
    farthest: f64,
}

impl Sink for ReachSink {
    fn step(&mut self, ray: usize, _: &Step) {
        self.steps[ray] += 1;
    }

    fn wants_more(&self, ray: usize) -> bool {
        self.steps[ray] < MOST_REACH_STEPS
    }

    fn end(&mut self, _: usize, end: End, s: f64, _: usize) {
        let s = match end {
            End::Length => BOTH_SIDES * s,
            End::Exit(_) | End::Singular => s,
        };
        self.farthest = self.farthest.max(s);
    }
}

/// How a mesh was cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Cuts {
    /// Distance in the metric beyond which it was clipped; infinite where it was not.
    pub within: f64,
    /// The edges that were split in each round, by the numbers of their vertices; each middle became a new vertex.
    pub rounds: Vec<Vec<[u32; 2]>>,
}

/// Writes the cuts of objects.
pub fn pack_cuts(all: &[Option<Cuts>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for cuts in all {
        bytes.push(cuts.is_some().into());
        let Some(cuts) = cuts else { continue };
        bytes.extend(cuts.within.to_le_bytes());
        bytes.extend((cuts.rounds.len() as u32).to_le_bytes());
        for edges in &cuts.rounds {
            bytes.extend((edges.len() as u32).to_le_bytes());
            for k in 0..2 {
                let column: Vec<i64> = edges.iter().map(|edge| edge[k].into()).collect();
                numbers::put_whole(&mut bytes, &column);
            }
        }
    }
    bytes
}

/// Reads what [`pack_cuts`] wrote for so many objects; `None` if it is something else.
pub fn read_cuts(mut bytes: &[u8], objects: usize) -> Option<Vec<Option<Cuts>>> {
    let all = (0..objects)
        .map(|_| match bytes.split_off_first()? {
            0 => Some(None),
            1 => Some(Some(take_cuts(&mut bytes)?)),
            _ => None,
        })
        .collect::<Option<Vec<_>>>()?;
    bytes.is_empty().then_some(all)
}

fn take_cuts(bytes: &mut &[u8]) -> Option<Cuts> {
    let within = f64::from_le_bytes(take_chunk(bytes)?);
    let rounds = take_count(bytes)?;
    let edges = |bytes: &mut &[u8]| {
        let count = take_count(bytes)?;
        let [a, b] = [
            numbers::take_whole(bytes, count)?,
            numbers::take_whole(bytes, count)?,
        ];
        let edge = |(a, b): (i64, i64)| Some([u32::try_from(a).ok()?, u32::try_from(b).ok()?]);
        a.into_iter().zip(b).map(edge).collect::<Option<Vec<_>>>()
    };
    Some(Cuts {
        within,
        rounds: (0..rounds)
            .map(|_| edges(bytes))
            .collect::<Option<Vec<_>>>()?,
    })
}

fn take_count(bytes: &mut &[u8]) -> Option<usize> {
    Some(u32::from_le_bytes(take_chunk(bytes)?) as usize)
}

/// Steps along the extent of an object, and of its covectors: a step of these turns a normal by less than a shade.
const STEPS: f64 = (1_u32 << 24) as f64;
const COVECTOR_STEPS: f64 = (1_u32 << 17) as f64;

/// Writes the vertices of objects.
pub fn pack_points(all: &[Option<Points>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for points in all {
        let finite = |points: &&Points| points.iter().all(|(u, n)| u.is_finite() && n.is_finite());
        let points: &[_] = points.as_ref().filter(finite).map_or(&[], |points| points);
        bytes.extend((points.len() as u32).to_le_bytes());
        if !points.is_empty() {
            let (places, covectors): (Vec<_>, Vec<_>) = points.iter().copied().unzip();
            put_vectors(&mut bytes, &places, STEPS);
            put_vectors(&mut bytes, &covectors, COVECTOR_STEPS);
        }
    }
    bytes
}

/// Reads what [`pack_points`] wrote for so many objects; `None` if it is something else.
pub fn read_points(mut bytes: &[u8], objects: usize) -> Option<Vec<Option<Points>>> {
    let bytes = &mut bytes;
    let object = |_| {
        let count = take_count(bytes)?;
        if count == 0 {
            return Some(None);
        }
        let (points, covectors) = (take_vectors(bytes, count)?, take_vectors(bytes, count)?);
        Some(Some(points.into_iter().zip(covectors).collect()))
    };
    let all = (0..objects).map(object).collect::<Option<_>>()?;
    bytes.is_empty().then_some(all)
}

fn put_vectors(bytes: &mut Vec<u8>, vectors: &[DVec3], steps: f64) {
    let low = vectors
        .iter()
        .copied()
        .reduce(DVec3::min)
        .unwrap_or_default();
    let high = vectors
        .iter()
        .copied()
        .reduce(DVec3::max)
        .unwrap_or_default();
    let step = (high - low).max_element() / steps;
    let step = if step > 0.0 { step } else { 1.0 };
    bytes.extend(
        low.to_array()
            .into_iter()
            .chain([step])
            .flat_map(f64::to_le_bytes),
    );
    for k in 0..3 {
        let whole = vectors
            .iter()
            .map(|v| ((v[k] - low[k]) / step).round() as i64);
        numbers::put_whole(bytes, &whole.collect::<Vec<_>>());
    }
}

fn take_vectors(bytes: &mut &[u8], count: usize) -> Option<Vec<DVec3>> {
    let mut number = || Some(f64::from_le_bytes(take_chunk(bytes)?));
    let low = DVec3::new(number()?, number()?, number()?);
    let step = number()?;
    let mut column = || numbers::take_whole(bytes, count);
    let [x, y, z] = [column()?, column()?, column()?];
    let at = |i: usize| low + step * DVec3::new(x[i] as f64, y[i] as f64, z[i] as f64);
    Some((0..count).map(at).collect())
}

#[cfg(all(test, feature = "formats"))]
#[path = "placement_tests.rs"]
pub(super) mod tests;
