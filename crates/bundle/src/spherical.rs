//! Functions on the whole sphere of directions as sums of sines and cosines.
//!
//! A function on the sphere, of the azimuth φ and the polar angle θ, goes over each pole to the opposite
//! meridian: `f(−θ, φ + π) = f(θ, φ)`. Its terms are therefore `cos kθ` with `cos mφ`, `sin mφ` for
//! even m, and `sin (k+1)θ` for odd m. They resolve the sphere evenly and it has no edges: six faces
//! with Chebyshev polynomials take several times the coefficients. Source: A. Townsend, H. Wilber,
//! G. B. Wright, *Computing with functions in spherical and polar geometries I. The sphere*, SIAM J.
//! Sci. Comput. 38 (2016).
//!
//! In: samples at the grid of [`azimuths`] × [`polar_angles`]. Out: coefficients ([`coefficients`]), and
//! the values of the terms ([`azimuth_values`], [`polar_values`]). Parameters are those of
//! [`Sphere`](crate::rays::Sphere), in [−1, 1].

use crate::{chebyshev, matrix::product};
use geofan_core::parallel::*;
use geofan_expr::real::Real;
use ndarray::{Array2, ArrayD};
use std::f64::consts::{FRAC_PI_2, PI};

/// Tells whether the term number `i` of the azimuth is one of an odd multiple of φ: the polar angle then
/// enters by sines.
pub fn is_odd(i: usize) -> bool {
    i.div_ceil(2) % 2 == 1
}

/// Returns `n` azimuth parameters, evenly spaced around the circle.
pub fn azimuths(n: usize) -> Vec<f64> {
    (0..n).map(|j| 2.0 * j as f64 / n as f64 - 1.0).collect()
}

/// Returns `n` polar parameters, evenly spaced from pole to pole.
pub fn polar_angles(n: usize) -> Vec<f64> {
    (0..n)
        .map(|j| (2 * j + 1) as f64 / n as f64 - 1.0)
        .collect()
}

/// Writes 1, cos φ, sin φ, cos 2φ, … at the azimuth parameter `a` into `values`.
pub fn azimuth_values(a: f64, values: &mut [f64]) {
    let (sin, cos) = (Real::sin(PI * a), Real::cos(PI * a));
    let mut power = (1.0, 0.0);
    for (i, value) in values.iter_mut().enumerate() {
        if i % 2 == 1 {
            power = complex_product(power, (cos, sin));
        }
        *value = if i % 2 == 1 || i == 0 {
            power.0
        } else {
            power.1
        };
    }
}

/// Writes these with zeros for odd multiples of φ, or, if `odd`, for even ones.
pub fn azimuth_values_of(odd: bool, a: f64, values: &mut [f64]) {
    azimuth_values(a, values);
    let others = (0..values.len()).filter(|i| is_odd(*i) != odd);
    others.for_each(|i| values[i] = 0.0);
}

/// Writes the terms of the polar parameter `b` into `values`: sines if `odd`, else cosines.
pub fn polar_values(b: f64, odd: bool, values: &mut [f64]) {
    let theta = FRAC_PI_2 * (b + 1.0);
    let (sin, cos) = (Real::sin(theta), Real::cos(theta));
    let mut power = (1.0, 0.0);
    for value in values {
        let next = complex_product(power, (cos, sin));
        *value = if odd { next.1 } else { power.0 };
        power = next;
    }
}

/// Multiplies two complex numbers.
fn complex_product(z: (f64, f64), w: (f64, f64)) -> (f64, f64) {
    (z.0 * w.0 - z.1 * w.1, z.0 * w.1 + z.1 * w.0)
}

/// Inverts a matrix with orthogonal columns.
fn inverse(matrix: &Array2<f64>) -> Array2<f64> {
    let squares: Vec<f64> = matrix.columns().into_iter().map(|c| c.dot(&c)).collect();
    Array2::from_shape_fn(matrix.dim(), |(k, i)| matrix[[i, k]] / squares[k])
}

/// Returns the matrix that takes coefficients of an odd number of azimuth terms to samples, and its inverse.
pub fn azimuth_transforms(n: usize) -> [Array2<f64>; 2] {
    let values = chebyshev::at_nodes(&azimuths(n), azimuth_values);
    let inverse = inverse(&values);
    [values, inverse]
}

/// Returns these matrices for polar terms, of `odd` multiples of the azimuth or of others.
pub fn polar_transforms(n: usize, odd: bool) -> [Array2<f64>; 2] {
    let values = chebyshev::at_nodes(&polar_angles(n), |b, values| polar_values(b, odd, values));
    let inverse = inverse(&values);
    [values, inverse]
}

/// Transforms samples (…, azimuth, polar angle, …) to coefficients; the azimuth is `axis`, of odd length.
pub fn coefficients(samples: &mut ArrayD<f64>, axis: usize) {
    let shape = samples.shape().to_vec();
    let (azimuths, polar) = (shape[axis], shape[axis + 1]);
    chebyshev::along_axis(samples, axis, &azimuth_transforms(azimuths)[1]);
    let matrices = [false, true].map(|odd| {
        let [_, inverse] = polar_transforms(polar, odd);
        inverse.into_raw_vec_and_offset().0
    });
    let block: usize = shape[axis + 1..].iter().product();
    let values = samples.as_slice_mut().expect("standard layout");
    let blocks = values.par_chunks_exact_mut(block).enumerate();
    blocks.for_each(|(i, block)| {
        let matrix = &matrices[usize::from(is_odd(i % azimuths))];
        block.copy_from_slice(&product(matrix, polar, block));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::Sphere;
    use glam::{DMat3, DVec3};
    use ndarray::IxDyn;

    /// A polynomial of the vector, of degree 5.
    fn function(d: DVec3) -> f64 {
        1.0 + d.x - 2.0 * d.y * d.z + d.x * d.y * d.y + 3.0 * d.z.powi(4) - d.x.powi(3) * d.y * d.z
    }

    #[test]
    fn polynomials_on_the_sphere_come_back_everywhere() {
        let sphere = Sphere::new(DMat3::IDENTITY);
        let (m, n) = (11, 6);
        let (azimuth, polar) = (azimuths(m), polar_angles(n));
        let mut found = ArrayD::from_shape_fn(IxDyn(&[2, m, n, 1]), |i| {
            let d = sphere.direction([azimuth[i[1]], polar[i[2]]]);
            function(d) * (1.0 + i[0] as f64)
        });
        coefficients(&mut found, 1);
        for d in [
            DVec3::Z,
            DVec3::NEG_Z,
            DVec3::new(-1.0, 1e-9, 0.2),
            DVec3::new(0.3, -0.8, -0.4),
        ] {
            let d = d.normalize();
            let [a, b] = sphere.parameters(d);
            let mut along = vec![0.0; m];
            azimuth_values(a, &mut along);
            let polar = [false, true].map(|odd| {
                let mut values = vec![0.0; n];
                polar_values(b, odd, &mut values);
                values
            });
            for which in 0..2 {
                let mut sum = 0.0;
                for i in 0..m {
                    for j in 0..n {
                        let term = along[i] * polar[usize::from(is_odd(i))][j];
                        sum += term * found[[which, i, j, 0]];
                    }
                }
                assert!((sum - function(d) * (1.0 + which as f64)).abs() < 1e-12);
            }
        }
    }
}
