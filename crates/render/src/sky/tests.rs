use super::*;
use crate::lanes::{set_lane, single_lane};

/// A 8 × 4 picture whose pixel at row `r`, column `c` is `[r, c, 1]`.
fn numbered() -> Sky {
    let pixels = Array3::from_shape_fn((4, 8, 3), |(r, c, k)| [r as f32, c as f32, 1.0][k]);
    Sky::from_image("numbered", pixels).unwrap()
}

fn from_angles(longitude: f64, latitude: f64) -> DVec3 {
    let (sin, cos) = latitude.to_radians().sin_cos();
    let (y, x) = longitude.to_radians().sin_cos();
    DVec3::new(x * cos, y * cos, sin)
}

#[test]
fn a_picture_that_is_not_twice_as_wide_as_high_is_told() {
    let warning = |width: usize, height: usize| {
        let sky = Sky::from_image("sky.png", Array3::zeros((height, width, 3))).unwrap();
        sky.warnings().to_vec()
    };
    for (width, height) in [(200, 100), (201, 100), (2048, 1023), (2, 1)] {
        assert_eq!(warning(width, height), [""; 0]);
    }
    for (width, height) in [(200, 200), (100, 200), (400, 100), (192, 108)] {
        let told = &warning(width, height)[0];
        assert!(told.contains("sky.png") && told.contains(&format!("{width}x{height}")));
    }
}

#[test]
fn a_sun_beyond_all_numbers_shines_and_is_told() {
    let mut pixels = Array3::from_elem((100, 200, 3), 0.5_f32);
    for (k, odd) in [f32::INFINITY, f32::NAN, f32::NEG_INFINITY]
        .iter()
        .enumerate()
    {
        pixels
            .slice_mut(ndarray::s![50, 40 * k + 20, ..])
            .fill(*odd);
    }
    let sky = Sky::from_image("sun.exr", pixels).unwrap();
    let told = &sky.warnings()[0];
    assert!(
        told.contains("sun.exr: 3 ") && told.contains(", 6 "),
        "{told}"
    );
    let toward = |column: f64| sky.radiance(from_angles(180.0 - 1.8 * (column + 0.5), -0.9), 0.0);
    assert_eq!(
        [20.0, 60.0, 100.0].map(|c| toward(c)[0] > 1e4),
        [true, false, false]
    );
    assert!(toward(60.0)[0] < 0.5 && toward(100.0)[0] < 0.5);
}

#[test]
fn reductions_keep_the_light_of_the_whole_sphere() {
    // A spot about the zenith, and one beside it.
    for (spot, (height, width)) in [(0, (512, 1024)), (40, (512, 1024)), (3, (101, 203))] {
        let pixels =
            Array3::from_shape_fn((height, width, 3), |(r, ..)| f32::from(u8::from(r == spot)));
        let image = Equirectangular::new("spot", &pixels).unwrap();
        let flux = |level: &Level| {
            let zone = |y: usize| (PI * y as f32 / level.height as f32).cos();
            let light = |y: usize, x: usize| level.pixels[y * level.width + x].x;
            let rows = (0..level.height).flat_map(|y| {
                (0..level.width)
                    .map(move |x| light(y, x) * (zone(y) - zone(y + 1)) / level.width as f32)
            });
            rows.map(f64::from).sum::<f64>()
        };
        let whole = flux(&image.levels[0]);
        for level in &image.levels {
            assert!((flux(level) / whole - 1.0).abs() < 2e-3, "{level:?}");
        }
    }
}

#[test]
fn a_sky_of_paths_that_end_by_their_length_has_one_colour_or_a_warning() {
    let colour = Sky::from(Pattern::Colour([1.0, 0.5, 0.0]));
    let grid = || Some(Sky::from(Pattern::Grid));
    assert_eq!(warnings(&[grid(), None]), [""; 0]);
    assert_eq!(warnings(&[grid(), Some(colour)]), [""; 0]);
    let told = warnings(&[None, grid()]);
    assert!(told.len() == 1 && told[0].contains("`length`"), "{told:?}");
}

