//! A polynomial of several variables, fitted to samples, and the variables of a patch.
//!
//! In: samples of a patch at the nodes of its axes, camera…, direction…, arc length, channel. Out:
//! coefficients ([`Polynomial`]), and their sums at parameters of rays in [−1, 1]. Parameters enter as
//! [`Variables`] say: by Chebyshev polynomials of a mapped variable, or, where directions are the whole
//! sphere, by sines and cosines.

use crate::{
    chebyshev::{self, MappedChebyshev},
    matrix::{added, product, summed},
    spherical,
};
use geofan_core::parallel::*;
use geofan_expr::real::Real;
use ndarray::{Array2, ArrayD, Axis, s};

/// Coefficients of the first axes that are summed at once for many points; fewer leave larger
/// remainders to each point, more are copied to no avail.
const SUMMED_AT_ONCE: usize = 128;

/// Columns that are copied together, so that they lie in a cache while all points read them.
const TILE: usize = 128;

/// A polynomial of one group of channels.
#[derive(Debug, Clone)]
pub struct Polynomial {
    /// Coefficients in standard layout: axes camera…, direction…, arc length, channel.
    pub coefficients: ArrayD<f64>,
    /// The variables of cameras and directions.
    pub variables: Variables,
}

impl Polynomial {
    /// Fits samples with the same axes at the tensor grid of [`Variables::places`], along the arc length of
    /// Chebyshev nodes; the first `starts` there are not at nodes but stay beside the coefficients.
    pub fn fit(mut samples: ArrayD<f64>, starts: usize, variables: Variables) -> Self {
        let arc = samples.ndim() - 2;
        let slopes = samples.len_of(Axis(arc)) - starts;
        // Along the arc length, past what is not at nodes.
        let mut along_arc = Array2::eye(starts + slopes);
        let mut nodes = along_arc.slice_mut(s![starts.., starts..]);
        nodes.assign(&chebyshev::transform(slopes));
        chebyshev::along_axis(&mut samples, arc, &along_arc);
        // Along the directions of the sphere, then along all other axes.
        let plain = match variables.sphere {
            true => {
                spherical::coefficients(&mut samples, variables.cameras);
                variables.cameras
            }
            false => arc,
        };
        Self {
            coefficients: chebyshev::coefficients(samples, plain),
            variables,
        }
    }

    /// Computes along each axis but the channels the root of the sum of squares of the coefficients of each
    /// degree.
    pub fn spectra(&self) -> Vec<Vec<f64>> {
        let shape = self.coefficients.shape();
        let values = self.coefficients.as_slice().unwrap_or_default();
        let mut spectra: Vec<Vec<f64>> = shape.iter().map(|n| vec![0.0; *n]).collect();
        // Sums over the axes behind are summed further: every axis reads what the one behind left.
        let mut squares: Vec<f64> = values
            .par_chunks(shape[shape.len() - 1])
            .map(|channels| channels.iter().map(|c| c * c).sum())
            .collect();
        spectra.pop();
        for (axis, spectrum) in spectra.iter_mut().enumerate().rev() {
            let n = shape[axis];
            for row in squares.chunks_exact(n) {
                spectrum.iter_mut().zip(row).for_each(|(s, x)| *s += x);
            }
            squares = squares
                .chunks_exact(n)
                .map(|row| row.iter().sum())
                .collect();
        }
        spectra.iter_mut().flatten().for_each(|s| *s = s.sqrt());
        spectra
    }

    /// Evaluates at each of `points` (parameters in [−1, 1] of all axes but the last two): rows of
    /// coefficients over (arc length, channel).
    pub fn at(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        let shape = self.coefficients.shape();
        let inputs = shape.len() - 2;
        let enough = |axes: &usize| shape[..*axes].iter().product::<usize>() >= SUMMED_AT_ONCE;
        let first = (1..inputs).find(enough).unwrap_or(inputs);
        let sets = points.iter().map(|x| self.variables.weights(shape, x));
        let sets: Vec<Vec<TermWeights<f64>>> = sets.collect();
        // Cameras have the same weights in all sets.
        let sums = match first <= self.variables.cameras {
            true => 1,
            false => sets.first().map_or(1, Vec::len),
        };
        let sums: Vec<Vec<f64>> = (0..sums)
            .map(|set| self.first_sums(&sets, set, first))
            .collect();
        let width = self.coefficients.len() / shape[..first].iter().product::<usize>();
        let point = |(point, sets): (usize, &Vec<TermWeights<f64>>)| {
            let all = sets.iter().enumerate().map(|(set, weights)| {
                let mut sums = sums[set % sums.len()][point * width..][..width].to_vec();
                for w in &weights[first..] {
                    sums = summed(&sums, 1, sums.len() / w.len(), w);
                }
                sums
            });
            added(&all.collect::<Vec<_>>())
        };
        sets.par_iter().enumerate().map(point).collect()
    }

