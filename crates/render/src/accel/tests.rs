use super::*;
use crate::{
    lanes::{BoxPacket, LANES, SingleVectors, each_vector},
    path_patch::Offsets,
};
use glam::Vec3;

impl Accelerator {
    /// Finds the first triangle on a chord among those numbered in `candidates` only, without the tree.
    fn first_hit_among(&self, candidates: &[u32], a: DVec3, b: DVec3) -> Option<ChordHit> {
        let numbered = |&number: &u32| {
            let corners = *self.triangles.get(number as usize)?;
            Some(LeafTriangle {
                corners,
                number,
                holed: self.holes.of(number).is_some(),
            })
        };
        let candidates = candidates.iter().filter_map(numbered);
        self.nearest(None, &Chord::new(a, b)?, candidates)
    }
}

/// A small deterministic generator of numbers in [0, 1).
pub(super) struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn point(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }
}

fn soup(random: &mut Random, count: usize, size: f64, place: DVec3, scale: f64) -> Vec<[DVec3; 3]> {
    let mut triangle = || {
        let centre = random.point();
        [0; 3].map(|_| place + scale * (centre + size * random.point()))
    };
    (0..count).map(|_| triangle()).collect()
}

/// A chord whose arc lengths nothing asks for.
fn chord(a: DVec3, b: DVec3) -> TimedChord {
    TimedChord {
        ends: [a, b],
        s: [0.0, 1.0],
    }
}

