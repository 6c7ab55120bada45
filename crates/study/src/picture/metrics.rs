//! Measures of how far two pictures are apart.
//!
//! In: a reference and a test picture of one size. Out: the peak signal to noise ratio ([`psnr`]), and
//! [`flip`]: the difference that a viewer sees when the two pictures alternate, for every pixel.
//!
//! FLIP is that of Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "FLIP: A
//! Difference Evaluator for Alternating Images", HPG 2020; the constants are of that paper.
//! Values are clamped to [0, 1] in linear light first (the paper's variant for ordinary screens).
//! All filters are separable: a row pass and a column pass, with the border pixels repeated.

use geofan_core::error::{Error, Result};
use geofan_render::picture::{Picture, displayable, srgb_shown};
use ndarray::{Array2, Axis, Zip};
use rayon::prelude::*;
use std::f32::consts::{FRAC_1_SQRT_2, PI};

/// Computes the peak signal to noise ratio in decibel of what a screen shows: `-10 log10` of the mean
/// squared difference of all sRGB code values in [0, 1]; infinite for pictures that look the same.
///
/// # Errors
/// The pictures differ in size.
pub fn psnr(a: &Picture, b: &Picture) -> Result<f64> {
    check_same_size(a, b)?;
    let squared = |(&a, &b): (&f32, &f32)| {
        let difference = f64::from(srgb_shown(a)) - f64::from(srgb_shown(b));
        difference * difference
    };
    let sum: f64 = a.rgb.iter().zip(&b.rgb).map(squared).sum();
    if sum == 0.0 {
        return Ok(f64::INFINITY);
    }
    Ok(-10.0 * (sum / a.rgb.len() as f64).log10())
}

/// Refuses to compare pictures of different sizes.
fn check_same_size(a: &Picture, b: &Picture) -> Result<()> {
    if a.rgb.dim() == b.rgb.dim() {
        return Ok(());
    }
    let size = |picture: &Picture| format!("{}x{}", picture.width(), picture.height());
    let message = format!("{} and {} pixels cannot be compared", size(a), size(b));
    Err(Error::input("pictures of different sizes", message))
}

/// A 0.7 m wide screen of 3840 pixels seen from 0.7 m, the paper's choice.
pub const DEFAULT_PIXELS_PER_DEGREE: f32 = 67.020_645;

/// Exponent q_c of the colour difference.
const COLOUR_EXPONENT: f32 = 0.7;
/// Share p_c of the largest colour difference that is mapped to p_t of the range.
const COLOUR_KNEE: f32 = 0.4;
/// See [`COLOUR_KNEE`].
const COLOUR_KNEE_VALUE: f32 = 0.95;
/// Exponent q_f of the feature difference.
const FEATURE_EXPONENT: f32 = 0.5;
/// Width w of an edge or point that is noticed, degrees.
const FEATURE_WIDTH: f32 = 0.082;

/// The white of D65 in XYZ.
const WHITE: [f32; 3] = [0.950_428_55, 1.0, 1.088_900_4];
/// Linear Rec.709 to XYZ.
const TO_XYZ: [[f32; 3]; 3] = [
    [0.412_386_56, 0.357_591_5, 0.180_450_49],
    [0.212_636_8, 0.715_183, 0.072_180_2],
    [0.019_330_62, 0.119_197_16, 0.950_372_6],
];
/// The inverse of [`TO_XYZ`].
const FROM_XYZ: [[f32; 3]; 3] = [
    [3.241_003_3, -1.537_398_9, -0.498_615_86],
    [-0.969_224_33, 1.875_930_1, 0.041_554_224],
    [0.055_639_423, -0.204_011_2, 1.057_148_9],
];