    /// Sums over the `first` axes with the weights number `set` of each point.
    fn first_sums(&self, sets: &[Vec<TermWeights<f64>>], set: usize, first: usize) -> Vec<f64> {
        let rows = sets.iter().map(|sets| products(&sets[set][..first]));
        let rows: Vec<Vec<f64>> = rows.collect();
        let count = rows.first().map_or(0, Vec::len);
        // A set for even or odd multiples of the azimuth has no others.
        let used = (0..count).filter(|i| rows.iter().any(|row| row[*i] != 0.0));
        let used: Vec<usize> = used.collect();
        if used.is_empty() {
            let width = self.coefficients.len() / count.max(1);
            return vec![0.0; rows.len() * width];
        }
        let weights = rows.iter().flat_map(|row| used.iter().map(|i| row[*i]));
        self.weighted(&weights.collect::<Vec<_>>(), &used, count)
    }

    /// Multiplies `weights` with the rows `used` of the coefficients as a matrix of `count` rows.
    fn weighted(&self, weights: &[f64], used: &[usize], count: usize) -> Vec<f64> {
        let values = self.coefficients.as_slice().unwrap_or_default();
        let width = values.len() / count.max(1);
        // A tile of columns at a time: the rows that are used, copied side by side.
        let tile = |tile: usize| {
            let columns = tile * TILE..width.min((tile + 1) * TILE);
            let mut copied = Vec::with_capacity(used.len() * columns.len());
            for row in used {
                copied.extend_from_slice(&values[row * width..][columns.clone()]);
            }
            product(weights, used.len(), &copied)
        };
        let tiles: Vec<Vec<f64>> = (0..width.div_ceil(TILE))
            .into_par_iter()
            .map(tile)
            .collect();
        // Tiles side by side.
        let mut sums = vec![0.0; weights.len() / used.len().max(1) * width];
        for (row, sums) in sums.chunks_exact_mut(width).enumerate() {
            for (to, tile) in sums.chunks_mut(TILE).zip(&tiles) {
                to.copy_from_slice(&tile[row * to.len()..][..to.len()]);
            }
        }
        sums
    }

    /// Evaluates at the nodes of the ray axes; still coefficients along the arc length. On the sphere those of
    /// odd multiples of the azimuth are sums of other terms of the polar angle than their own: ranks are the
    /// same.
    pub fn samples(&self) -> ArrayD<f64> {
        let (samples, arc) = (self.coefficients.clone(), self.coefficients.ndim() - 2);
        if !self.variables.sphere {
            return chebyshev::samples(samples, arc);
        }
        let mut samples = chebyshev::samples(samples, self.variables.cameras);
        let [azimuth, polar] = [arc - 2, arc - 1];
        let [values, _] = spherical::azimuth_transforms(samples.len_of(Axis(azimuth)));
        chebyshev::along_axis(&mut samples, azimuth, &values);
        let [values, _] = spherical::polar_transforms(samples.len_of(Axis(polar)), false);
        chebyshev::along_axis(&mut samples, polar, &values);
        samples
    }

    /// Tells whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        self.coefficients.iter().all(|c| c.is_finite())
    }
}

/// Multiplies one of each of `values`, in all combinations, the last running fastest.
fn products(values: &[Vec<f64>]) -> Vec<f64> {
    values.iter().fold(vec![1.0], |products, values| {
        let each = |p: &f64| values.iter().map(|v| p * v).collect::<Vec<f64>>();
        products.iter().flat_map(each).collect()
    })
}

/// The variables of a patch over (camera…, direction…).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variables {
    /// Camera axes.
    pub cameras: usize,
    /// The map of the parameters of cameras and of faces of directions.
    pub mapping: MappedChebyshev,
    /// The directions are the whole sphere (azimuth and polar angle, see [`spherical`]), not a face or a part
    /// of one.
    pub sphere: bool,
}