/// An octahedron's faces cut into `n²` pieces each and blown up to the unit sphere.
pub(super) fn sphere(n: i32) -> Vec<[DVec3; 3]> {
    let mut triangles = Vec::new();
    for signs in 0..8 {
        let sign = |bit: i32| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let flip = DVec3::new(sign(0), sign(1), sign(2));
        let at = |i: i32, j: i32| {
            (DVec3::new(i.into(), j.into(), (n - i - j).into()) * flip).normalize()
        };
        for i in 0..n {
            for j in 0..n - i {
                triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                if i + j + 2 <= n {
                    triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
    }
    triangles
}

#[test]
fn the_tree_agrees_with_trying_every_triangle() {
    let mut random = Random(1);
    // Small objects near and far from the chart's origin, and ones a hundred large.
    for (place, scale) in [
        (DVec3::ZERO, 1.0),
        (DVec3::splat(1e-3), 1e-3),
        (DVec3::splat(90.0), 1e-3),
        (DVec3::ZERO, 100.0),
    ] {
        let triangles = soup(&mut random, 400, 0.2, place, scale);
        let accelerator = Accelerator::build(&triangles);
        let all: Vec<u32> = (0..400).collect();
        let mut hits = 0;
        for reach in [0.05, 1.0, 30.0, 1e5] {
            for _ in 0..500 {
                let middle = place + scale * random.point();
                let half = scale * reach * random.point();
                let (a, b) = (middle - half, middle + half);
                let expected = accelerator.first_hit_among(&all, a, b);
                assert_eq!(
                    accelerator.first_hit_on_chord(&chord(a, b)),
                    expected,
                    "{a} {b}"
                );
                hits += usize::from(expected.is_some());
            }
        }
        assert!(hits > 500, "{hits}");
    }
}

#[test]
fn the_triangle_test_agrees_with_cramer() {
    let mut random = Random(2);
    let mut hits = 0;
    for _ in 0..20_000 {
        let corners = [0; 3].map(|_| random.point());
        let (a, b) = (random.point(), random.point());
        // a + t (b - a) = p + u (q - p) + v (r - p)
        let [p, q, r] = corners;
        let columns = glam::DMat3::from_cols(a - b, q - p, r - p);
        let x = columns.inverse() * (a - p);
        let inside = x.y >= 0.0 && x.z >= 0.0 && x.y + x.z <= 1.0 && (0.0..=1.0).contains(&x.x);
        let edge = [x.x, 1.0 - x.x, x.y, x.z, 1.0 - x.y - x.z].map(f64::abs);
        if edge.into_iter().fold(1.0, f64::min) < 1e-6 {
            continue;
        }
        let hit = Accelerator::build(&[corners]).first_hit_on_chord(&chord(a, b));
        assert_eq!(hit.is_some(), inside);
        if let Some(hit) = hit {
            hits += 1;
            let got = DVec3::new(hit.t, hit.barycentric.0, hit.barycentric.1);
            assert!(got.abs_diff_eq(x, 1e-8), "{got} {x}");
        }
    }
    assert!(hits > 500, "{hits}");
}

#[test]
fn a_closed_surface_has_no_cracks() {
    let triangles = sphere(24);
    let accelerator = Accelerator::build(&triangles);
    let mut random = Random(3);
    for round in 0..60_000 {
        let inside = random.point() * 0.4;
        // A third of the chords aim at a vertex or at the middle of an edge.
        let [p, q, _] = triangles[(random.next() * triangles.len() as f64) as usize];
        let aim = match round % 3 {
            0 => p,
            1 => (p + q) / 2.0,
            _ => random.point().normalize(),
        };
        let outside = inside + (aim - inside) * (1.5 + 20.0 * random.next());
        let hit = accelerator.first_hit_on_chord(&chord(inside, outside));
        assert!(hit.is_some(), "{inside} {outside}");
        assert!(
            accelerator
                .first_hit_on_chord(&chord(outside, inside))
                .is_some()
        );
    }
}

#[test]
fn a_path_of_many_chords_loses_no_hit_at_the_joints() {
    let accelerator = Accelerator::build(&sphere(8));
    let mut random = Random(4);
    for _ in 0..2_000 {
        let (start, way) = (random.point() * 0.3, random.point().normalize() * 1.5);
        let whole = accelerator
            .first_hit_on_chord(&chord(start, start + way))
            .unwrap();
        // The joint is put exactly on the surface.
        let joint = start + whole.t * way;
        let first = accelerator.first_hit_on_chord(&chord(start, joint));
        let second = accelerator.first_hit_on_chord(&chord(joint, start + way));
        assert!(first.is_some() || second.is_some());
    }
}

/// The first hits of sixteen chords, at whose ends arc lengths are `s`, on any triangle.
pub(super) fn packet(
    accelerator: &Accelerator,
    (a, b): (&[DVec3; 16], &[DVec3; 16]),
    s: [f64; 2],
) -> Option<PacketHits> {
    let spread = |p: &[DVec3; 16]| Offsets::of(&each_vector(|c, l| p[l][c]));
    let (a, b) = (spread(a), spread(b));
    accelerator.first_hits(&[0], ([&a, &b], s), DVec3::ZERO, &[1.0; 16])
}

#[test]
fn sixteen_chords_meet_what_each_does_by_itself() {
    let mut random = Random(7);
    for scale in [1e-3, 1.0, 100.0] {
        let triangles = soup(&mut random, 400, 0.2, DVec3::splat(3.0 * scale), scale);
        let accelerator = Accelerator::build(&triangles);
        let (mut hits, mut other) = (0, 0);
        for _ in 0..500 {
            let mut point = |at: DVec3, spread: f64| at + scale * (3.0 + spread * random.point());
            let middles = [0; 2].map(|_| point(DVec3::ZERO, 1.0) - 3.0 * scale);
            let [a, b] = middles.map(|middle| [0; 16].map(|_| point(middle, 0.05)));
            let found = packet(&accelerator, (&a, &b), [0.0, 1.0]);
            let t = |l: usize| found.as_ref().map_or(f32::INFINITY, |found| found.t[l]);
            for l in 0..16 {
                let alone = accelerator.first_hit_on_chord(&chord(a[l], b[l]));
                let expected = alone.map_or(f32::INFINITY, |hit| hit.t as f32);
                hits += usize::from(alone.is_some());
                // At an edge either answer is right.
                let same = expected == t(l) || (expected - t(l)).abs() < 1e-5;
                other += usize::from(!same);
                if let (true, Some(hit), Some(found)) = (same, alone, &found) {
                    let weight = hit.barycentric.0 as f32 - found.weights[0][l];
                    let near = hit.triangle != found.triangle[l] || weight.abs() < 1e-4;
                    assert!(near, "{weight}");
                }
            }
        }
        assert!(hits > 1000 && other < 3, "{hits} {other}");
    }
}

#[test]
fn sixteen_chords_find_no_cracks_and_lose_nothing_at_joints() {
    let accelerator = Accelerator::build(&sphere(24));
    let mut random = Random(8);
    for _ in 0..2_000 {
        let start = random.point() * 0.3;
        let aim = random.point().normalize();
        let starts = [0; 16].map(|_| start + 0.01 * random.point());
        let ends = [0; 16].map(|_| 2.0 * (aim + 0.01 * random.point()));
        let whole = packet(&accelerator, (&starts, &ends), [0.0, 1.0]).expect("a closed surface");
        // The joints are put on the surface.
        let joints = std::array::from_fn(|l| starts[l].lerp(ends[l], whole.t[l].into()));
        let [first, second] = [(&starts, &joints), (&joints, &ends)];
        let [first, second] =
            [first, second].map(|(a, b)| packet(&accelerator, (a, b), [0.0, 1.0]));
        let is_hit = |found: &Option<PacketHits>, l: usize| {
            found.as_ref().is_some_and(|found| found.t[l].is_finite())
        };
        for l in 0..16 {
            assert!(whole.t[l].is_finite(), "{}", starts[l]);
            assert!(is_hit(&first, l) || is_hit(&second, l));
        }
    }
}

#[test]
fn roots_of_a_part_are_below_those_of_the_whole() {
    let mut random = Random(9);
    let triangles = soup(&mut random, 400, 0.1, DVec3::ZERO, 1.0);
    let accelerator = Accelerator::build(&triangles);
    // The triangles of all leaves below them whose boxes meet the query.
    let met = |roots: &[u32], query: (DVec3, DVec3)| {
        let mut open = roots.to_vec();
        let mut met = Vec::new();
        while let Some(i) = open.pop() {
            let node = &accelerator.tree.nodes[i as usize];
            match node.is_leaf() {
                true => met.extend(
                    accelerator
                        .tree
                        .leaf(node)
                        .iter()
                        .map(|t| (t.number, t.corners)),
                ),
                false => open.extend([node.first_index, node.first_index + 1]),
            }
        }
        met.retain(|(_, corners)| boxes_meet(box_of(corners), query));
        let mut numbers: Vec<u32> = met.into_iter().map(|(number, _)| number).collect();
        numbers.sort_unstable();
        numbers
    };
    let mut count = 0;
    for _ in 0..300 {
        let (middle, half) = (random.point(), 0.3 * random.point().abs());
        let whole = (middle - half, middle + half);
        let part = (middle - 0.4 * half, middle + 0.7 * half);
        let (mut roots, mut below, mut expected) = (Vec::new(), Vec::new(), Vec::new());
        accelerator.roots(whole, None, &mut roots);
        accelerator.roots(part, Some(&roots), &mut below);
        accelerator.candidates(part.0, part.1, &mut expected);
        expected.sort_unstable();
        assert_eq!(met(&below, part), expected);
        assert_eq!(met(&roots, part), expected);
        count += expected.len();
    }
    assert!(count > 200, "{count}");
}

#[test]
fn axis_parallel_chords_and_flat_sets_work() {
    let square = |z: f64| {
        [
            DVec3::new(-1.0, -1.0, z),
            DVec3::new(1.0, -1.0, z),
            DVec3::new(0.0, 2.0, z),
        ]
    };
    let accelerator = Accelerator::build(&[square(0.0)]);
    let hit = accelerator
        .first_hit_on_chord(&chord(DVec3::Z, DVec3::NEG_Z))
        .unwrap();
    assert_eq!((hit.t, hit.triangle), (0.5, 0));
    assert!(
        accelerator
            .first_hit_on_chord(&chord(DVec3::NEG_X, DVec3::X))
            .is_none()
    );
    let stacked = Accelerator::build(&[square(0.25), square(-0.5), square(-0.5), square(0.5)]);
    let up = stacked
        .first_hit_on_chord(&chord(DVec3::NEG_Z, DVec3::Z))
        .unwrap();
    assert_eq!((up.t, up.triangle), (0.25, 1));
    assert_eq!(
        stacked
            .first_hit_on_chord(&chord(DVec3::Z, DVec3::NEG_Z))
            .unwrap()
            .triangle,
        3
    );
}

#[test]
fn boxes_find_every_triangle_they_meet() {
    let mut random = Random(5);
    let triangles = soup(&mut random, 300, 0.1, DVec3::new(5.0, 0.0, 0.0), 0.01);
    let accelerator = Accelerator::build(&triangles);
    let mut found = Vec::new();
    let mut counts = [0; 2];
    for _ in 0..2_000 {
        let (p, half) = (random.point(), random.point().abs() * random.next().powi(3));
        let place = |x: DVec3| DVec3::new(5.0, 0.0, 0.0) + 0.015 * x;
        let (min, max) = (place(p - half), place(p + half));
        accelerator.candidates(min, max, &mut found);
        found.sort_unstable();
        let meets = |i: &u32| boxes_meet(box_of(&triangles[*i as usize]), (min, max));
        let expected: Vec<u32> = (0..300).filter(meets).collect();
        assert_eq!(found, expected);
        let touches = accelerator.touches(min, max);
        assert!(touches || expected.is_empty());
        counts[usize::from(touches)] += 1;
    }
    assert!(counts[0] > 100 && counts[1] > 100, "{counts:?}");
    let (min, max) = accelerator.bounds().unwrap();
    assert!(min.x > 4.98 && max.x < 5.02);
}

#[test]
fn sixteen_boxes_touch_what_each_does_alone() {
    let mut stream = geofan_core::random::Stream::new(&[4]);
    let mut point = |size: f64| DVec3::from_array([0; 3].map(|_| stream.between(-size, size)));
    let mut triangle = || {
        let centre = point(1.0);
        [0; 3].map(|_| centre + point(0.1))
    };
    let triangles: Vec<[DVec3; 3]> = (0..60).map(|_| triangle()).collect();
    let accelerator = Accelerator::build(&triangles);
    let mut counts = [0; 2];
    for _ in 0..200 {
        let boxes: [(Vec3, Vec3); LANES] = std::array::from_fn(|_| {
            let (centre, half) = (point(1.6).as_vec3(), point(0.3).abs().as_vec3());
            (centre - half, centre + half)
        });
        let lanes = |of: fn(&(Vec3, Vec3)) -> Vec3| -> SingleVectors {
            [0, 1, 2].map(|c| boxes.each_ref().map(|b| of(b)[c]))
        };
        let touched = accelerator.touched(&BoxPacket {
            low: lanes(|b| b.0),
            high: lanes(|b| b.1),
        });
        for (touched, (min, max)) in touched.iter().zip(boxes) {
            assert_eq!(
                *touched,
                accelerator.touches(min.as_dvec3(), max.as_dvec3())
            );
            counts[usize::from(*touched)] += 1;
        }
    }
    assert!(counts.iter().all(|n| *n > 300), "{counts:?}");
    let inside_out = BoxPacket {
        low: [[f32::INFINITY; LANES]; 3],
        high: [[f32::NEG_INFINITY; LANES]; 3],
    };
    assert_eq!(accelerator.touched(&inside_out), [false; LANES]);
}

#[test]
fn an_empty_set_is_never_hit() {
    let nan = [DVec3::NAN; 3];
    for set in [vec![], vec![nan], vec![nan, [DVec3::INFINITY; 3]]] {
        let accelerator = Accelerator::build(&set);
        assert!(accelerator.bounds().is_none());
        assert!(
            accelerator
                .first_hit_on_chord(&chord(DVec3::ZERO, DVec3::ONE))
                .is_none()
        );
        assert!(!accelerator.touches(DVec3::NEG_INFINITY, DVec3::INFINITY));
        let mut found = vec![7];
        accelerator.candidates(DVec3::NEG_ONE, DVec3::ONE, &mut found);
        assert!(found.is_empty());
    }
}

#[test]
fn what_is_not_finite_or_has_no_size_is_never_met() {
    let good = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let odd = [
        [DVec3::NAN; 3],
        good,
        [DVec3::X; 3],
        [DVec3::ZERO, DVec3::X, DVec3::X * 2.0],
    ];
    let accelerator = Accelerator::build(&odd);
    let down = |a: DVec3| accelerator.first_hit_on_chord(&chord(a + DVec3::Z, a - DVec3::Z));
    assert_eq!(down(DVec3::new(0.2, 0.2, 0.0)).unwrap().triangle, 1);
    assert!(down(DVec3::new(1.5, 0.0, 0.0)).is_none());
    for end in [DVec3::NAN, DVec3::INFINITY, DVec3::ZERO] {
        assert!(
            accelerator
                .first_hit_on_chord(&chord(DVec3::ZERO, end))
                .is_none()
        );
        assert!(
            accelerator
                .first_hit_among(&[0, 1, 2, 3, 99], DVec3::ZERO, end)
                .is_none()
        );
    }
    let all_in_one_point = Accelerator::build(&[[DVec3::X; 3]; 9]);
    assert!(
        all_in_one_point
            .first_hit_on_chord(&chord(DVec3::ZERO, DVec3::X * 2.0))
            .is_none()
    );
    assert!(all_in_one_point.touches(DVec3::ZERO, DVec3::X));
}
