//! Light against closed forms: how much arrives, by how many ways, and what shadows it.

use geofan_core::{
    diagnostic::SourceText,
    geodesic::{Ray, Settings, paths},
    manifold::Manifold,
    random::Stream,
};
use geofan_light::{Connection, LightFan, MOST_GAIN, cache, irradiance};
use geofan_render::{Stage, lightmap::Lightmap};
use glam::{DVec2, DVec3, DVec4};
use std::f64::consts::{PI, TAU};

fn manifold(metric: &str) -> Manifold {
    let text = format!("name = 'test'\ncoordinates = ['x', 'y', 'z']\n{metric}");
    Manifold::from_source(SourceText::new("test.toml", text), &[]).unwrap()
}

const SPHERE: &str = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }";

/// Tolerance of the geodesics where 1e-6 of the irradiance is asked for.
const FINE: f64 = 1e-11;

/// A fan for connections to `points`.
fn fan<'m>(space: &'m Manifold, from: DVec3, length: f64, points: &[DVec3]) -> LightFan<'m> {
    let fold = |f: fn(DVec3, DVec3) -> DVec3| points[1..].iter().fold(points[0], |a, b| f(a, *b));
    LightFan::new(space, from, length, (fold(DVec3::min), fold(DVec3::max)))
}

/// A point of the chart at random, at most `radius` from the origin.
fn point(stream: &mut Stream, radius: f64) -> DVec3 {
    stream.direction() * (radius * stream.uniform().cbrt())
}

/// Lights of a thousand random pairs: each needs a fan of its own.
const LIGHTS: usize = 2;

/// For a thousand random pairs of a light and a receiver, the shortest connection must
/// have the length and area that `known` gives for the two points.
fn check_pairs(
    space: &Manifold,
    length: f64,
    mut light: impl FnMut(&mut Stream) -> DVec3,
    mut receiver: impl FnMut(&mut Stream, DVec3) -> (DVec3, f64, f64),
) {
    let mut stream = Stream::new(&[11]);
    for _ in 0..LIGHTS {
        let from = light(&mut stream);
        let known: Vec<(DVec3, f64, f64)> = (0..1000 / LIGHTS)
            .map(|_| receiver(&mut stream, from))
            .collect();
        let points: Vec<DVec3> = known.iter().map(|k| k.0).collect();
        let (found, _) = fan(space, from, length, &points).connections(&points, FINE);
        for (i, (u, s, area)) in known.iter().enumerate() {
            let mut of_point = found.iter().filter(|(index, _)| *index == i);
            let ways: Vec<(f64, f64)> = of_point.clone().map(|(_, c)| (c.s, c.area)).collect();
            let way = of_point.find(|(_, c)| (c.s - s).abs() < 1e-6);
            let (_, way) = way.unwrap_or_else(|| panic!("{from} to {u}: {s}, found {ways:?}"));
            // The surface is tilted at random: the cosine is of the tangent that arrives.
            let frame = space.standard_frame(*u);
            let cosine = 0.3;
            let v = frame.inverse() * way.v;
            let n = v * cosine + v.any_orthonormal_vector() * (1.0_f64 - cosine * cosine).sqrt();
            let covector = frame.inverse().transpose() * n;
            let got = irradiance(space, *u, covector, way).abs();
            let expected = cosine / area.abs();
            assert!(
                (got / expected - 1.0).abs() < 1e-6,
                "{from} to {u}: {got} {expected}"
            );
        }
    }
}

#[test]
fn light_spreads_as_the_square_in_flat_space() {
    let flat = manifold("metric = { conformal = '1' }");
    check_pairs(
        &flat,
        8.0,
        |r| point(r, 2.0),
        |r, from| {
            let u = point(r, 4.0);
            let s = (u - from).length();
            (u, s, s * s)
        },
    );
}

/// Nor does it take more rays to find it: knots of arc length lie where light matters.
#[test]
fn light_is_found_however_much_farther_than_the_scene_it_is_followed() {
    let exit = "[[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 400'";
    let mut stream = Stream::new(&[5]);
    let points: Vec<DVec3> = (0..200)
        .map(|_| DVec3::new(3.0, 0.5, 0.3) + point(&mut stream, 1.0))
        .collect();
    for exit in [exit, ""] {
        let flat = manifold(&format!("metric = {{ conformal = '1' }}\n{exit}"));
        for length in [60.0, 1e4, 3e7, 1e100] {
            let fan = fan(&flat, DVec3::Z, length, &points);
            let (ways, followed) = fan.connections(&points, FINE);
            assert_eq!(ways.len(), points.len(), "{length}");
            for (i, way) in ways {
                let s = (points[i] - DVec3::Z).length();
                assert!((way.s - s).abs() < 1e-9, "{length}");
            }
            assert!(followed <= 4 * points.len(), "{length}: {followed}");
        }
    }
}

