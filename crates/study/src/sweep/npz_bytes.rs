//! How many bytes a sampled tensor takes as quantised tensor trains, as patches of a bundle are.
//!
//! In: [`Samples`] at Chebyshev nodes and largest errors. Out: bytes, to be held against general
//! compressors on the same tensor. Errors are those of all numbers at the nodes: the same that a
//! compressor of the samples would be held to.

use crate::sweep::grid::Samples;
use geofan_bake::refine::{decompose::decompose, order};
use geofan_bundle::{
    MappedChebyshev, Polynomial, Step, Tensor, Train, Tree, Variables, chebyshev, graded, ungraded,
};
use geofan_core::{Error, Result};
use ndarray::{ArrayD, Axis, IxDyn};
use std::sync::Arc;

/// Singular values below this share of the largest error are left out: steps are about twice as large
/// (Gaussian lens), and what belongs to such values rounds to zero.
const NEGLIGIBLE: f64 = 0.0025;

/// The largest rank tried.
const MOST_RANK: usize = 3000;

/// Steps tried: so many, each the next finer; the coarsest is the error.
const STEPS: i16 = 384;

/// For each of `errors` a line that tells the bytes of the whole tensor, all faces together.
///
/// # Errors
/// Ranks explode.
pub fn lines(samples: &Samples, errors: &[f64]) -> Result<Vec<String>> {
    let faces = faces(samples);
    let count = samples.values.len();
    let line = |error: &f64| {
        let mut bytes = 0;
        for coefficients in &faces {
            let size = smallest(coefficients, samples.axes.cameras.len(), *error);
            let too_rough = || Error::input("--npz-train", "ranks explode: give a larger error");
            bytes += size.ok_or_else(too_rough)?;
        }
        let bits = 8.0 * bytes as f64 / count as f64;
        Ok(format!(
            "largest error {error:e}: {bytes} bytes as tensor trains, {bits:.3} bits a number\n"
        ))
    };
    errors.iter().map(line).collect()
}

/// The coefficients of each face, axes camera…, direction…, arc length, channel.
fn faces(samples: &Samples) -> Vec<ArrayD<f64>> {
    let axes = &samples.axes;
    let mut shape = axes.ray_shape();
    shape.extend([axes.lengths.len(), samples.channels.len()]);
    let values = samples.values.iter().map(|x| f64::from(*x)).collect();
    let all = ArrayD::from_shape_vec(IxDyn(&shape), values).expect("a value for each node");
    let face = Axis(axes.cameras.len());
    let faces = all.axis_iter(face).map(|face| {
        let axes = face.ndim() - 1;
        chebyshev::coefficients(face.to_owned(), axes)
    });
    faces.collect()
}

/// The bytes of the train rounded with the coarsest step that keeps the error, by bisection.
fn smallest(coefficients: &ArrayD<f64>, cameras: usize, error: f64) -> Option<usize> {
    // Patches round slopes more coarsely the higher their degree. Of these numbers all are worth the
    // same.
    let polynomial = Polynomial {
        coefficients: ungraded(coefficients),
        variables: Variables::of_face(cameras, MappedChebyshev::NONE),
    };
    let layout = order::best(&polynomial);
    let train = decompose(&polynomial, layout, (NEGLIGIBLE * error, MOST_RANK))?;
    let mut best = None;
    let (mut low, mut high) = (0, STEPS);
    while high > low {
        let middle = (low + high) / 2;
        let step = Step::near(error).coarser(-middle);
        match rounded(&train, step, coefficients, error) {
            Some(bytes) => (best, high) = (Some(bytes), middle),
            None => low = middle + 1,
        }
    }
    best
}

/// The bytes of `train` rounded with `step`; `None` if a number is off by more than `error`.
fn rounded(train: &Train, step: Step, exact: &ArrayD<f64>, error: f64) -> Option<usize> {
    let tensor = train.nearest(step)?;
    let kept = unpacked(&tensor)?;
    let mut off = exact.clone();
    let mut part = off.slice_each_axis_mut(|axis| (..kept.len_of(axis.axis)).into());
    part -= &kept;
    let axes = off.ndim() - 1;
    let off = chebyshev::samples(off, axes);
    let fits = off.iter().all(|x| x.abs() <= error);
    fits.then(|| Tree::Leaf(Arc::new(tensor)).encode().len())
}

/// All coefficients that `tensor` was made of.
fn unpacked(tensor: &Tensor) -> Option<ArrayD<f64>> {
    let all = ArrayD::from_shape_vec(IxDyn(&tensor.shape()), tensor.at(&[]));
    Some(graded(&all.ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_error_takes_more_bytes_and_smooth_samples_few() {
        let nodes = chebyshev::nodes(8);
        let samples = ArrayD::from_shape_fn(IxDyn(&[8, 8, 8, 8, 2]), |i| {
            let x = (0..4).map(|a| (a + 1) as f64 * nodes[i[a]]).sum::<f64>();
            (0.3 * x + i[4] as f64).sin()
        });
        let coefficients = chebyshev::coefficients(samples, 4);
        let bytes = [1e-2, 1e-3, 1e-4].map(|e| smallest(&coefficients, 1, e).unwrap());
        assert!(bytes[0] < bytes[1] && bytes[1] < bytes[2], "{bytes:?}");
        assert!(bytes[2] < 8 * 8 * 8 * 8, "{bytes:?}");
    }
}
