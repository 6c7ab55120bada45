//! Images of points in glued spaces against their groups, enumerated here as matrices from textbook generators.
//!
//! The engine gets its deck transformations from the faces of a file; these groups come from quaternions,
//! Lorentz transformations and Euclidean motions alone. Figures beside them were computed elsewhere.

mod support;

use geofan_core::manifold::{DeckTransformation, Gluing, Manifold};
use glam::{DMat3, DMat4, DVec3, DVec4};
use num_complex::Complex64;
use std::{
    collections::{HashMap, VecDeque},
    f64::consts::{FRAC_PI_2, PI, TAU},
};
use support::{asset, manifold};

/// A geometry as vectors (x, y, z, w) on which its isometries are linear.
#[derive(Clone, Copy)]
enum Model {
    /// `w = 1`.
    Flat,
    /// The unit sphere; the chart is stereographic from `w = −1`.
    Sphere,
    /// The hyperboloid; the chart is Poincaré's ball.
    Hyperboloid,
}

impl Model {
    /// The point whose first three components are these.
    fn point(self, x: [f64; 3]) -> DVec4 {
        let x = DVec3::from(x);
        x.extend(match self {
            Self::Flat => 1.0,
            Self::Sphere => (1.0 - x.length_squared()).sqrt(),
            Self::Hyperboloid => (1.0 + x.length_squared()).sqrt(),
        })
    }

    fn chart(self, x: DVec4) -> DVec3 {
        match self {
            Self::Flat => x.truncate(),
            _ => x.truncate() / (1.0 + x.w),
        }
    }

    fn lift(self, u: DVec3) -> DVec4 {
        let r2 = u.length_squared();
        match self {
            Self::Flat => u.extend(1.0),
            Self::Sphere => (2.0 * u).extend(1.0 - r2) / (1.0 + r2),
            Self::Hyperboloid => (2.0 * u).extend(1.0 + r2) / (1.0 - r2),
        }
    }

    fn distance(self, a: DVec4, b: DVec4) -> f64 {
        match self {
            Self::Flat => (a - b).length(),
            Self::Sphere => a.dot(b).clamp(-1.0, 1.0).acos(),
            Self::Hyperboloid => (a.w * b.w - a.truncate().dot(b.truncate()))
                .max(1.0)
                .acosh(),
        }
    }

    /// The light that arrives from a distance, of a unit of light.
    fn light(self, d: f64) -> f64 {
        match self {
            Self::Flat => d.powi(-2),
            Self::Sphere => d.sin().powi(-2),
            Self::Hyperboloid => d.sinh().powi(-2),
        }
    }
}

/// The elements of the group of `generators`, which hold their inverses, that `keep` keeps: all that can be
/// reached through others that are kept.
fn group(generators: &[DMat4], keep: impl Fn(&DMat4) -> bool) -> Vec<DMat4> {
    let key = |m: &DMat4| m.to_cols_array().map(|x| (x * 1e3).round() as i64);
    let mut known = HashMap::from([(key(&DMat4::IDENTITY), DMat4::IDENTITY)]);
    let mut open = VecDeque::from([DMat4::IDENTITY]);
    while let Some(element) = open.pop_front() {
        for generator in generators {
            let next = element * *generator;
            if keep(&next) && known.insert(key(&next), next).is_none() {
                open.push_back(next);
            }
        }
    }
    known.into_values().collect()
}

