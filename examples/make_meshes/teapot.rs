//! Martin Newell's teapot (University of Utah, 1975): 32 bicubic Bézier patches.
//!
//! Body, lid and bottom are turned: one quarter's control points follow from a profile, and the
//! other quarters by rotation. Handle and spout are given by half and mirrored in y.
//! The surface is not closed: there is a gap around the lid, the spout is open at its tip, and the
//! roots of handle and spout end inside the body.

use glam::{DVec3, dvec2, dvec3};

use crate::mesh::{Material, Mesh, Vertex};

/// Steps along each patch edge.
const STEPS: usize = 16;

/// Control point of a turned quarter: radius, its tangential offset (0.56 of it), height.
type Turned = [f64; 3];
type Patch = [[DVec3; 4]; 4];

/// Rim (from inside over the top), body (down) and bottom (to the axis).
const BODY: [[Turned; 4]; 4] = [
    [
        [1.4, 0.784, 2.4],
        [1.3375, 0.749, 2.53125],
        [1.4375, 0.805, 2.53125],
        [1.5, 0.84, 2.4],
    ],
    [
        [1.5, 0.84, 2.4],
        [1.75, 0.98, 1.875],
        [2.0, 1.12, 1.35],
        [2.0, 1.12, 0.9],
    ],
    [
        [2.0, 1.12, 0.9],
        [2.0, 1.12, 0.45],
        [1.5, 0.84, 0.225],
        [1.5, 0.84, 0.15],
    ],
    [
        [1.5, 0.84, 0.15],
        [1.5, 0.84, 0.075],
        [1.425, 0.798, 0.0],
        [0.0, 0.0, 0.0],
    ],
];

/// Knob and lid, from the axis outwards.
const LID: [[Turned; 4]; 2] = [
    [
        [0.0, 0.0, 3.15],
        [0.8, 0.45, 3.15],
        [0.0, 0.0, 2.85],
        [0.2, 0.112, 2.7],
    ],
    [
        [0.2, 0.112, 2.7],
        [0.4, 0.224, 2.55],
        [1.3, 0.728, 2.55],
        [1.3, 0.728, 2.4],
    ],
];

/// Control row across half a tube: first and last point in the plane y = 0 as (x, z), half width.
type Across = ([f64; 2], [f64; 2], f64);

/// From the upper root on the body, round, to the lower one; inner edge first.
const HANDLE: [[Across; 4]; 2] = [
    [
        ([-1.6, 2.025], [-1.5, 2.25], 0.3),
        ([-2.3, 2.025], [-2.5, 2.25], 0.3),
        ([-2.7, 2.025], [-3.0, 2.25], 0.3),
        ([-2.7, 1.8], [-3.0, 1.8], 0.3),
    ],
    [
        ([-2.7, 1.8], [-3.0, 1.8], 0.3),
        ([-2.7, 1.575], [-3.0, 1.35], 0.3),
        ([-2.5, 1.125], [-2.65, 0.9375], 0.3),
        ([-2.0, 0.9], [-1.9, 0.6], 0.3),
    ],
];

/// From the root on the body to the tip, which turns inwards; upper edge first.
const SPOUT: [[Across; 4]; 2] = [
    [
        ([1.7, 1.425], [1.7, 0.6], 0.66),
        ([2.6, 1.425], [3.1, 0.825], 0.66),
        ([2.3, 2.1], [2.4, 2.025], 0.25),
        ([2.7, 2.4], [3.3, 2.4], 0.25),
    ],
    [
        ([2.7, 2.4], [3.3, 2.4], 0.25),
        ([2.8, 2.475], [3.525, 2.49375], 0.25),
        ([2.9, 2.475], [3.45, 2.5125], 0.15),
        ([2.8, 2.4], [3.2, 2.4], 0.15),
    ],
];

/// The teapot with spout towards +x, about unit radius.
pub fn teapot() -> Mesh {
    let glaze = |name, diffuse| Material {
        name,
        diffuse,
        specular: 0.5,
        shininess: 90.0,
    };
    let materials = vec![
        glaze("body", [0.72, 0.70, 0.62]),
        glaze("lid", [0.15, 0.35, 0.60]),
        glaze("handle", [0.15, 0.35, 0.60]),
        glaze("spout", [0.72, 0.45, 0.15]),
    ];
    let mut mesh = Mesh::new("teapot", materials);
    mesh.closed = false;
    for quarter in 0..4 {
        BODY.iter()
            .for_each(|p| add_patch(&mut mesh, 0, &turned(p, quarter)));
        LID.iter()
            .for_each(|p| add_patch(&mut mesh, 1, &turned(p, quarter)));
    }
    for side in [-1.0, 1.0] {
        HANDLE
            .iter()
            .for_each(|p| add_patch(&mut mesh, 2, &tube(p, side)));
        SPOUT
            .iter()
            .for_each(|p| add_patch(&mut mesh, 3, &tube(p, side)));
    }
    mesh
}

/// Control points of one quarter; rows follow the profile, columns go clockwise from above.
fn turned(profile: &[Turned; 4], quarter: usize) -> Patch {
    let rotate = |p: DVec3| (0..quarter).fold(p, |p, _| dvec3(p.y, -p.x, p.z));
    profile.map(|[r, k, z]| {
        [
            dvec3(r, 0.0, z),
            dvec3(r, -k, z),
            dvec3(k, -r, z),
            dvec3(0.0, -r, z),
        ]
        .map(rotate)
    })
}

/// Control points of one half tube, on the side of y where `side` is; columns are turned round on
/// the one side so that both face outwards.
fn tube(rows: &[Across; 4], side: f64) -> Patch {
    rows.map(|([x0, z0], [x1, z1], width)| {
        let y = width * side;
        let row = [
            dvec3(x0, 0.0, z0),
            dvec3(x0, y, z0),
            dvec3(x1, y, z1),
            dvec3(x1, 0.0, z1),
        ];
        if side < 0.0 {
            row
        } else {
            [row[3], row[2], row[1], row[0]]
        }
    })
}

fn add_patch(mesh: &mut Mesh, material: usize, patch: &Patch) {
    let vertex = |i: usize, j: usize| {
        let (u, v) = (i as f64 / STEPS as f64, j as f64 / STEPS as f64);
        let inner = |t: f64| t.clamp(1e-4, 1.0 - 1e-4); // a pole has no tangent plane of its own
        let (_, along_u, along_v) = patch_at(patch, inner(u), inner(v));
        let position = (patch_at(patch, u, v).0 - dvec3(0.2, 0.0, 1.575)) / 3.25;
        Vertex {
            position,
            normal: along_u.cross(along_v),
            uv: dvec2(u, v),
        }
    };
    mesh.sheet([STEPS, STEPS], vertex, |_, _| material);
}

/// Point and both derivatives; u along the columns, v along the rows.
fn patch_at(patch: &Patch, u: f64, v: f64) -> (DVec3, DVec3, DVec3) {
    let across = patch.map(|row| cubic(row, u));
    let (point, along_v) = cubic(across.map(|c| c.0), v);
    let (along_u, _) = cubic(across.map(|c| c.1), v);
    (point, along_u, along_v)
}

/// Point and derivative of a cubic Bézier curve.
fn cubic([a, b, c, d]: [DVec3; 4], t: f64) -> (DVec3, DVec3) {
    let (ab, bc, cd) = (a.lerp(b, t), b.lerp(c, t), c.lerp(d, t));
    let (left, right) = (ab.lerp(bc, t), bc.lerp(cd, t));
    (left.lerp(right, t), 3.0 * (right - left))
}
