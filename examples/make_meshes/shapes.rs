//! Torus knot, pawn, globe and letter F, each as a checked mesh.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, dvec2, dvec3};

use crate::mesh::{Material, Mesh, Vertex};

fn gloss(name: &'static str, diffuse: [f64; 3]) -> Material {
    Material {
        name,
        diffuse,
        specular: 0.4,
        shininess: 60.0,
    }
}

fn matt(name: &'static str, diffuse: [f64; 3]) -> Material {
    Material {
        name,
        diffuse,
        specular: 0.0,
        shininess: 1.0,
    }
}

/// A tube along the (2, 3) knot on a torus, in six bands of colour.
pub fn torus_knot() -> Mesh {
    const ALONG: usize = 300;
    const AROUND: usize = 20;
    const SCALE: f64 = 0.28; // radius of the torus' tube; its circle has twice that
    const TUBE: f64 = 0.13;
    let bands = [
        gloss("red", [0.80, 0.10, 0.08]),
        gloss("orange", [0.90, 0.45, 0.05]),
        gloss("yellow", [0.88, 0.80, 0.12]),
        gloss("green", [0.12, 0.55, 0.18]),
        gloss("blue", [0.08, 0.25, 0.75]),
        gloss("violet", [0.45, 0.12, 0.60]),
    ];
    let count = bands.len();
    let mut mesh = Mesh::new("torus-knot", bands.into());
    let vertex = |i: usize, j: usize| {
        let (t, turn) = (fraction(j, ALONG) * TAU, fraction(i, AROUND) * TAU);
        let (centre, tangent, away) = knot_frame(t);
        let side = tangent.cross(away);
        let normal = away * turn.cos() + side * turn.sin();
        let uv = dvec2(i as f64 / AROUND as f64, j as f64 / ALONG as f64);
        Vertex {
            position: centre * SCALE + normal * TUBE,
            normal,
            uv,
        }
    };
    mesh.sheet([AROUND, ALONG], vertex, |_, j| j * count / ALONG);
    mesh
}

/// i/n with the last one equal to the first, so that a seam closes to the last bit.
fn fraction(i: usize, n: usize) -> f64 {
    (i % n) as f64 / n as f64
}

/// Point, unit tangent and unit normal away from the torus' core circle.
fn knot_frame(t: f64) -> (DVec3, DVec3, DVec3) {
    let (s2, c2) = (2.0 * t).sin_cos();
    let (s3, c3) = (3.0 * t).sin_cos();
    let outward = dvec3(c2, s2, 0.0);
    let centre = outward * (2.0 + c3) + DVec3::Z * s3;
    let velocity =
        outward * (-3.0 * s3) + dvec3(-s2, c2, 0.0) * (2.0 * (2.0 + c3)) + DVec3::Z * (3.0 * c3);
    let tangent = velocity.normalize();
    let away = (outward * c3 + DVec3::Z * s3)
        .reject_from(tangent)
        .normalize();
    (centre, tangent, away)
}

/// One piece of a lathe profile, walked from the bottom to the top; coordinates are (r, z).
enum Piece {
    Curve([DVec2; 4]),
    Line([DVec2; 2]),
    /// Circle round (0, z): height of its centre, radius, first and last angle above the horizon.
    Arc(f64, f64, [f64; 2]),
}

impl Piece {
    /// Point and direction at t in [0, 1].
    fn at(&self, t: f64) -> (DVec2, DVec2) {
        match *self {
            Piece::Line([a, b]) => (a.lerp(b, t), b - a),
            Piece::Curve([a, b, c, d]) => {
                let (ab, bc, cd) = (a.lerp(b, t), b.lerp(c, t), c.lerp(d, t));
                let (left, right) = (ab.lerp(bc, t), bc.lerp(cd, t));
                (left.lerp(right, t), right - left)
            }
            Piece::Arc(z, radius, [from, to]) => {
                let (s, c) = (from + (to - from) * t).sin_cos();
                let r = if t == 1.0 { 0.0 } else { c * radius };
                (dvec2(r, z + s * radius), dvec2(-s, c) * (to - from))
            }
        }
    }
}