/// Sorted distances of the images of `p` from `x`, with whether the image is a mirrored one.
fn distances(model: Model, group: &[DMat4], [p, x]: [DVec4; 2]) -> Vec<(f64, bool)> {
    let distance = |g: &DMat4| (model.distance(*g * p, x), g.determinant() < 0.0);
    let mut all: Vec<(f64, bool)> = group.iter().map(distance).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// The same by the engine's deck transformations, of all images within `d`.
fn found(model: Model, gluing: &Gluing, [p, x]: [DVec4; 2], d: f64) -> Vec<(f64, bool)> {
    let home = model.lift(gluing.inside());
    let reach = d + model.distance(home, p) + model.distance(home, x) + 1e-6;
    let near =
        |_: &DeckTransformation, place: DVec3| model.distance(home, model.lift(place)) < reach;
    let p = model.chart(p);
    let distance = |deck: &DeckTransformation| {
        let image = model.lift(deck.point(p));
        (model.distance(image, x), deck.reverses())
    };
    let mut all: Vec<(f64, bool)> = gluing
        .copies(|deck, place| near(deck, place).then_some(0.0), 40_000)
        .iter()
        .map(distance)
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// How many are within `d`, how many of them mirrored, and the light from all.
fn within(model: Model, distances: &[(f64, bool)], d: f64) -> (usize, usize, f64) {
    let near = distances.iter().take_while(|(x, _)| *x < d);
    let mirrored = near.clone().filter(|(_, mirrored)| *mirrored).count();
    let light = near.clone().map(|(x, _)| model.light(*x)).sum();
    (near.count(), mirrored, light)
}

/// The images of `p` about `x` that the engine finds are those of the group, as far as `within`; returns them.
fn compare(
    what: &str,
    (model, space): (Model, &Manifold),
    group: &[DMat4],
    points: [DVec4; 2],
    within: f64,
) -> Vec<(f64, bool)> {
    let known = distances(model, group, points);
    let engine = found(model, space.gluing().unwrap(), points, within);
    let [known, engine] = [known, engine].map(|all| -> Vec<(f64, bool)> {
        all.into_iter().take_while(|(d, _)| *d < within).collect()
    });
    assert_eq!(known.len(), engine.len(), "{what}");
    for (a, b) in known.iter().zip(&engine) {
        assert!((a.0 - b.0).abs() < 1e-7, "{what}: {} {}", a.0, b.0);
    }
    let mirrored = |all: &[(f64, bool)]| all.iter().filter(|(_, mirrored)| *mirrored).count();
    assert_eq!(mirrored(&known), mirrored(&engine), "{what}");
    known
}

/// The unit normals of a dodecahedron's faces.
fn dodecahedron() -> Vec<DVec3> {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut normals = Vec::new();
    for (a, b) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let (a, b) = (a, b * golden);
        normals.extend([[0.0, a, b], [a, b, 0.0], [b, 0.0, a]]);
    }
    normals
        .into_iter()
        .map(|n| DVec3::from(n).normalize())
        .collect()
}

/// The distances from the chart's middle at which the domain ends, along these directions of the chart.
fn radii(model: Model, gluing: &Gluing, directions: &[DVec3]) -> Vec<f64> {
    let leaves = |d: &DVec3| {
        let (mut low, mut high) = (0.0, 0.99);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let inside = gluing.values().at(&(*d * middle).to_array());
            match inside.iter().all(|value| *value > 0.0) {
                true => low = middle,
                false => high = middle,
            }
        }
        model.distance(model.lift(DVec3::ZERO), model.lift(*d * low))
    };
    directions.iter().map(leaves).collect()
}

/// A dodecahedron's corners are above the middles of these directions.
fn corners() -> Vec<DVec3> {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let diagonal = [DVec3::ONE, DVec3::new(1.0, -1.0, 1.0)];
    let other = [
        DVec3::new(0.0, golden, 1.0 / golden),
        DVec3::new(golden, 1.0 / golden, 0.0),
    ];
    [diagonal, other]
        .concat()
        .iter()
        .map(|d| d.normalize())
        .collect()
}

/// The domain of a dodecahedral space has these radii to its faces and corners.
fn check_radii(model: Model, space: &Manifold, [face, corner]: [f64; 2]) {
    let gluing = space.gluing().unwrap();
    for radius in radii(model, gluing, &dodecahedron()) {
        assert!((radius - face).abs() < 1e-11, "{radius} {face}");
    }
    // Corners are where three faces meet: farther than anything near.
    let out = radii(model, gluing, &corners());
    let worst = out.iter().map(|r| (r - corner).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-11, "{out:?} {corner}");
}

/// The unit quaternion (w; x, y, z) times vectors, from the left.
fn left(w: f64, v: DVec3) -> DMat4 {
    DMat4::from_cols_array_2d(&[
        [w, v.z, -v.y, -v.x],
        [-v.z, w, v.x, -v.y],
        [v.y, -v.x, w, -v.z],
        [v.x, v.y, v.z, w],
    ])
}