#[test]
fn the_middle_is_forward_and_longitude_grows_to_the_left() {
    let sky = numbered();
    // Centre of column c: longitude 180° − 45° (c + ½). Columns 3 and 4 are either side of +x.
    let at = |longitude, latitude| sky.radiance(from_angles(longitude, latitude), 0.0);
    let near = |got: [f32; 3], want: [f32; 3]| {
        assert!(
            (Vec3::from(got) - Vec3::from(want)).length() < 1e-4,
            "{got:?} {want:?}"
        );
    };
    use glam::Vec3;
    near(at(22.5, 22.5), [1.0, 3.0, 1.0]);
    near(at(-22.5, 22.5), [1.0, 4.0, 1.0]);
    near(at(90.0, 67.5), [0.0, 1.5, 1.0]);
    near(at(-90.0, -67.5), [3.0, 5.5, 1.0]);
    // Across the seam at −x the columns 7 and 0 meet.
    near(at(180.0, 0.0), [1.5, 3.5, 1.0]);
    near(at(157.5, 0.0), [1.5, 0.0, 1.0]);
    near(at(-157.5, 0.0), [1.5, 7.0, 1.0]);
}

#[test]
fn a_pole_looks_the_same_from_all_sides() {
    let sky = numbered();
    for pole in [89.999, -89.999] {
        let around: Vec<_> = (0..16)
            .map(|i| sky.radiance(from_angles(f64::from(i) * 22.5, pole), 0.0))
            .collect();
        for (i, value) in around.iter().enumerate() {
            let opposite = around[(i + 8) % 16];
            assert!((value[1] - opposite[1]).abs() < 1e-2, "{around:?}");
        }
        assert!(sky.radiance(DVec3::Z * pole.signum(), 0.0)[0].is_finite());
    }
}

#[test]
fn a_wide_footprint_averages() {
    let mean = numbered().radiance(DVec3::X, 10.0);
    assert!(
        (mean[0] - 1.5).abs() < 1e-5 && (mean[1] - 3.5).abs() < 1.1,
        "{mean:?}"
    );
}

#[test]
fn skies_of_odd_sides_average_too() {
    // Each half of 7 columns has half of the middle one.
    let pixels = Array3::from_shape_fn((5, 7, 3), |(_, x, _)| x as f32);
    let picture = Equirectangular::new("odd", &pixels).unwrap();
    let sizes: Vec<_> = picture.levels.iter().map(|l| (l.width, l.height)).collect();
    assert_eq!(sizes, [(7, 5), (3, 2), (1, 1)]);
    for level in &picture.levels {
        let mean = level.pixels.iter().sum::<Vec3>() / level.pixels.len() as f32;
        assert!((mean - Vec3::splat(3.0)).length() < 1e-5, "{mean}");
    }
}

#[test]
fn skies_answer_every_direction_with_finite_light() {
    let skies = [
        numbered(),
        Pattern::Grid.into(),
        Pattern::Stars.into(),
        Pattern::Colour([1.0; 3]).into(),
    ];
    let odd = [
        DVec3::ZERO,
        DVec3::NAN,
        DVec3::INFINITY,
        DVec3::X * 1e-200,
        DVec3::ONE * 1e200,
    ];
    let axes = [
        DVec3::X,
        DVec3::NEG_X,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::Z,
        DVec3::NEG_Z,
    ];
    let corners = [
        DVec3::ONE,
        DVec3::NEG_ONE,
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(0.0, -1.0, 1.0),
    ];
    for sky in &skies {
        for direction in odd.iter().chain(&axes).chain(&corners) {
            for footprint in [0.0, 1e-3, 1.0, f32::INFINITY, f32::NAN] {
                let light = sky.radiance(*direction, footprint);
                let fine = light.iter().all(|x| x.is_finite() && *x >= 0.0);
                assert!(fine, "{direction} {footprint} {light:?}");
            }
        }
    }
}