/// A chart point of the three-sphere in R⁴.
fn ambient(u: DVec3) -> DVec4 {
    let r2 = u.length_squared();
    (2.0 * u / (1.0 + r2)).extend((r2 - 1.0) / (1.0 + r2))
}

fn sphere_distance(a: DVec3, b: DVec3) -> f64 {
    let (p, q) = (ambient(a), ambient(b));
    (p - q).length().atan2((p + q).length()) * 2.0
}

#[test]
fn light_spreads_as_the_square_of_the_sine_on_the_three_sphere() {
    check_pairs(
        &manifold(SPHERE),
        3.05,
        |r| point(r, 1.0),
        |r, from| {
            // Not beside the antipode, where the length ends.
            let mut u = point(r, 2.0);
            while sphere_distance(from, u) > 3.0 {
                u = point(r, 2.0);
            }
            let s = sphere_distance(from, u);
            (u, s, s.sin().powi(2))
        },
    );
}

#[test]
fn light_spreads_as_the_square_of_the_hyperbolic_sine_in_hyperbolic_space() {
    let space = manifold(
        "metric = { conformal = '2/(1 - x^2 - y^2 - z^2)' }\n[domain]\ninside = ['0.9999 - x^2 - y^2 - z^2']",
    );
    check_pairs(
        &space,
        8.0,
        |r| point(r, 0.6),
        |r, from| {
            let u = point(r, 0.9);
            let gap = (1.0 - from.length_squared()) * (1.0 - u.length_squared());
            let s = 2.0 * ((u - from).length_squared() / gap).sqrt().asinh();
            (u, s, s.sinh().powi(2))
        },
    );
}

#[test]
fn light_spreads_by_a_sine_and_a_line_in_sphere_times_line() {
    let space =
        manifold("metric = { xx = '4/(1 + x^2 + y^2)^2', yy = '4/(1 + x^2 + y^2)^2', zz = '1' }");
    check_pairs(
        &space,
        4.0,
        |r| point(r, 1.0),
        |r, from| {
            let u = point(r, 1.5);
            let flat = |u: DVec3| DVec3::new(u.x, u.y, 0.0);
            let (angle, rise) = (sphere_distance(flat(from), flat(u)), u.z - from.z);
            let s = angle.hypot(rise);
            (u, s, s * angle.sin() * s / angle)
        },
    );
}

#[test]
fn light_spreads_in_nil_as_its_closed_form_says() {
    let nil = manifold(
        "metric = { xx = '1 + y^2/4', yy = '1 + x^2/4', zz = '1', xy = '-x*y/4', xz = 'y/2', yz = '-x/2' }",
    );
    let end = |a: f64, turn: f64, c: f64, s: f64| {
        let chord = DVec2::from_angle(0.5 * c * s + turn) * (2.0 * a / c * (0.5 * c * s).sin());
        let z = c * s + a * a / (2.0 * c * c) * (c * s - (c * s).sin());
        chord.extend(z)
    };
    let left = |p: DVec3, u: DVec3| p + u + DVec3::Z * (0.5 * (p.x * u.y - p.y * u.x));
    check_pairs(
        &nil,
        5.0,
        |r| point(r, 1.0),
        |r, from| {
            // The closed form is a difference that loses its digits towards c = 0.
            let mut d = r.direction();
            while d.z.abs() < 0.2 {
                d = r.direction();
            }
            let (c, s) = (d.z, r.between(0.2, 4.5));
            let a = (1.0 - c * c).sqrt();
            let w = c * s;
            let area = (2.0 - 2.0 * w.cos() - w * (1.0 - c * c) * w.sin()) / c.powi(4);
            (left(from, end(a, d.y.atan2(d.x), c, s)), s, area)
        },
    );
}