#[test]
fn poincares_space_is_that_of_120_quaternions() {
    let (model, space) = (Model::Sphere, asset("poincare"));
    check_radii(model, &space, [PI / 10.0, 0.388_139_515_370]);
    let (s, c) = (PI / 5.0).sin_cos();
    let generators: Vec<DMat4> = dodecahedron().iter().map(|n| left(c, *n * s)).collect();
    let all = group(&generators, |_| true);
    assert_eq!(all.len(), 120);
    // Own images of the middle, by their angle.
    let home = model.point([0.0; 3]);
    let own = distances(model, &all, [home, home]);
    let shells = [
        (36, 12),
        (60, 20),
        (72, 12),
        (90, 30),
        (108, 12),
        (120, 20),
        (144, 12),
        (180, 1),
    ];
    for (degrees, count) in shells {
        let at = |(d, _): &&(f64, bool)| (d.to_degrees() - f64::from(degrees)).abs() < 1e-5;
        assert_eq!(own.iter().filter(at).count(), count, "{degrees}");
    }
    let points = [
        model.point([0.1, 0.2, -0.05]),
        model.point([-0.15, 0.03, 0.12]),
    ];
    let seen = compare("poincare", (model, &space), &all, points, 4.0);
    for ((d, _), known) in seen.iter().zip([
        0.348_688_219_641,
        0.373_430_251_145,
        0.418_685_684_911,
        0.420_832_380_548,
    ]) {
        assert!((d - known).abs() < 1e-11, "{d} {known}");
    }
    let count = |d| within(model, &seen, d).0;
    assert_eq!([1.0, FRAC_PI_2, 2.0, 4.0].map(count), [24, 60, 94, 120]);
    let light = within(model, &seen, 4.0).2;
    assert!((light - 210.251_040_630_4).abs() < 1e-8, "{light}");
}

#[test]
fn lens_spaces_are_those_of_screws() {
    let model = Model::Sphere;
    let points = [
        model.point([0.1, 0.2, -0.05]),
        model.point([-0.15, 0.03, 0.12]),
    ];
    let cases = [
        (
            1,
            [
                0.348_688_22,
                1.140_905_02,
                1.405_981_41,
                2.321_621_71,
                2.565_175_98,
            ],
        ),
        (
            2,
            [
                0.348_688_22,
                1.072_857_03,
                1.447_131_08,
                2.352_222_66,
                2.561_652_38,
            ],
        ),
    ];
    for (q, known) in cases {
        let [(a, b), (c, d)] = [1, q].map(|k| (f64::from(k) * TAU / 5.0).sin_cos());
        let rows = [
            [b, -a, 0.0, 0.0],
            [a, b, 0.0, 0.0],
            [0.0, 0.0, d, -c],
            [0.0, 0.0, c, d],
        ];
        let space = manifold(&format!(
            "metric = {{ conformal = '2/(1 + r2)' }}\n[let]\nr2 = 'x^2 + y^2 + z^2'\n[quotient]\nlift = ['2*x/(1 + r2)', '2*y/(1 + r2)', '2*z/(1 + r2)', '(1 - r2)/(1 + r2)']\ndrop = ['X/(1 + W)', 'Y/(1 + W)', 'Z/(1 + W)']\ngenerators = [{rows:?}]\n"
        ));
        let screw = DMat4::from_cols_array_2d(&rows).transpose();
        let all = group(&[screw, screw.inverse()], |_| true);
        let what = format!("L(5, {q})");
        let seen = compare(&what, (model, &space), &all, points, 4.0);
        assert_eq!(seen.len(), 5, "{what}");
        for ((d, _), known) in seen.iter().zip(known) {
            assert!((d - known).abs() < 1e-8, "{what}: {d} {known}");
        }
        if q == 2 {
            compare(
                "the catalogue's",
                (model, &asset("lens-space")),
                &all,
                points,
                4.0,
            );
        }
    }
}

/// A translation by `d` along a unit vector, after a turn about it.
fn screw(axis: DVec3, d: f64, turn: f64) -> DMat4 {
    let (sinh, cosh) = (d.sinh(), d.cosh());
    let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
    let along = DMat3::IDENTITY + outer * (cosh - 1.0);
    let column = |k: usize| along.col(k).extend(sinh * axis[k]);
    let boost = DMat4::from_cols(column(0), column(1), column(2), (axis * sinh).extend(cosh));
    boost * DMat4::from_axis_angle(axis, turn)
}

/// The points that answers about hyperbolic spaces are for.
fn hyperbolic_points() -> [DVec4; 2] {
    [[0.2, -0.1, 0.3], [-0.25, 0.15, 0.05]].map(|x| Model::Hyperboloid.point(x))
}