/// Computes the visible difference of `test` from `reference` at every pixel, (height, width), from 0
/// (no difference seen) to 1. `pixels_per_degree` says how many pixels span a degree of the viewer's
/// sight; [`DEFAULT_PIXELS_PER_DEGREE`] suits most uses.
///
/// # Errors
/// The pictures differ in size, or `pixels_per_degree` is not a positive number.
pub fn flip(reference: &Picture, test: &Picture, pixels_per_degree: f32) -> Result<Array2<f32>> {
    check_same_size(reference, test)?;
    if !(pixels_per_degree.is_finite() && pixels_per_degree > 0.0) {
        let message = format!("{pixels_per_degree} is not a positive number");
        return Err(Error::input("pixels per degree", message));
    }
    let (reference, test) = (opponent_planes(reference), opponent_planes(test));
    let mut map = colour_difference(&reference, &test, pixels_per_degree);
    let features = feature_difference(&reference[0], &test[0], pixels_per_degree);
    // A difference in features makes a difference in colour more visible.
    Zip::from(&mut map)
        .and(&features)
        .for_each(|colour, &feature| *colour = colour.powf(1.0 - feature));
    Ok(map)
}

/// Computes the mean of a map of [`flip`], the one number that the authors recommend.
pub fn mean_flip(map: &Array2<f32>) -> f64 {
    let sum: f64 = map.iter().map(|&value| f64::from(value)).sum();
    sum / map.len().max(1) as f64
}

/// Splits a picture into luminance, red-green and blue-yellow (YCxCz) as three planes.
fn opponent_planes(picture: &Picture) -> [Array2<f32>; 3] {
    [0, 1, 2].map(|channel| {
        picture.rgb.map_axis(Axis(2), |pixel| {
            let rgb = [0, 1, 2].map(|i| displayable(pixel[i]));
            opponent_from_linear(rgb)[channel]
        })
    })
}

/// Converts linear light to YCxCz.
fn opponent_from_linear(rgb: [f32; 3]) -> [f32; 3] {
    let xyz = multiply(&TO_XYZ, rgb);
    let [x, y, z] = [0, 1, 2].map(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Converts YCxCz to linear light; undoes [`opponent_from_linear`].
fn linear_from_opponent([luminance, red_green, blue_yellow]: [f32; 3]) -> [f32; 3] {
    let y = (luminance + 16.0) / 116.0;
    let relative = [y + red_green / 500.0, y, y - blue_yellow / 200.0];
    multiply(&FROM_XYZ, [0, 1, 2].map(|i| relative[i] * WHITE[i]))
}

fn multiply(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Converts linear light to CIELAB, with chroma made to fade in the dark (the Hunt effect).
fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const KNEE: f32 = 6.0 / 29.0;
    let xyz = multiply(&TO_XYZ, rgb);
    let [x, y, z] = [0, 1, 2].map(|i| {
        let t = xyz[i] / WHITE[i];
        if t > KNEE * KNEE * KNEE {
            t.cbrt()
        } else {
            t / (3.0 * KNEE * KNEE) + 4.0 / 29.0
        }
    });
    let lightness = 116.0 * y - 16.0;
    let fade = 0.01 * lightness;
    [lightness, fade * 500.0 * (x - y), fade * 200.0 * (y - z)]
}

/// Computes the HyAB distance to the power q_c: city block in lightness, Euclidean in chroma.
fn lab_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let chroma = (a[1] - b[1]).hypot(a[2] - b[2]);
    ((a[0] - b[0]).abs() + chroma).powf(COLOUR_EXPONENT)
}

/// Runs the colour pipeline: blurs as the eye does, then maps a distance to [0, 1].
fn colour_difference(
    reference: &[Array2<f32>; 3],
    test: &[Array2<f32>; 3],
    pixels_per_degree: f32,
) -> Array2<f32> {
    let largest = lab_distance(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0]));
    let knee = COLOUR_KNEE * largest;
    let reference = seen_colours(reference, pixels_per_degree);
    let test = seen_colours(test, pixels_per_degree);
    Zip::from(&reference).and(&test).map_collect(|&a, &b| {
        let distance = lab_distance(a, b);
        if distance < knee {
            return distance * COLOUR_KNEE_VALUE / knee;
        }
        let beyond = (distance - knee) / (largest - knee);
        COLOUR_KNEE_VALUE + beyond * (1.0 - COLOUR_KNEE_VALUE)
    })
}