#[test]
fn both_ways_round_the_three_sphere_are_found() {
    let s3 = manifold(SPHERE);
    let mut stream = Stream::new(&[5]);
    let from = DVec3::new(0.4, -0.3, 0.2);
    let points: Vec<DVec3> = (0..300).map(|_| point(&mut stream, 1.5)).collect();
    let (found, _) = fan(&s3, from, 6.0, &points).connections(&points, FINE);
    for (i, u) in points.iter().enumerate() {
        let near = sphere_distance(from, *u);
        let ways: Vec<&Connection> = found.iter().filter(|f| f.0 == i).map(|f| &f.1).collect();
        let expected: Vec<f64> = [near, TAU - near]
            .into_iter()
            .filter(|s| *s <= 6.0)
            .collect();
        let lengths: Vec<f64> = ways.iter().map(|c| c.s).collect();
        assert_eq!(
            lengths.len(),
            expected.len(),
            "{u}: {lengths:?}, expected {expected:?}"
        );
        for (way, s) in ways.iter().zip(&expected) {
            assert!((way.s - s).abs() < 1e-7);
            assert!((way.area - s.sin().powi(2)).abs() < 1e-6 * s.sin().powi(2));
        }
    }
}

/// How many geodesics from `from` reach `to` in a space that is symmetric about the origin, and
/// their lengths: they lie in the plane with the origin, so shooting at every angle finds them all.
fn brute_force(space: &Manifold, from: DVec3, to: DVec3, length: f64) -> Vec<f64> {
    let x = from.normalize();
    let y = (to - x * x.dot(to)).normalize();
    let goal = DVec2::new(to.dot(x), to.dot(y));
    let count = 2000;
    let settings = Settings::bare(1e-6).with_events();
    let frame = space.standard_frame(from);
    let rays = (0..count).map(|i| {
        let d = DVec2::from_angle(TAU * (i as f64 + 0.37) / count as f64);
        let w = frame.inverse() * (x * d.x + y * d.y);
        Ray::new(space, from, w.normalize(), length)
    });
    // Where each ray crosses the circle through the goal: inwards and outwards, the angle beyond
    // the goal's and the arc length.
    let crossings = paths(space, settings, rays).into_iter().map(|path| {
        let mut found = [None; 2];
        let mut before: Option<(f64, f64, f64)> = None;
        for k in 0..=300 {
            let s = path.length * k as f64 / 300.0;
            let Some(step) = path.step_at(s) else { break };
            let u = step.position(s);
            let flat = DVec2::new(u.dot(x), u.dot(y));
            let state = (flat.length() - goal.length(), goal.angle_to(flat), s);
            if let Some((r, angle, at)) = before
                && (r < 0.0) != (state.0 < 0.0)
                && (state.1 - angle).abs() < 1.0
            {
                let t = r / (r - state.0);
                found[usize::from(r < 0.0)] =
                    Some((angle + (state.1 - angle) * t, at + (s - at) * t));
            }
            before = Some(state);
        }
        found
    });
    let crossings: Vec<[Option<(f64, f64)>; 2]> = crossings.collect();
    let mut lengths = Vec::new();
    for way in 0..2 {
        for i in 0..count {
            let (a, b) = (crossings[i][way], crossings[(i + 1) % count][way]);
            if let (Some((a, s)), Some((b, _))) = (a, b)
                && (a < 0.0) != (b < 0.0)
                && (a - b).abs() < 0.5
            {
                lengths.push(s);
            }
        }
    }
    lengths.sort_by(f64::total_cmp);
    lengths
}

#[test]
fn all_ways_past_a_bump_are_found() {
    let bump = manifold(
        "embedding = ['x', 'y', 'z', '1.3*exp(-(x^2 + y^2 + z^2)/2)']\n[[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 64'",
    );
    let from = DVec3::new(-3.0, 0.4, 0.7);
    let mut stream = Stream::new(&[3]);
    let axis = -from.normalize();
    let points: Vec<DVec3> = (0..12)
        .map(|_| axis * stream.between(1.5, 7.0) + point(&mut stream, 0.8))
        .collect();
    let (found, _) = fan(&bump, from, 16.0, &points).connections(&points, 1e-9);
    let mut several = 0;
    for (i, to) in points.iter().enumerate() {
        let known = brute_force(&bump, from, *to, 16.0);
        let lengths: Vec<f64> = found.iter().filter(|f| f.0 == i).map(|f| f.1.s).collect();
        assert_eq!(
            lengths.len(),
            known.len(),
            "{to}: {lengths:?}, brute force {known:?}"
        );
        for (a, b) in lengths.iter().zip(&known) {
            assert!(
                (a - b).abs() < 2e-2,
                "{to}: {lengths:?}, brute force {known:?}"
            );
        }
        several += usize::from(known.len() > 1);
    }
    assert!(several >= 4, "only {several} points have several ways");
}