#[test]
fn the_space_of_seifert_and_weber_is_that_of_screws_by_three_tenths() {
    let (model, space) = (Model::Hyperboloid, asset("seifert-weber"));
    let radius = 0.996_384_497_847_316;
    check_radii(model, &space, [radius, 1.902_847_344_405_752]);
    let generators: Vec<DMat4> = dodecahedron()
        .into_iter()
        .map(|n| screw(n, 2.0 * radius, 0.3 * TAU))
        .collect();
    let most = 5.6_f64;
    let all = group(&generators, |m| m.w_axis.w < (most + 0.01).cosh());
    let home = model.point([0.0; 3]);
    let own = distances(model, &all, [home, home]);
    let shells = [
        (1.992_769, 12),
        (2.789_000, 60),
        (3.421_647, 120),
        (3.675_826, 120),
        (3.805_695, 20),
        (3.985_538, 132),
    ];
    for (d, count) in shells {
        let at = |(x, _): &&(f64, bool)| (x - d).abs() < 1e-6;
        assert_eq!(own.iter().filter(at).count(), count, "{d}");
    }
    let count = |d| within(model, &own, d).0;
    assert_eq!([4.0, 5.0, most].map(count), [465, 3045, 10185]);
    let own = compare("own images", (model, &space), &all, [home, home], 5.0);
    assert_eq!(own.len(), 3045);
    let seen = compare("images", (model, &space), &all, hyperbolic_points(), 4.5);
    let known = [
        (2.0, 6, 3.519_974_591_9),
        (3.0, 62, 4.661_769_301_6),
        (4.0, 401, 5.755_557_499_5),
        (4.5, 1102, 6.283_579_822_3),
    ];
    for (d, count, light) in known {
        let (found, _, sum) = within(model, &seen, d);
        assert_eq!(found, count, "within {d}");
        assert!((sum - light).abs() < 1e-9, "{sum} {light}");
    }
}

/// How the matrix (a b; c d) of determinant 1 moves the hyperboloid: as `m H m*` does Hermitian matrices
/// H = (w + z, x + iy; x - iy, w - z).
fn moving(m: [Complex64; 4]) -> DMat4 {
    let times = |[a, b, c, d]: [Complex64; 4], [e, f, g, h]: [Complex64; 4]| {
        [a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h]
    };
    let column = |x: DVec4| {
        let [first, last] = [x.w + x.z, x.w - x.z].map(Complex64::from);
        let [right, left] = [x.y, -x.y].map(|y| Complex64::new(x.x, y));
        let hermitian = [first, right, left, last];
        let adjoint = [m[0].conj(), m[2].conj(), m[1].conj(), m[3].conj()];
        let [p, q, _, s] = times(times(m, hermitian), adjoint);
        DVec4::new(q.re, q.im, 0.5 * (p.re - s.re), 0.5 * (p.re + s.re))
    };
    let [x, y, z, w] = DVec4::AXES.map(column);
    DMat4::from_cols(x, y, z, w)
}

#[test]
fn the_complement_of_the_figure_eight_knot_is_that_of_two_parabolics() {
    let (model, space) = (Model::Hyperboloid, asset("figure-eight"));
    let [zero, one] = [0.0, 1.0].map(Complex64::from);
    let root = Complex64::new(-0.5, 0.75_f64.sqrt());
    let steps = [
        [one, one, zero, one],
        [one, -one, zero, one],
        [one, zero, -root, one],
        [one, zero, root, one],
    ];
    let all = group(&steps.map(moving), |m| m.w_axis.w < 5.0_f64.cosh());
    let points = [[0.15, -0.05, 0.1], [-0.12, 0.1, 0.05]];
    let seen = compare(
        "images",
        (model, &space),
        &all,
        points.map(|u| model.lift(DVec3::from(u))),
        3.0,
    );
    // Counted elsewhere in exact numbers: integers of the field of the third roots of one.
    let nearest = [
        0.467_085_509_519,
        0.635_046_673_934,
        0.948_785_257_484,
        1.024_840_450_647,
        1.099_194_149_211,
    ];
    for (found, known) in seen.iter().zip(nearest) {
        assert!((found.0 - known).abs() < 1e-10, "{} {known}", found.0);
    }
    assert_eq!([2.0, 3.0].map(|d| within(model, &seen, d).0), [41, 317]);
    let light = within(model, &seen, 3.0).2;
    assert!((light - 20.234_701_317).abs() < 1e-8, "{light}");
}