/// A turned chess pawn: felt, base, stem, collar and head.
pub fn pawn() -> Mesh {
    const AROUND: usize = 64;
    let materials = vec![
        matt("felt", [0.05, 0.22, 0.10]),
        gloss("boxwood", [0.75, 0.55, 0.30]),
    ];
    let mut mesh = Mesh::new("pawn", materials);
    for (material, steps, piece) in pawn_profile() {
        let vertex = |i: usize, j: usize| {
            let (p, along) = piece.at(j as f64 / steps as f64);
            let (s, c) = (fraction(i, AROUND) * TAU).sin_cos();
            let position = dvec3(p.x * c, p.x * s, p.y);
            let normal = dvec3(along.y * c, along.y * s, -along.x);
            Vertex {
                position,
                normal,
                uv: dvec2(i as f64 / AROUND as f64, (p.y + 1.0) / 2.0),
            }
        };
        mesh.sheet([AROUND, steps], vertex, |_, _| material);
    }
    mesh
}

/// Material, steps and shape of each piece; each starts where the last one ended.
fn pawn_profile() -> Vec<(usize, usize, Piece)> {
    let line = |a: [f64; 2], b: [f64; 2]| Piece::Line([a.into(), b.into()]);
    let curve = |a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]| {
        Piece::Curve([a.into(), b.into(), c.into(), d.into()])
    };
    let (head_z, head_radius) = (0.63_f64, 0.33_f64);
    let neck = [
        0.19,
        head_z - (head_radius.powi(2) - 0.19_f64.powi(2)).sqrt(),
    ];
    let from = ((neck[1] - head_z) / head_radius).asin();
    vec![
        (0, 4, line([0.0, -0.98], [0.52, -0.98])),
        (0, 1, line([0.52, -0.98], [0.52, -0.95])),
        (1, 1, line([0.52, -0.95], [0.58, -0.95])),
        (
            1,
            12,
            curve([0.58, -0.95], [0.67, -0.95], [0.67, -0.77], [0.56, -0.75]),
        ),
        (1, 2, line([0.56, -0.75], [0.50, -0.73])),
        (
            1,
            8,
            curve([0.50, -0.73], [0.49, -0.60], [0.38, -0.59], [0.33, -0.54]),
        ),
        (
            1,
            12,
            curve([0.33, -0.54], [0.22, -0.35], [0.17, -0.10], [0.16, 0.22]),
        ),
        (
            1,
            5,
            curve([0.16, 0.22], [0.26, 0.22], [0.36, 0.25], [0.36, 0.29]),
        ),
        (1, 5, curve([0.36, 0.29], [0.36, 0.33], [0.28, 0.35], neck)),
        (1, 16, Piece::Arc(head_z, head_radius, [from, PI / 2.0])),
    ]
}

/// A divided icosahedron with sea, lands, a polar cap and one red spot: no two sides look alike.
pub fn globe() -> Mesh {
    const DIVISIONS: usize = 4;
    let materials = vec![
        gloss("sea", [0.05, 0.20, 0.50]),
        matt("land", [0.25, 0.45, 0.12]),
        matt("desert", [0.75, 0.60, 0.30]),
        matt("ice", [0.92, 0.94, 0.96]),
        gloss("spot", [0.80, 0.08, 0.06]),
    ];
    let mut mesh = Mesh::new("globe", materials);
    mesh.has_uv = false;
    let (points, faces) = (0..DIVISIONS).fold(icosahedron(), |s, _| divided(s));
    for &p in &points {
        mesh.vertex(p, p, DVec2::ZERO);
    }
    for face in faces {
        let centre = (points[face[0]] + points[face[1]] + points[face[2]]).normalize();
        mesh.triangle(region(centre), face);
    }
    mesh
}

