//! Sampled fans as tensors for numpy, and their size as quantised tensor trains.
//!
//! In: a manifold file and [`TensorOptions`]. Out: an `.npz` file of single-precision arrays:
//! `displacement` and `slope`, as far as they were sampled, with axes (camera…, face, direction…, arc
//! length, channel), and the positions of the nodes: `camera_0`… (stored camera parameters), `face`,
//! `direction_0`…, `arc_length`. Displacement is `(X(s) − X(0))/s − X'(0)` of the stored chart point,
//! slope `X'(s) − X'(0)`, the derivative of s times the displacement (of each those components that can
//! differ from zero).
//!
//! Samples at Chebyshev nodes are also packed as patches of a bundle are, at given largest errors, to
//! be held against general compressors of the tensor. Errors are those of all numbers at the nodes, as a
//! compressor of the samples would be held to.

use crate::sweep::{
    Spacing, TensorOptions, WrittenTensor,
    grid::{GridAxes, GridSamples, displacement_channels, slope_channels},
    tables::interrupted,
};
use geofan_bake::{
    plan::{plan, usual_tangents},
    refine::tensor_train::{best_layout, decompose},
};
use geofan_bundle::{
    MappedChebyshev, Polynomial, StepSize, Tensor, Train, Tree, Variables, chebyshev,
    rays::{DISPLACEMENT, RaySpace, ReferenceSphere},
    unweighted, weighted,
};
use geofan_core::{
    Error, Muted, Observer, Result, Stop,
    files::{make_output_folder, write_atomically},
    manifold::Manifold,
};
use ndarray::{Array1, ArrayD, Axis, IxDyn, Slice};
use ndarray_npy::{NpzWriter, WriteNpzError};
use std::{
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

/// The most numbers of a tensor: four gigabytes.
const MOST: usize = 1 << 30;

/// The promise that the integrator's tolerance is chosen for, mrad.
const PROMISE: f64 = 0.02;

impl TensorOptions {
    /// Samples the fans of the manifold in the file `path` and writes them to `out`; returns the path, and
    /// lines that say how many bytes trains take.
    ///
    /// # Errors
    /// The file cannot work, the tensor is too large, an interruption, or the place cannot be
    /// written.
    pub fn write(&self, path: &Path, out: &Path, observer: &dyn Observer) -> Result<WrittenTensor> {
        let manifold = Arc::new(Manifold::load(path, &[])?);
        let length = manifold.length_or(None)?;
        let space = RaySpace::new(manifold)?;
        let tangents = usual_tangents(&space, PROMISE);
        let (space, plan) = plan(space, length, PROMISE, tangents, &Muted(observer))?;
        // Plain directions, as any other program would sample them.
        let space = space.with_reference_sphere(ReferenceSphere::default());
        let axes = self.axes(&space, length)?;
        if !self.trains.is_empty() && self.spacing == Spacing::Uniform {
            let message = "trains are of Chebyshev polynomials: add --npz-spacing chebyshev";
            return Err(Error::input("--npz-train", message));
        }
        let (channels, stop) = (self.channels(&space), || observer.cancelled());
        let samples = GridSamples::new(&space, axes, plan.tolerance, channels, stop);
        let samples = samples.ok_or_else(interrupted)?;
        let trains = train_lines(&samples, &self.trains)?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let path = write_samples(out, &format!("{stem}-{}", self.name()), &samples)?;
        Ok(WrittenTensor { path, trains })
    }

    /// Returns the channels to sample: displacements, and slopes if frames are wanted.
    fn channels(&self, space: &RaySpace) -> Vec<usize> {
        let mut channels = displacement_channels(space);
        if self.frames {
            channels.extend(slope_channels(space));
        }
        channels
    }

    /// Places the nodes.
    fn axes(&self, space: &RaySpace, length: f64) -> Result<GridAxes> {
        let [camera, direction, arc] = self.nodes;
        let mut counts = vec![camera; space.cameras().len()];
        counts.extend(vec![direction; space.directions()]);
        counts.push(arc);
        let mut axes = GridAxes::new(space, length, &counts, self.spacing);
        let wanted = |face: &usize| self.face.is_none_or(|only| only == *face);
        let faces = axes.faces.len();
        axes.faces.retain(wanted);
        if axes.faces.is_empty() {
            let message = format!("this space has {faces} faces, numbered from 0");
            return Err(Error::input("--npz-face", message));
        }
        let channels = self.channels(space).len();
        let factors = counts.iter().copied().chain([axes.faces.len(), channels]);
        let numbers = factors.fold(1, |n: usize, factor| n.saturating_mul(factor));
        match (1..=MOST).contains(&numbers) {
            true => Ok(axes),
            false => {
                let message = format!("{numbers} numbers; from 1 to {MOST} can be written");
                Err(Error::input("--npz-nodes", message))
            }
        }
    }

    /// Names the file by its nodes.
    fn name(&self) -> String {
        let [camera, direction, arc] = self.nodes;
        let face = self
            .face
            .map_or(String::new(), |face| format!("-face{face}"));
        let spacing = match self.spacing {
            Spacing::Uniform => "uniform",
            Spacing::Chebyshev => "chebyshev",
        };
        format!("{camera}-{direction}-{arc}-{spacing}{face}")
    }
}

/// Writes `samples` to `npz/NAME.npz` in `out`.
///
/// # Errors
/// The place cannot be written.
pub fn write_samples(out: &Path, name: &str, samples: &GridSamples) -> Result<PathBuf> {
    let folder = out.join("npz");
    make_output_folder(&folder)?;
    let path = folder.join(format!("{name}.npz"));
    write_atomically(&path, |file| {
        put(NpzWriter::new(file), samples).map_err(io::Error::other)
    })?;
    Ok(path)
}

fn put<W: io::Write + io::Seek>(
    mut npz: NpzWriter<W>,
    samples: &GridSamples,
) -> Result<(), WriteNpzError> {
    // The nodes.
    let axes = &samples.axes;
    let nodes = |nodes: &[f64]| nodes.iter().map(|x| *x as f32).collect::<Array1<f32>>();
    for (k, camera) in axes.cameras.iter().enumerate() {
        npz.add_array(format!("camera_{k}"), &nodes(camera))?;
    }
    let faces: Array1<i32> = axes.faces.iter().map(|f| *f as i32).collect();
    npz.add_array("face", &faces)?;
    for (k, direction) in axes.directions.iter().enumerate() {
        npz.add_array(format!("direction_{k}"), &nodes(direction))?;
    }
    npz.add_array("arc_length", &nodes(&axes.lengths))?;
    // The numbers: displacements come before slopes.
    let shape = samples.shape();
    let last = Axis(shape.len() - 1);
    let all = ndarray::ArrayView::from_shape(IxDyn(&shape), &samples.values);
    let Ok(all) = all else { return Ok(()) };
    let is_displacement = |channel: &&usize| **channel >= DISPLACEMENT;
    let split = samples.channels.iter().filter(is_displacement).count();
    let part = |slice: Slice| -> ArrayD<f32> { all.slice_axis(last, slice).to_owned() };
    if split > 0 {
        npz.add_array("displacement", &part(Slice::from(..split)))?;
    }
    if split < samples.channels.len() {
        npz.add_array("slope", &part(Slice::from(split..)))?;
    }
    npz.finish()?;
    Ok(())
}

/// Singular values below this share of the largest error are left out: steps are about twice as large
/// (Gaussian lens), and numbers that belong to such values round to zero.
const NEGLIGIBLE: f64 = 0.0025;

/// The largest rank tried.
const MOST_RANK: usize = 3000;

/// Steps tried: so many, each the next finer; the coarsest is the error.
const STEPS: i16 = 384;

/// Writes for each of `errors` a line that tells the bytes of the whole tensor, all faces together.
fn train_lines(samples: &GridSamples, errors: &[f64]) -> Result<Vec<String>> {
    if errors.is_empty() {
        return Ok(Vec::new());
    }
    let faces = face_coefficients(samples);
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
            "largest error {error:e}: {bytes} bytes as tensor trains, {bits:.3} bits a number"
        ))
    };
    errors.iter().map(line).collect()
}