#[test]
fn the_mirrored_dodecahedron_is_that_of_twelve_reflections() {
    let (model, space) = (Model::Hyperboloid, asset("mirrored-dodecahedron"));
    let radius = 0.808_460_833_755_943_f64;
    check_radii(model, &space, [radius, 1.226_456_871_251_405]);
    let reflection = |n: DVec3| {
        // In the plane at this distance, whose normal is space-like.
        let normal = (n * radius.cosh()).extend(radius.sinh());
        let dual = normal * DVec4::new(1.0, 1.0, 1.0, -1.0);
        let column = |k: usize| DVec4::AXES[k] - normal * (2.0 * dual[k]);
        DMat4::from_cols(column(0), column(1), column(2), column(3))
    };
    let generators: Vec<DMat4> = dodecahedron().into_iter().map(reflection).collect();
    let all = group(&generators, |m| m.w_axis.w < 5.2_f64.cosh());
    let home = model.point([0.0; 3]);
    let own = compare("own images", (model, &space), &all, [home, home], 4.0);
    let count = |d| {
        let (all, mirrored, _) = within(model, &own, d);
        (all, mirrored)
    };
    assert_eq!(
        [2.0, 3.0, 4.0].map(count),
        [(13, 12), (123, 32), (1155, 512)]
    );
    let seen = compare("images", (model, &space), &all, hyperbolic_points(), 4.0);
    let known = [
        (2.0, 18, 11, 5.147_844_803_2),
        (3.0, 132, 60, 7.923_492_575_7),
        (4.0, 1073, 527, 11.014_748_007_0),
    ];
    for (d, count, mirrored, light) in known {
        let found = within(model, &seen, d);
        assert_eq!((found.0, found.1), (count, mirrored), "within {d}");
        assert!((found.2 - light).abs() < 1e-9, "{} {light}", found.2);
    }
}

/// A motion of flat space: a diagonal matrix of signs, or a turn about z, then a translation.
fn motion(linear: DMat3, by: [f64; 3]) -> DMat4 {
    let column = |k: usize| linear.col(k).extend(0.0);
    DMat4::from_cols(column(0), column(1), column(2), DVec3::from(by).extend(1.0))
}

/// The flat space whose group these motions generate.
fn flat_space(generators: &[DMat4]) -> Manifold {
    let rows = |m: &DMat4| format!("{:?}", m.transpose().to_cols_array_2d());
    let all: Vec<String> = generators.iter().map(rows).collect();
    manifold(&format!(
        "metric = {{ conformal = '1' }}\n[quotient]\nlift = ['x', 'y', 'z', '1']\ndrop = ['X', 'Y', 'Z']\ngenerators = [{}]\n",
        all.join(", ")
    ))
}

#[test]
fn flat_spaces_are_those_of_their_groups() {
    let model = Model::Flat;
    let shift = |by| motion(DMat3::IDENTITY, by);
    let turned = |degrees: f64| {
        motion(
            DMat3::from_rotation_z(degrees.to_radians()),
            [0.0, 0.0, 2.0],
        )
    };
    let sides = |x: f64, y: f64| shift([x, y, 0.0]);
    let signs = |x, y, z| DMat3::from_diagonal(DVec3::new(x, y, z));
    let hexagon = [sides(2.0, 0.0), sides(1.0, 3.0_f64.sqrt())];
    let square = [sides(2.0, 0.0), sides(0.0, 2.0)];
    let with = |pair: [DMat4; 2], third| vec![pair[0], pair[1], third];
    let screws = vec![
        motion(signs(1.0, -1.0, -1.0), [1.0, 1.0, 0.0]),
        motion(signs(-1.0, 1.0, -1.0), [0.0, 1.0, 1.0]),
    ];
    let cases = [
        (
            "torus",
            with(square, shift([0.0, 0.0, 2.0])),
            (114, 14),
            (0, 1.118_033_989),
        ),
        (
            "half turn",
            with(square, turned(180.0)),
            (115, 14),
            (1, 1.236_931_688),
        ),
        (
            "quarter turn",
            with(square, turned(90.0)),
            (115, 14),
            (0, 1.024_695_077),
        ),
        (
            "third turn",
            with(hexagon, turned(120.0)),
            (134, 14),
            (0, 1.079_607_041),
        ),
        (
            "sixth turn",
            with(hexagon, turned(60.0)),
            (133, 14),
            (0, 1.012_695_099),
        ),
        ("Hantzsche and Wendt", screws, (454, 59), (0, 0.7)),
    ];
    let points = [model.point([0.3, 0.2, -0.4]), model.point([-0.1, 0.5, 0.6])];
    for (name, generators, (far, near), (place, nearest)) in cases {
        let inverses = generators.iter().map(DMat4::inverse);
        let steps: Vec<DMat4> = generators.iter().copied().chain(inverses).collect();
        let all = group(&steps, |m| m.w_axis.truncate().length() < 11.0);
        let space = flat_space(&generators);
        let seen = compare(name, (model, &space), &all, points, 6.0);
        let count = |d| within(model, &seen, d).0;
        assert_eq!((count(6.0), count(3.0)), (far, near), "{name}");
        let found = seen[place].0;
        assert!((found - nearest).abs() < 1e-9, "{name}: {found}");
    }
}