/// Values of the terms along each of the first axes.
pub(crate) type TermWeights<T> = Vec<Vec<T>>;

impl Variables {
    /// Returns the variables of a face of directions, or a part of one.
    pub const fn of_face(cameras: usize, mapping: MappedChebyshev) -> Self {
        Self {
            cameras,
            mapping,
            sphere: false,
        }
    }

    /// Computes the values of the terms along the first axes of `shape` at `parameters` in [−1, 1], one for
    /// each of those axes. Coefficients are to be summed with each of the sets of weights: on the sphere
    /// there are two, for even and odd multiples of the azimuth.
    pub(crate) fn weights<T: Real>(
        self,
        shape: &[usize],
        parameters: &[f64],
    ) -> Vec<TermWeights<T>> {
        let count = match self.sphere {
            true => parameters.len().min(self.cameras),
            false => parameters.len(),
        };
        // Chebyshev polynomials of mapped variables.
        let along = |(x, n): (&f64, &usize)| {
            let mut values = vec![0.0; *n];
            chebyshev::values(self.mapping.variable(*x), &mut values);
            values.into_iter().map(T::from_f64).collect()
        };
        let plain: TermWeights<T> = parameters[..count].iter().zip(shape).map(along).collect();
        let [Some(a), Some(b)] = [0, 1].map(|k| parameters.get(count + k)) else {
            return vec![plain];
        };
        // On the sphere sines and cosines, in two sets.
        let sets = [false, true].map(|odd| {
            let [mut azimuth, mut polar] = [0, 1].map(|k| vec![0.0; shape[count + k]]);
            spherical::azimuth_values_of(odd, *a, &mut azimuth);
            spherical::polar_values(*b, odd, &mut polar);
            let mut weights = plain.clone();
            weights.extend([azimuth, polar].map(|v| v.into_iter().map(T::from_f64).collect()));
            weights
        });
        sets.into()
    }

    /// Returns the places of `count` nodes along `axis`, in [−1, 1].
    pub fn places(self, axis: usize, count: usize) -> Vec<f64> {
        match self
            .sphere
            .then(|| axis.checked_sub(self.cameras))
            .flatten()
        {
            Some(0) => spherical::azimuths(count),
            Some(_) => spherical::polar_angles(count),
            None => {
                let nodes = chebyshev::nodes(count);
                nodes.iter().map(|y| self.mapping.place(*y)).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chebyshev::MappedChebyshev;
    use ndarray::IxDyn;

    #[test]
    fn many_points_at_once_give_the_sum_of_all_terms() {
        let shape = [5, 4, 40, 3, 2];
        let coefficients = ArrayD::from_shape_fn(IxDyn(&shape), |i| {
            (0..5).map(|a| (a + 1) * i[a]).sum::<usize>() as f64 % 7.0 - 3.0
        });
        let variables = Variables::of_face(1, MappedChebyshev::new(0.8));
        let polynomial = Polynomial {
            coefficients,
            variables,
        };
        let points = [[0.3, -0.9, 0.1], [1.0, 0.5, -0.7]];
        let rows = polynomial.at(&points.each_ref().map(|p| p.as_slice()));
        for (row, x) in rows.iter().zip(points) {
            let weights = &variables.weights::<f64>(&shape, &x)[0];
            let mut expected = vec![0.0; 6];
            for (i, c) in polynomial.coefficients.indexed_iter() {
                let weight: f64 = (0..3).map(|a| weights[a][i[a]]).product();
                expected[2 * i[3] + i[4]] += c * weight;
            }
            let close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-11;
            assert!(row.len() == 6 && row.iter().zip(&expected).all(close));
        }
    }

    #[test]
    fn spectra_are_the_sizes_of_the_coefficients_of_each_degree() {
        let mut coefficients = ArrayD::zeros(IxDyn(&[3, 4, 2, 2]));
        coefficients[[1, 3, 0, 1]] = 3.0;
        coefficients[[1, 0, 1, 0]] = -4.0;
        let polynomial = Polynomial {
            coefficients,
            variables: Variables::of_face(0, MappedChebyshev::NONE),
        };
        let spectra = polynomial.spectra();
        assert_eq!(spectra[0], [0.0, 5.0, 0.0]);
        assert_eq!(spectra[1], [4.0, 0.0, 0.0, 3.0]);
        assert_eq!(spectra[2], [3.0, 4.0]);
    }
}
