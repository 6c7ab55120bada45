//! Many single rays of a tensor at once.
//!
//! In: a [`Tensor`] and the parameters of rays. Out: for each what [`Tensor::at`] gives. The cores of a
//! train are made real once and multiplied by all rays together, from the first to the last: every
//! integer is then read as often as there are blocks of rays, not as there are rays.

use super::{
    chain::Link,
    layout::Layout,
    matrix::{added, product},
    tensor::Tensor,
    variables::Weights,
};
use crate::parallel::*;
use geofan_expr::real::Real;

/// Rays that are multiplied together: their products with a core stay in a cache.
const RAYS: usize = 24;

impl Tensor {
    /// [`Tensor::at`] for many `points` (parameters of all cameras and directions).
    pub fn at_many(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        self.many::<f64>(points)
    }

    /// The same in single precision, as tables are read for pictures, in half the time: rounding adds 1e-7
    /// or so of the largest coefficient.
    pub fn at_many_in_single(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        self.many::<f32>(points)
    }

    fn many<T: Real>(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        if self.layout == Layout::Plain {
            return points.par_iter().map(|x| self.at(x)).collect();
        }
        let cores = self.links::<T>(&vec![None; self.shape().len()]);
        let blocks = points.par_chunks(RAYS);
        let blocks = blocks.map(|points| self.block(&cores, points));
        blocks.collect::<Vec<_>>().concat()
    }

    /// The rows that remain of `cores` at `points`.
    fn block<T: Real>(&self, cores: &[Link<T>], points: &[&[f64]]) -> Vec<Vec<f64>> {
        let shape = self.shape();
        let sets = points.iter().map(|x| self.variables.weights(&shape, x));
        let sets: Vec<Vec<Weights<T>>> = sets.collect();
        let axes = self.table_axes();
        let is_direction = |k: &usize| axes[*k][0] >= self.variables.cameras;
        let (last, rays) = (cores.len() - 1, 0..cores.len() - 1);
        let [first, after] = [
            rays.clone().find(is_direction),
            rays.clone().rfind(is_direction),
        ];
        // One row for each ray; from the first to the last direction one for each set of its weights.
        let mut rows = vec![T::ONE; points.len()];
        for k in rays {
            if Some(k) == first {
                rows = rows.repeat(sets[0].len());
            }
            let weights = |row: usize| &sets[row % points.len()][row / points.len()][axes[k][0]];
            let (core, count) = (&cores[k], rows.len() / cores[k].left);
            let mut weighted = Vec::with_capacity(rows.len() * weights(0).len());
            for (row, values) in rows.chunks_exact(core.left).enumerate() {
                put_products(values, weights(row), &mut weighted);
            }
            rows = product(&weighted, weighted.len() / count, &core.values);
            if Some(k) == after {
                let all = rows.chunks_exact(rows.len() / sets[0].len());
                rows = added(&all.map(<[T]>::to_vec).collect::<Vec<_>>());
            }
        }
        let rows = product(&rows, cores[last].left, &cores[last].values);
        let row = rows.chunks_exact(rows.len() / points.len());
        row.map(|row| row.iter().map(|x| x.to_f64()).collect())
            .collect()
    }
}

/// Adds each of `values` times each of `weights`, these running fastest.
fn put_products<T: Real>(values: &[T], weights: &[T], to: &mut Vec<T>) {
    for x in values {
        to.extend(weights.iter().map(|w| *x * *w));
    }
}

#[cfg(test)]
mod tests {
    use super::super::{
        polynomial::Polynomial, scale::Step, stretch::MappedChebyshev, train::Train,
        variables::Variables,
    };
    use super::*;
    use geofan_core::random::Stream;
    use ndarray::{ArrayD, IxDyn};

    fn train(order: &[usize], variables: Variables) -> Tensor {
        let lengths = [3, 5, 4];
        let mut stream = Stream::new(&[9]);
        let (mut cores, mut scales, mut left) = (Vec::new(), Vec::new(), 1);
        let mut random =
            |shape: &[usize]| ArrayD::from_shape_fn(IxDyn(shape), |_| stream.between(-1.0, 1.0));
        for axis in order {
            cores.push(random(&[left, lengths[*axis], 2]));
            scales.push(vec![1.5, 0.2]);
            left = 2;
        }
        cores.push(random(&[left, 6, 3, 1]));
        let train = Train {
            layout: Layout::Train(order.to_vec()),
            variables,
            cores,
            singular: scales,
        };
        train.rounded(Step::near(1e-5)).unwrap()
    }

    #[test]
    fn many_rays_are_what_each_is_alone() {
        let face = Variables::of_face(1, MappedChebyshev::new(0.7));
        let sphere = Variables {
            sphere: true,
            ..face
        };
        let points: Vec<[f64; 3]> = (0..RAYS + 5)
            .map(|k| [0.1, -0.7, 0.4].map(|x| x + 0.01 * k as f64))
            .collect();
        let points: Vec<&[f64]> = points.iter().map(<[f64; 3]>::as_slice).collect();
        for variables in [face, sphere] {
            let orders = [[0, 1, 2], [1, 0, 2], [2, 1, 0]];
            let plain = Polynomial {
                coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 2, 4, 3]), 0.5),
                variables,
            };
            let plain = Train::plain(&plain).rounded(Step::near(1e-3)).unwrap();
            let trains = orders.map(|order| train(&order, variables));
            for tensor in trains.iter().chain([&plain]) {
                let found = [tensor.at_many(&points), tensor.at_many_in_single(&points)];
                for (found, most) in found.iter().zip([1e-12, 1e-5]) {
                    for (found, x) in found.iter().zip(&points) {
                        let close = |(a, b): (&f64, &f64)| (a - b).abs() < most * (1.0 + b.abs());
                        let alone = tensor.at(x);
                        assert!(found.len() == alone.len() && found.iter().zip(&alone).all(close));
                    }
                }
            }
        }
    }
}