/// Material of the globe in a direction: the last region that contains it.
fn region(p: DVec3) -> usize {
    // longitude, latitude and angular radius in degrees, material
    let regions = [
        ([20.0, 10.0, 38.0], 1),
        ([55.0, 35.0, 30.0], 1),
        ([30.0, 18.0, 16.0], 2),
        ([-80.0, 40.0, 24.0], 1),
        ([-65.0, -15.0, 20.0], 1),
        ([150.0, -30.0, 18.0], 2),
        ([0.0, 90.0, 20.0], 3),
        ([-150.0, 12.0, 12.0], 4),
    ];
    let inside = |[longitude, latitude, radius]: [f64; 3]| {
        let (s, c) = f64::to_radians(longitude).sin_cos();
        let (sz, cz) = f64::to_radians(latitude).sin_cos();
        p.dot(dvec3(c * cz, s * cz, sz)) > f64::to_radians(radius).cos()
    };
    regions
        .iter()
        .rev()
        .find(|(disc, _)| inside(*disc))
        .map_or(0, |r| r.1)
}

type Solid = (Vec<DVec3>, Vec<[usize; 3]>);

fn icosahedron() -> Solid {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut points = Vec::new();
    for (a, b) in [
        (1.0, golden),
        (1.0, -golden),
        (-1.0, golden),
        (-1.0, -golden),
    ] {
        points.extend([dvec3(0.0, a, b), dvec3(a, b, 0.0), dvec3(b, 0.0, a)].map(DVec3::normalize));
    }
    let near = |a: usize, b: usize| points[a].dot(points[b]) > 0.4;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in (b + 1..12).filter(|&c| near(a, b) && near(b, c) && near(c, a)) {
                let outward = points[a].dot(points[b].cross(points[c])) > 0.0;
                faces.push(if outward { [a, b, c] } else { [a, c, b] });
            }
        }
    }
    (points, faces)
}

/// Each triangle into four, with new points on the sphere.
fn divided((mut points, faces): Solid) -> Solid {
    let mut middles = HashMap::new();
    let mut middle = |a: usize, b: usize| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            points.push((points[a] + points[b]).normalize());
            points.len() - 1
        })
    };
    let mut finer = Vec::with_capacity(4 * faces.len());
    for [a, b, c] in faces {
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    (points, finer)
}

/// An extruded F that reads correctly from the -y side: a picture that mirrors it shows at once.
pub fn letter_f() -> Mesh {
    let materials = vec![
        gloss("front", [0.85, 0.15, 0.10]),
        gloss("back", [0.10, 0.25, 0.75]),
        matt("sides", [0.80, 0.80, 0.78]),
    ];
    let mut mesh = Mesh::new("letter-F", materials);
    for column in 0..3 {
        for row in 0..4 {
            if filled(column, row) {
                letter_cell(&mut mesh, column, row);
            }
        }
    }
    mesh
}

const COLUMNS: [f64; 4] = [-0.50, -0.20, 0.15, 0.50];
const ROWS: [f64; 5] = [-0.85, -0.05, 0.20, 0.55, 0.85];
const HALF_DEPTH: f64 = 0.15;

/// The cells of the F: its stem, its upper and its shorter middle bar.
fn filled(column: i32, row: i32) -> bool {
    matches!((column, row), (0, 0..=3) | (1..=2, 3) | (1, 1))
}

/// Front and back of one cell, and its sides towards empty neighbours.
fn letter_cell(mesh: &mut Mesh, column: i32, row: i32) {
    let (x0, x1) = (COLUMNS[column as usize], COLUMNS[column as usize + 1]);
    let (z0, z1) = (ROWS[row as usize], ROWS[row as usize + 1]);
    let centre = dvec3((x0 + x1) / 2.0, 0.0, (z0 + z1) / 2.0);
    let half = dvec3((x1 - x0) / 2.0, HALF_DEPTH, (z1 - z0) / 2.0);
    let mut face = |material: usize, normal: DVec3, up: DVec3| {
        let right = up.cross(normal);
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
            let p = centre + (normal + right * a + up * b) * half;
            mesh.vertex(p, normal, dvec2(p.dot(right) + 0.5, p.dot(up) + 0.5))
        });
        mesh.quad(material, corners);
    };
    face(0, DVec3::NEG_Y, DVec3::Z);
    face(1, DVec3::Y, DVec3::Z);
    for (dx, dz) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
        if !filled(column + dx, row + dz) {
            face(2, dvec3(f64::from(dx), 0.0, f64::from(dz)), DVec3::Y);
        }
    }
}