#[test]
fn no_way_is_counted_twice_where_geodesics_are_found_less_exactly() {
    let bump = manifold("embedding = ['x', 'y', 'z', 'exp(-(x^2 + y^2 + z^2)/2)']");
    let from = DVec3::new(-4.0, 0.1, 0.8);
    let mut stream = Stream::new(&[7]);
    let points: Vec<DVec3> = (0..1500)
        .map(|_| DVec3::new(stream.between(2.3, 6.3), stream.between(-2.0, 2.0), -0.75))
        .collect();
    let fan = fan(&bump, from, 16.0, &points);
    let counts = |tolerance: f64| {
        let mut counts = vec![0; points.len()];
        for (index, _) in fan.connections(&points, tolerance).0 {
            counts[index] += 1;
        }
        counts
    };
    let (coarse, fine) = (counts(1e-6), counts(1e-10));
    let other = coarse.iter().zip(&fine).filter(|(a, b)| a != b).count();
    // Beside a caustic two ways merge, and the tolerance decides whether they have.
    assert!(other <= 3, "{other} points have other ways");
    assert!(fine.iter().filter(|count| **count == 3).count() > 50);
}

#[test]
fn light_that_has_gone_half_round_a_black_hole_is_found() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/manifolds");
    let rain = Manifold::load(&folder.join("schwarzschild-rain.toml"), &[]).unwrap();
    let (from, to) = (DVec3::new(3.0, 0.0, 0.0), DVec3::new(0.0, 5.0, 0.0));
    let margin = 0.25 * (to - from).length();
    // By quadrature of the equation of its orbit, which sweeps a quarter and three quarters of a turn.
    let known = [6.67023, 22.86630];
    let fan = LightFan::to_point(&rain, from, 25.0, (to, margin));
    let (found, _) = fan.connections(&[to], 1e-8);
    let found: Vec<f64> = found.into_iter().map(|(_, way)| way.s).collect();
    let same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-4;
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found.iter().zip(&known).all(same), "{found:?}");
}

#[test]
fn every_image_in_glued_coordinates_is_found() {
    let torus = manifold(
        "metric = { conformal = '1' }\n[domain]\nx = [-1, 1]\ny = [-1.5, 1.5]\nz = [-1, 1]\nperiodic = ['x', 'y', 'z']",
    );
    let (from, to) = (DVec3::new(0.9, -0.2, 0.3), DVec3::new(-0.7, 1.1, 0.4));
    let (found, _) = fan(&torus, from, 5.0, &[to]).connections(&[to], 1e-9);
    let mut known = Vec::new();
    for i in -4..=4 {
        for j in -4..=4 {
            for k in -4..=4 {
                let period = DVec3::new(2.0 * f64::from(i), 3.0 * f64::from(j), 2.0 * f64::from(k));
                let s = (to + period - from).length();
                known.extend((s <= 5.0).then_some(s));
            }
        }
    }
    known.sort_by(f64::total_cmp);
    assert_eq!(found.len(), known.len());
    for ((_, way), s) in found.iter().zip(&known) {
        assert!((way.s - s).abs() < 1e-7);
    }
}

#[test]
fn at_a_caustic_the_irradiance_is_clamped() {
    let s3 = manifold(SPHERE);
    let from = DVec3::new(0.5, 0.2, -0.1);
    let antipode = -from / from.length_squared();
    let near = antipode + DVec3::new(1e-4, 0.0, 0.0);
    let (found, _) = fan(&s3, from, 4.0, &[near, DVec3::ZERO]).connections(&[near], 1e-9);
    assert!(!found.is_empty());
    for (_, way) in found {
        let frame = s3.standard_frame(near);
        let facing = frame.inverse().transpose() * (frame.inverse() * way.v);
        let brought = irradiance(&s3, near, facing, &way).abs();
        assert!(brought <= 1.0001 * MOST_GAIN / (way.s * way.s), "{brought}");
        assert!(brought > 0.9 * MOST_GAIN / (way.s * way.s), "{brought}");
    }
    assert!((sphere_distance(from, antipode) - PI).abs() < 1e-12);
}

