//! What geodesics conserve: for every symmetry of a manifold of the catalogue, claimed or not, the
//! momentum along its Killing field; and exits do not matter to paths turned back.

mod support;

use geofan_core::{
    geodesic::{Path, Ray, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::DVec3;
use support::{asset, catalogue, missed, random_point, settings, turned, worse};

/// A field along which the metric does not change.
type Killing = fn(DVec3) -> DVec3;

/// Turns about the three axes.
const ROTATIONS: [Killing; 3] = [
    |u| DVec3::X.cross(u),
    |u| DVec3::Y.cross(u),
    |u| DVec3::Z.cross(u),
];

/// Shifts along the three axes.
const SHIFTS: [Killing; 3] = [|_| DVec3::X, |_| DVec3::Y, |_| DVec3::Z];

/// The Killing fields of a manifold of the catalogue, from its isometries: of a group, the fields of
/// its left translations.
fn killing(name: &str) -> Vec<Killing> {
    let [turn_x, _, turn_z] = ROTATIONS;
    let [along_x, along_y, along_z] = SHIFTS;
    match name {
        "cone"
        | "ellis-wormhole"
        | "flamm-paraboloid"
        | "gaussian-bump"
        | "gaussian-lens"
        | "glass-ball"
        | "interstellar-wormhole"
        | "luneburg"
        | "maxwell-fish-eye"
        | "reissner-nordstrom"
        | "schwarzschild"
        | "s3-graph"
        | "h3-ball"
        | "figure-eight"
        | "seifert-weber"
        | "mirrored-dodecahedron" => ROTATIONS.to_vec(),
        "flat" | "half-turn" | "portal" => [ROTATIONS, SHIFTS].concat(),
        "flat-torus" | "rolled-sheet" => SHIFTS.to_vec(),
        "grin-rod" => vec![turn_z, along_z],
        // Dilations, and inversion's parabolic fields.
        "h3-half-space" => vec![along_x, along_y, turn_z, |u| u, |u| {
            u * (2.0 * u.x) - DVec3::X * u.length_squared()
        }],
        "s2xr" => [&ROTATIONS[..], &[|u| u]].concat(),
        // Rotations of the ambient space in planes with its fourth axis.
        "s3" | "poincare" | "lens-space" => [
            &ROTATIONS[..],
            &[|u| DVec3::X * ((1.0 - u.length_squared()) / 2.0) + u * u.x],
        ]
        .concat(),
        "h2xr" => vec![along_x, along_z, |u| DVec3::new(u.x, 1.0, 0.0)],
        "nil" | "nil-torus" => vec![along_z, turn_z, |u| DVec3::new(1.0, 0.0, u.y / 2.0), |u| {
            DVec3::new(0.0, 1.0, -u.x / 2.0)
        }],
        "sol" | "sol-cat" => vec![along_x, along_y, |u| DVec3::new(-u.x, u.y, 1.0)],
        "sl2r" => vec![along_x, along_z, |u| DVec3::new(u.x, 1.0, 0.0)],
        // Turns of the sphere, in its stereographic chart (y, z).
        "torus-s1xs2" => vec![turn_x, |u| {
            DVec3::new(0.0, (1.0 + u.y * u.y - u.z * u.z) / 2.0, u.y * u.z)
        }],
        "three-bumps" | "road-mirage" => Vec::new(),
        "schwarzschild-polar" | "schwarzschild-rain" | "schwarzschild-river" => ROTATIONS.to_vec(),
        "kerr" | "kerr-ingoing" => vec![turn_z],
        "spinning-string" => vec![turn_z, along_z],
        "alcubierre" => vec![turn_x],
        "goedel" => vec![along_y, along_z, |u| DVec3::new(1.0, -u.y, 0.0)],
        other => panic!("no Killing fields for {other}: add them"),
    }
}

/// Random rays of `manifold` as far as an exit, whatever the file's length.
fn random_paths(manifold: &Manifold, seed: u64) -> Vec<(Ray, Path)> {
    let mut stream = Stream::new(&[31, seed]);
    let length = manifold.length.unwrap_or(6.0).min(15.0);
    let mut ray = || {
        let u = random_point(manifold, &mut stream);
        Ray::new(manifold, u, stream.direction(), length)
    };
    let rays: Vec<Ray> = (0..20).map(|_| ray()).collect();
    let found = paths(manifold, settings(1e-12, true), rays.iter().copied());
    rays.into_iter().zip(found).collect()
}

#[test]
fn momenta_along_killing_fields_are_conserved() {
    let mut report = String::new();
    let mut worst_of_all = 0.0;
    for (i, name) in catalogue().iter().enumerate() {
        let manifold = asset(name).cover().into_owned();
        let mut worst = 0.0;
        for (ray, path) in random_paths(&manifold, i as u64) {
            for field in killing(name) {
                // Of light with energy 1 where there is a wind or a drift.
                let momentum = |u: DVec3, v: DVec3| {
                    let n = manifold.sight(u, v);
                    let along = n.dot(manifold.metric(u) * field(u));
                    along / manifold.share(u, n) + manifold.drift(u).dot(field(u))
                };
                let start = momentum(ray.u, ray.v);
                for step in &path.steps {
                    let (u, v) = (step.position(step.end), step.tangent(step.end));
                    let size = field(u).dot(manifold.metric(u) * field(u)).sqrt().max(1.0);
                    worst = worse(worst, (momentum(u, v) - start).abs() / size);
                }
            }
        }
        report += &format!("{name:22} {worst:.1e}\n");
        worst_of_all = worse(worst_of_all, worst);
    }
    println!("{report}");
    assert!(worst_of_all < 1e-9, "\n{report}");
}

#[test]
fn random_rays_turned_back_return_to_their_start() {
    let mut report = String::new();
    let mut worst_of_all = 0.0;
    for (i, name) in catalogue().iter().enumerate() {
        let manifold = asset(name).cover().into_owned();
        let (there, forth): (Vec<Ray>, Vec<Path>) =
            random_paths(&manifold, 100 + i as u64).into_iter().unzip();
        // What was followed into the past goes back into the future.
        let forward = manifold.forward().unwrap();
        let back = paths(&forward, settings(1e-12, false), turned(&forth));
        let worst = missed(&manifold, &back, &there);
        report += &format!("{name:22} {worst:.1e}\n");
        worst_of_all = worse(worst_of_all, worst);
    }
    println!("{report}");
    assert!(worst_of_all < 1e-8, "\n{report}");
}