/// Computes the colours that reach the viewer, as CIELAB: each opponent plane blurred by its contrast
/// sensitivity, then brought back inside the range of a screen.
fn seen_colours(planes: &[Array2<f32>; 3], pixels_per_degree: f32) -> Array2<[f32; 3]> {
    let [luminance, red_green, blue_yellow] = sensitivity_kernels(pixels_per_degree);
    let luminance = blur(&planes[0], &luminance[0]);
    let red_green = blur(&planes[1], &red_green[0]);
    // A sum of two Gaussians is not separable, but each of the two is.
    let narrow = blur(&planes[2], &blue_yellow[0]);
    let blue_yellow = narrow + blur(&planes[2], &blue_yellow[1]);
    by_rows(luminance.dim(), |y, row| {
        row.extend((0..luminance.ncols()).map(|x| {
            let opponent = [&luminance, &red_green, &blue_yellow].map(|plane| plane[(y, x)]);
            hunt_lab(linear_from_opponent(opponent).map(displayable))
        }));
    })
}

/// The contrast sensitivities as sums of Gaussians, (weight a, width b) per term, for luminance,
/// red-green and blue-yellow.
const SENSITIVITY: [&[(f32, f32)]; 3] = [
    &[(1.0, 0.0047)],
    &[(1.0, 0.0053)],
    &[(34.1, 0.04), (13.5, 0.025)],
];

/// Computes for every plane the row kernels of its terms. A term's two-dimensional kernel is the product of
/// its row kernel with itself, and all terms of a plane together sum to 1 over the square.
fn sensitivity_kernels(pixels_per_degree: f32) -> [Vec<Vec<f32>>; 3] {
    let widest = (SENSITIVITY.iter().copied().flatten()).fold(0.0_f32, |m, term| m.max(term.1));
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
    SENSITIVITY.map(|terms| {
        let mut kernels: Vec<Vec<f32>> = (terms.iter())
            .map(|&(a, b)| {
                let weight = (a * (PI / b).sqrt()).sqrt();
                let at = |i: i32| weight * (-(PI * i as f32 / pixels_per_degree).powi(2) / b).exp();
                (-radius..=radius).map(at).collect()
            })
            .collect();
        let sum = |kernel: &Vec<f32>| kernel.iter().sum::<f32>().powi(2);
        let total: f32 = kernels.iter().map(sum).sum();
        let scale = total.sqrt().recip();
        for weight in kernels.iter_mut().flatten() {
            *weight *= scale;
        }
        kernels
    })
}

/// Runs the feature pipeline: computes how differently edges and points show, 0 to 1.
fn feature_difference(
    reference: &Array2<f32>,
    test: &Array2<f32>,
    pixels_per_degree: f32,
) -> Array2<f32> {
    let kernels = feature_kernels(pixels_per_degree);
    let (reference, test) = (features(reference, &kernels), features(test, &kernels));
    Zip::from(&reference).and(&test).map_collect(|a, b| {
        let difference = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        (FRAC_1_SQRT_2 * difference).powf(FEATURE_EXPONENT)
    })
}

/// Samples a Gaussian (which smooths) and its first and second derivative (which find edges and
/// points).
fn feature_kernels(pixels_per_degree: f32) -> [Vec<f32>; 3] {
    let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
    let radius = (3.0 * deviation).ceil() as i32;
    let kernel = |derivative: fn(f32) -> f32| {
        let at = |i: i32| {
            let x = i as f32 / deviation;
            derivative(x) * (-0.5 * x * x).exp()
        };
        normalised((-radius..=radius).map(at).collect())
    };
    [kernel(|_| 1.0), kernel(|x| -x), kernel(|x| x * x - 1.0)]
}

/// Scales positive weights to sum to 1 and negative ones to -1.
fn normalised(kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().map(|weight| weight.max(0.0)).sum();
    let negative: f32 = kernel.iter().map(|weight| (-weight).max(0.0)).sum();
    let scale = |w: f32| {
        if w > 0.0 {
            w / positive
        } else {
            w / negative.max(f32::MIN_POSITIVE)
        }
    };
    kernel.into_iter().map(scale).collect()
}