/// Behind a lens three geodesics come to a point, outside its caustic one; beside it two of them all but do.
#[test]
fn no_way_is_counted_twice_beside_a_caustic() {
    let lens = manifold("metric = { conformal = '1 + 0.4*exp(-2*(x^2 + y^2 + z^2))' }");
    let wall = |r: f64| DVec3::new(r, 2.0, 0.0);
    let fan = fan(&lens, DVec3::NEG_Y * 4.0, 12.0, &[wall(0.2), wall(0.6)]);
    let count = |r: f64, tolerance: f64| fan.connections(&[wall(r)], tolerance).0.len();
    let (mut low, mut high) = (0.2, 0.6);
    assert_eq!([low, high].map(|r| count(r, 1e-10)), [3, 1]);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        match count(middle, 1e-10) {
            3 => low = middle,
            _ => high = middle,
        }
    }
    for k in -200..200 {
        let r = low + 5e-7 * f64::from(k);
        let found = count(r, 1e-6);
        assert!(found <= 3, "{r} beside {low}: {found}");
    }
}

/// A floor of 4 by 4 at z = 0 and a small square above it, with a light over both; `more` are lines at the head of the scene.
fn lit_floor(folder: &std::path::Path, more: &str) -> Stage {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "flat.toml",
        "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n[cameras]\nlength = 20\n",
    );
    write(
        "square.obj",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n",
    );
    let scene = format!(
        "manifold = 'flat.toml'\n{more}\n[camera]\nat = [0, -4, 2]\nlook = [0, 1, -0.5]\nup = [0, 0, 1]\n\
         [[object]]\nmesh = 'square.obj'\nat = [0, 0, 0]\nscale = 2.0\n\
         [[object]]\nmesh = 'square.obj'\nat = [1, 1, 1]\nscale = 0.25\n\
         [[light]]\nkind = 'point'\nat = [0.2, -0.1, 2]\nintensity = [1, 2, 3]\n"
    );
    write("scene.toml", &scene);
    Stage::load(&folder.join("scene.toml"), &[]).unwrap()
}

/// A place on the lit floor: the triangle, its weights, the light that would arrive without the square, and how far beside
/// that square's edge the way to the lamp passes, negative where it does not get through.
struct LitPlace {
    triangle: u32,
    weights: [f32; 2],
    clear: f64,
    beside: f64,
}

fn places(stage: &Stage, count: usize) -> Vec<LitPlace> {
    let lamp = DVec3::new(0.2, -0.1, 2.0);
    let mut stream = Stream::new(&[1]);
    let place = |_| {
        let (mut b, mut c) = (stream.uniform(), stream.uniform());
        if b + c > 1.0 {
            (b, c) = (1.0 - b, 1.0 - c);
        }
        let triangle = stream.bits() as u32 % 2;
        let [p, q, r] = stage.world.accelerator.triangles()[triangle as usize];
        let u = p * (1.0 - b - c) + q * b + r * c;
        let way = lamp - u;
        let through = u + way * (1.0 / way.z);
        LitPlace {
            triangle,
            weights: [b as f32, c as f32],
            clear: way.z / way.length().powi(3),
            beside: (through - DVec3::new(1.0, 1.0, 1.0)).abs().max_element() - 0.25,
        }
    };
    (0..count).map(place).collect()
}

#[test]
fn baked_light_follows_the_inverse_square_law_and_casts_shadows() {
    let folder = tempfile::tempdir().unwrap();
    let stage = lit_floor(folder.path(), "");
    let (light, _) = cache::light(&stage.world, 20.0, 1e-8, None, |_, _| {});
    for place in places(&stage, 500) {
        let got = light.at(place.triangle, place.weights, true);
        assert_eq!(light.at(place.triangle, place.weights, false), [0.0; 3]);
        if place.beside < -0.02 {
            assert_eq!(got, [0.0; 3], "in the shadow");
        } else if place.beside > 0.02 {
            for k in 0..3 {
                let expected = (k + 1) as f64 * place.clear;
                assert!((f64::from(got[k]) / expected - 1.0).abs() < 1e-3);
            }
        }
    }
}