/// Computes the coefficients of each face, axes camera…, direction…, arc length, channel.
fn face_coefficients(samples: &GridSamples) -> Vec<ArrayD<f64>> {
    let axes = &samples.axes;
    let shape = samples.shape();
    let values = samples.values.iter().map(|x| f64::from(*x)).collect();
    let all = ArrayD::from_shape_vec(IxDyn(&shape), values).expect("a value for each node");
    let face = Axis(axes.cameras.len());
    let faces = all.axis_iter(face).map(|face| {
        let axes = face.ndim() - 1;
        chebyshev::coefficients(face.to_owned(), axes)
    });
    faces.collect()
}

/// Finds the bytes of the train rounded with the coarsest step that keeps the error, by bisection.
fn smallest(coefficients: &ArrayD<f64>, cameras: usize, error: f64) -> Option<usize> {
    // Patches round slopes more coarsely the higher their degree. Of these numbers all are worth the
    // same.
    let polynomial = Polynomial {
        coefficients: unweighted(coefficients),
        variables: Variables::of_face(cameras, MappedChebyshev::NONE),
    };
    let stop = Stop::default();
    let layout = best_layout(&polynomial, &stop)?;
    let train = decompose(&polynomial, layout, (NEGLIGIBLE * error, MOST_RANK), &stop)?;
    let mut best = None;
    let (mut low, mut high) = (0, STEPS);
    while high > low {
        let middle = (low + high) / 2;
        let step = StepSize::near(error).coarser(-middle);
        match rounded(&train, step, coefficients, error) {
            Some(bytes) => (best, high) = (Some(bytes), middle),
            None => low = middle + 1,
        }
    }
    best
}

/// Counts the bytes of `train` rounded with `step`; `None` if a number is off by more than `error`.
fn rounded(train: &Train, step: StepSize, exact: &ArrayD<f64>, error: f64) -> Option<usize> {
    let tensor = train.nearest(step)?;
    // The changes by rounding, at the nodes.
    let kept = unpacked(&tensor)?;
    let mut off = exact.clone();
    let mut part = off.slice_each_axis_mut(|axis| (..kept.len_of(axis.axis)).into());
    part -= &kept;
    let axes = off.ndim() - 1;
    let off = chebyshev::samples(off, axes);
    let fits = off.iter().all(|x| x.abs() <= error);
    fits.then(|| Tree::Leaf(Arc::new(tensor)).encode().len())
}

/// Multiplies a tensor out into all its coefficients.
fn unpacked(tensor: &Tensor) -> Option<ArrayD<f64>> {
    let all = ArrayD::from_shape_vec(IxDyn(&tensor.shape()), tensor.at(&[]));
    Some(weighted(&all.ok()?))
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