/// Computes the strength of edges and of points at every pixel of a luminance plane.
fn features(luminance: &Array2<f32>, kernels: &[Vec<f32>; 3]) -> Array2<[f32; 2]> {
    let [smooth, edge, point] = kernels;
    let unit = luminance.mapv(|y| (y + 16.0) / 116.0);
    let rows_smooth = filter_rows(&unit, smooth);
    let strength = |kernel: &[f32]| {
        let along_rows = filter_columns(&filter_rows(&unit, kernel), smooth);
        let along_columns = filter_columns(&rows_smooth, kernel);
        Zip::from(&along_rows)
            .and(&along_columns)
            .map_collect(|x, y| x.hypot(*y))
    };
    Zip::from(&strength(edge))
        .and(&strength(point))
        .map_collect(|&edge, &point| [edge, point])
}

/// Filters a plane with the product of `kernel` with itself.
fn blur(plane: &Array2<f32>, kernel: &[f32]) -> Array2<f32> {
    filter_columns(&filter_rows(plane, kernel), kernel)
}

/// Filters every row, its first and last pixel repeated beyond the border.
fn filter_rows(plane: &Array2<f32>, kernel: &[f32]) -> Array2<f32> {
    let (width, radius) = (plane.ncols(), kernel.len() / 2);
    by_rows(plane.dim(), |y, row| {
        let inside = |x: usize| x.saturating_sub(radius).min(width - 1);
        let padded: Vec<f32> = (0..width + 2 * radius)
            .map(|x| plane[(y, inside(x))])
            .collect();
        row.resize(width, 0.0);
        for (offset, weight) in kernel.iter().enumerate() {
            for (sum, value) in row.iter_mut().zip(&padded[offset..]) {
                *sum += weight * value;
            }
        }
    })
}

/// Filters every column, its first and last pixel repeated beyond the border.
fn filter_columns(plane: &Array2<f32>, kernel: &[f32]) -> Array2<f32> {
    let (height, radius) = (plane.nrows(), kernel.len() / 2);
    by_rows(plane.dim(), |y, row| {
        row.resize(plane.ncols(), 0.0);
        for (offset, weight) in kernel.iter().enumerate() {
            let source = (y + offset).saturating_sub(radius).min(height - 1);
            for (sum, value) in row.iter_mut().zip(plane.row(source)) {
                *sum += weight * value;
            }
        }
    })
}