/// More points make the blurred edge of a shadow narrower.
#[test]
fn light_is_known_at_as_many_points_as_the_scene_asks_for() {
    let wrong = [1_000, 2_500, 40_000].map(|points: usize| {
        let folder = tempfile::tempdir().unwrap();
        let stage = lit_floor(folder.path(), &format!("light_points = {points}"));
        let (light, _) = cache::light(&stage.world, 20.0, 1e-6, None, |_, _| {});
        let known = light.values.len();
        assert!(
            (points / 3..=points + points / 10).contains(&known),
            "{known}"
        );
        let off = |place: &LitPlace| {
            let got = f64::from(light.at(place.triangle, place.weights, true)[0]);
            let expected = if place.beside < 0.0 { 0.0 } else { place.clear };
            (got - expected).abs() > 0.05 * place.clear
        };
        places(&stage, 20_000)
            .iter()
            .filter(|place| off(place))
            .count()
    });
    assert!(wrong[1] < wrong[0] && wrong[2] < wrong[1], "{wrong:?}");
}

#[test]
fn baked_light_is_kept_in_a_file_that_is_replaced_when_it_does_not_fit() {
    let folder = tempfile::tempdir().unwrap();
    let mut stage = lit_floor(folder.path(), "");
    let path = folder.path().join("scene.light");
    let bake = |stage: &Stage| -> (Lightmap, cache::LightmapSource) {
        cache::light(&stage.world, 20.0, 1e-6, Some(&path), |_, _| {})
    };
    let (first, source) = bake(&stage);
    assert_eq!(source, cache::LightmapSource::Computed);
    assert_eq!(bake(&stage), (first.clone(), cache::LightmapSource::File));
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(bake(&stage), (first, cache::LightmapSource::Damaged));
    stage.world.lights[0].intensity = [1.0, 1.0, 1.0];
    assert_eq!(bake(&stage).1, cache::LightmapSource::Outdated);
    assert_eq!(bake(&stage).1, cache::LightmapSource::File);
}

#[test]
fn kept_light_does_not_fit_where_clocks_or_what_lets_light_through_are_others() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    drop(lit_floor(folder.path(), "redshift = true"));
    write(
        "flat.toml",
        "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\nlapse = 'exp(k*z)'\nparameters = { k = 0.1 }\n",
    );
    let square = std::fs::read_to_string(folder.path().join("square.obj")).unwrap();
    write(
        "square.obj",
        &format!("mtllib pane.mtl\nusemtl pane\n{square}"),
    );
    let path = folder.path().join("scene.light");
    let kept = |k: f64, illum: u8| {
        write(
            "pane.mtl",
            &format!("newmtl pane\nKd 1 1 1\nKs 0 0 0\nd 0.5\nillum {illum}\n"),
        );
        let stage = Stage::load(&folder.path().join("scene.toml"), &[("k".into(), k)]).unwrap();
        let (_, source) = cache::light(&stage.world, 20.0, 1e-6, Some(&path), |_, _| {});
        source
    };
    assert_eq!(kept(0.1, 6), cache::LightmapSource::Computed);
    assert_eq!(kept(0.1, 6), cache::LightmapSource::File);
    assert_eq!(kept(0.2, 6), cache::LightmapSource::Outdated);
    assert_eq!(kept(0.2, 1), cache::LightmapSource::Outdated);
    assert_eq!(kept(0.2, 1), cache::LightmapSource::File);
}

#[test]
fn light_that_cannot_be_kept_lights_all_the_same_and_takes_no_foreign_files_place() {
    let folder = tempfile::tempdir().unwrap();
    let stage = lit_floor(folder.path(), "");
    let bake = |name: &str| {
        let path = folder.path().join(name);
        cache::light(&stage.world, 20.0, 1e-6, Some(&path), |_, _| {})
    };
    let (first, source) = bake("kept.light");
    assert_eq!(source, cache::LightmapSource::Computed);
    std::fs::create_dir(folder.path().join("folder.light")).unwrap();
    std::fs::write(folder.path().join("notes.light"), "my notes\n").unwrap();
    for name in ["folder.light", "notes.light", "no/such/folder.light"] {
        let known = (first.clone(), cache::LightmapSource::NotKept);
        assert_eq!(bake(name), known, "{name}");
    }
    let notes = std::fs::read_to_string(folder.path().join("notes.light"));
    assert_eq!(notes.unwrap(), "my notes\n");
}
