//! Sampled fans for numpy.
//!
//! In: [`Samples`]. Out: an `.npz` file of single-precision arrays: `displacement` and `slope`, as far
//! as they were sampled, with axes (camera…, face, direction…, arc length, channel), and the positions
//! of the nodes: `camera_0`… (stored camera parameters), `face`, `direction_0`…, `arc_length`.
//! Displacement is `(X(s) − X(0))/s − X'(0)` of the stored chart point, slope `X'(s) − X'(0)`, the
//! derivative of s times the displacement (of each those components that can differ from zero).

use crate::sweep::{
    Spacing, TensorOptions,
    grid::{Axes, Samples, Stored},
    npz_bytes,
    patches::interrupted,
};
use geofan_bake::plan::plan;
use geofan_bundle::rays::{DISPLACEMENT, RaySpace, ReferenceSphere};
use geofan_core::{Error, Muted, Observer, Result, files::write_atomically, manifold::Manifold};
use ndarray::{Array1, ArrayD, Axis, IxDyn, Slice};
use ndarray_npy::{NpzWriter, WriteNpzError};
use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

/// The most numbers of a tensor: four gigabytes.
const MOST: usize = 1 << 30;

impl TensorOptions {
    /// Samples the fans of the manifold in the file `path` and writes them to `out`; adds to `lines` how
    /// many bytes trains take.
    ///
    /// # Errors
    /// The file cannot work, the tensor is too large, an interruption, or the place cannot be
    /// written.
    pub fn write(
        &self,
        path: &Path,
        out: &Path,
        observer: &dyn Observer,
        lines: &mut Vec<String>,
    ) -> Result<PathBuf> {
        let nodes = self.nodes;
        let manifold = Arc::new(Manifold::load(path, &[])?);
        let length = manifold.length_or(None)?;
        let space = RaySpace::new(manifold)?;
        let (space, plan) = plan(space, length, PROMISE, true, &Muted(observer))?;
        // Plain directions, as any other program would sample them.
        let space = space.focused(ReferenceSphere::default());
        let axes = self.axes(&space, length, nodes)?;
        if !self.trains.is_empty() && self.spacing == Spacing::Uniform {
            let message = "trains are of Chebyshev polynomials: add --npz-spacing chebyshev";
            return Err(Error::input("--npz-train", message));
        }
        let stop = || observer.cancelled();
        let samples = Samples::new(&space, axes, (plan.tolerance, self.stored()), stop);
        let samples = samples.ok_or_else(interrupted)?;
        lines.extend(npz_bytes::lines(&samples, &self.trains)?);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        write(out, &format!("{stem}-{}", self.name(nodes)), &samples)
    }

    fn stored(&self) -> Stored {
        match self.frames {
            true => Stored::Both,
            false => Stored::Displacement,
        }
    }

    fn axes(
        &self,
        space: &RaySpace,
        length: f64,
        [camera, direction, arc]: [usize; 3],
    ) -> Result<Axes> {
        let mut counts = vec![camera; space.cameras().len()];
        counts.extend(vec![direction; space.directions()]);
        counts.push(arc);
        let mut axes = Axes::new(space, length, &counts, self.spacing);
        let wanted = |face: &usize| self.face.is_none_or(|only| only == *face);
        axes.faces.retain(wanted);
        let channels = self.stored().channels(space).len();
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

    fn name(&self, [camera, direction, arc]: [usize; 3]) -> String {
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

/// The promise that the integrator's tolerance is chosen for, mrad.
const PROMISE: f64 = 0.02;

/// Writes `samples` to `npz/NAME.npz` in `out`.
///
/// # Errors
/// The place cannot be written.
pub fn write(out: &Path, name: &str, samples: &Samples) -> Result<PathBuf> {
    let folder = out.join("npz");
    fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let path = folder.join(format!("{name}.npz"));
    write_atomically(&path, |file| {
        put(NpzWriter::new(file), samples).map_err(io::Error::other)
    })?;
    Ok(path)
}

fn put<W: io::Write + io::Seek>(
    mut npz: NpzWriter<W>,
    samples: &Samples,
) -> Result<(), WriteNpzError> {
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
    let mut shape = axes.ray_shape();
    shape.extend([axes.lengths.len(), samples.channels.len()]);
    let last = Axis(shape.len() - 1);
    let all = ndarray::ArrayView::from_shape(IxDyn(&shape), &samples.values);
    let Ok(all) = all else { return Ok(()) };
    let split = samples
        .channels
        .iter()
        .filter(|c| **c >= DISPLACEMENT)
        .count();
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