#[test]
fn patterns_keep_their_mean_under_any_footprint() {
    let directions: Vec<DVec3> = (0..120_000)
        .map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 120_000.0;
            let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            let across = (1.0 - z * z).sqrt();
            DVec3::new(across * cos, across * sin, z)
        })
        .collect();
    for (pattern, tolerance) in [(Pattern::Grid, 0.05), (Pattern::Stars, 0.1)] {
        let sky = Sky::from(pattern);
        let mean = |footprint| {
            let sum: f64 = directions
                .iter()
                .map(|d| f64::from(sky.radiance(*d, footprint)[1]))
                .sum();
            sum / directions.len() as f64
        };
        let reference = mean(2e-3);
        for footprint in [0.01, 0.05, 0.3] {
            let ratio = mean(footprint) / reference;
            assert!(
                (ratio - 1.0).abs() < tolerance,
                "{pattern:?} {footprint}: {ratio}"
            );
        }
    }
}

/// Sixteen unit vectors around `middle`, and changes of them: round, or `long` times as long along z.
fn around(middle: Vec3, width: f32, long: f32) -> (SingleVectors, Across) {
    let (mut d, mut across) = (SingleVectors::default(), Across::default());
    for l in 0..LANES {
        let (x, y) = ((l % 4) as f32 - 1.5, (l / 4) as f32 - 1.5);
        let here = (middle + 0.01 * Vec3::new(0.3 * x, x, y)).normalize();
        let right = here.cross(Vec3::Z).normalize();
        set_lane(&mut d, l, here);
        set_lane(&mut across[0], l, right * width);
        set_lane(&mut across[1], l, right.cross(here) * width * long);
    }
    (d, across)
}

#[test]
fn sixteen_round_footprints_see_what_each_does() {
    for sky in [
        numbered(),
        Pattern::Grid.into(),
        Pattern::Stars.into(),
        Pattern::Colour([0.2; 3]).into(),
    ] {
        // A mark, a line, Orion.
        for middle in [[1.0, 0.1, 0.02], [0.7, 0.7, 0.3], [0.1, 0.99, 0.0]] {
            let (d, across) = around(middle.into(), 2e-3, 1.0);
            let lights = sky.lights(&d, &across, &[true; LANES]);
            for l in 0..LANES {
                let one = Vec3::from(sky.radiance(single_lane(&d, l).as_dvec3(), 2e-3));
                let off = (single_lane(&lights, l) - one).length();
                assert!(off < 2e-3 * (1.0 + one.length()), "{middle:?} {l}: {off}");
            }
        }
    }
}

#[test]
fn a_long_footprint_sees_the_mean_of_short_ones() {
    // Along meridians, around the crossing of one line beside which it stays sharp with one that it blurs.
    let sky = Sky::Grid;
    let (d, across) = around(Vec3::new(0.612, 0.612, 0.5), 1e-3, 8.0);
    let long = sky.lights(&d, &across, &[true; LANES]);
    for l in 0..LANES {
        let place =
            |i: i32| single_lane(&d, l) + single_lane(&across[1], l) * ((i as f32 - 7.5) / 16.0);
        let short = (0..16).map(|i| Vec3::from(sky.radiance(place(i).as_dvec3(), 1e-3)));
        let mean = short.sum::<Vec3>() / 16.0;
        let off = (single_lane(&long, l) - mean).length();
        assert!(off < 0.02, "{l}: {off} of {mean}");
    }
}

#[test]
fn the_arc_tangent_agrees_with_the_standard_library() {
    for i in -400..=400 {
        let angle = PI * i as f32 / 400.0;
        let (y, x) = angle.sin_cos();
        let (got, want) = (arc_tangent(y, x), y.atan2(x));
        assert!((got - want).abs() < 5e-7, "{angle}: {got} {want}");
    }
    assert_eq!(arc_tangent(0.0, 0.0), 0.0);
    assert_eq!(longitude_latitude(Vec3::Z).1, FRAC_PI_2);
}

#[test]
fn the_axes_carry_their_colours() {
    let sky = Sky::from(Pattern::Grid);
    // A little above each axis, between the sign and the letter.
    let dominant = |d: DVec3, up: DVec3| {
        let light = sky.radiance(d + 0.07 * up, 0.0);
        (0..3)
            .max_by(|a, b| light[*a].total_cmp(&light[*b]))
            .unwrap()
    };
    assert_eq!(dominant(DVec3::X, DVec3::Z), 0);
    assert_eq!(dominant(DVec3::Y, DVec3::Z), 1);
    assert_eq!(dominant(DVec3::Z, DVec3::NEG_X), 2);
}