/// Makes an array whose row `y` is what `fill(y, row)` puts into the empty `row`, rows in parallel.
fn by_rows<T: Send>(dim: (usize, usize), fill: impl Fn(usize, &mut Vec<T>) + Sync) -> Array2<T> {
    let rows = (0..dim.0).into_par_iter().flat_map_iter(|y| {
        let mut row = Vec::with_capacity(dim.1);
        fill(y, &mut row);
        row
    });
    Array2::from_shape_vec(dim, rows.collect()).expect("fill makes rows of the width in `dim`")
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_render::picture::srgb_decode;

    fn grey(code: f32) -> Picture {
        Picture::filled(7, 5, [srgb_decode(code); 3])
    }

    #[test]
    fn a_tenth_of_the_range_everywhere_is_twenty_decibel() {
        let ratio = psnr(&grey(0.5), &grey(0.6)).unwrap();
        approx::assert_abs_diff_eq!(ratio, 20.0, epsilon = 1e-4);
        let one_way = psnr(&grey(0.2), &grey(0.9)).unwrap();
        assert_eq!(one_way, psnr(&grey(0.9), &grey(0.2)).unwrap());
    }

    #[test]
    fn pictures_that_look_the_same_are_infinitely_close() {
        assert_eq!(psnr(&grey(0.5), &grey(0.5)).unwrap(), f64::INFINITY);
        let (white, sun) = (
            Picture::filled(2, 2, [1.0; 3]),
            Picture::filled(2, 2, [9.0; 3]),
        );
        assert_eq!(psnr(&white, &sun).unwrap(), f64::INFINITY);
    }

    #[test]
    fn pictures_of_different_sizes_are_refused() {
        let failure = psnr(&grey(0.5), &Picture::filled(7, 6, [0.0; 3])).unwrap_err();
        assert!(failure.to_string().contains("7x5 and 7x6"), "{failure}");
    }

    /// Code values of a picture with edges, points, gradients and saturated colours, and of a copy
    /// with noise, a shifted edge and a colour cast.
    fn synthetic_pair(width: usize, height: usize) -> [Vec<u8>; 2] {
        let mut state = 1_u32;
        let mut noise = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as i32
        };
        let mut pair = [Vec::new(), Vec::new()];
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let square = |shift: usize| ((x + shift) / 16 + y / 12) % 2 * 120;
            let colour = |shift| [square(shift) + x, 2 * y, 255 - square(shift) - y];
            let clean = colour(0).map(|code| code.min(255) as u8);
            let grain = if x > width / 2 { noise() / 6 } else { 0 };
            let cast = [10, -10, 25 * i32::from(y > height / 2)];
            let changed = colour(usize::from(y % 40 < 20));
            let changed = [0, 1, 2].map(|i| (changed[i] as i32 + grain + cast[i]).clamp(0, 255));
            pair[0].extend(clean);
            pair[1].extend(changed.map(|code| code as u8));
        }
        pair
    }

    fn picture(width: usize, height: usize, codes: &[u8]) -> Picture {
        Picture::from_fn(width, height, |x, y| {
            [0, 1, 2].map(|i| srgb_decode(f32::from(codes[3 * (y * width + x) + i]) / 255.0))
        })
    }

    #[test]
    fn map_and_mean_agree_with_the_authors_implementation() {
        let (width, height) = (112, 80);
        let [a, b] = synthetic_pair(width, height);
        for pixels_per_degree in [DEFAULT_PIXELS_PER_DEGREE, 30.0] {
            let theirs =
                |codes| nv_flip::FlipImageRgb8::with_data(width as u32, height as u32, codes);
            let expected = nv_flip::flip(theirs(&a), theirs(&b), pixels_per_degree).to_vec();
            let [reference, test] = [&a, &b].map(|codes| picture(width, height, codes));
            let found = flip(&reference, &test, pixels_per_degree).unwrap();
            let total: f64 = expected.iter().map(|&value| f64::from(value)).sum();
            let mean = total / expected.len() as f64;
            assert!(mean > 0.1, "the pair is too alike to tell anything: {mean}");
            let found_mean = mean_flip(&found);
            assert!((found_mean - mean).abs() < 1e-3, "{found_mean} {mean}");
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-2, "{found} {expected}");
            }
        }
    }

    #[test]
    fn equal_pictures_differ_nowhere_and_black_from_white_fully() {
        let [black, white] = [0.0, 1.0].map(|v| Picture::filled(20, 10, [v; 3]));
        let same = flip(&white, &white, DEFAULT_PIXELS_PER_DEGREE).unwrap();
        assert_eq!((mean_flip(&same), same.sum()), (0.0, 0.0));
        let opposite = flip(&black, &white, DEFAULT_PIXELS_PER_DEGREE).unwrap();
        assert!(mean_flip(&opposite) > 0.95, "{opposite}");
    }

    #[test]
    fn opponent_colours_and_linear_light_undo_each_other() {
        for rgb in [[0.0, 0.0, 0.0], [1.0, 0.5, 0.25], [0.1, 0.9, 0.3]] {
            let back = linear_from_opponent(opponent_from_linear(rgb));
            for (a, b) in rgb.into_iter().zip(back) {
                approx::assert_abs_diff_eq!(a, b, epsilon = 1e-5);
            }
        }
    }

    #[test]
    fn broken_values_and_sizes_never_panic() {
        let broken = Picture::filled(3, 2, [f32::NAN, f32::INFINITY, -1.0]);
        let found = flip(&broken, &broken, DEFAULT_PIXELS_PER_DEGREE).unwrap();
        assert_eq!(mean_flip(&found), 0.0);
        let empty = Picture::filled(0, 0, [0.0; 3]);
        assert_eq!(mean_flip(&flip(&empty, &empty, 67.0).unwrap()), 0.0);
        assert!(flip(&broken, &empty, 67.0).is_err());
        assert!(flip(&broken, &broken, 0.0).is_err());
    }
}
