//! Sampled fans for numpy.
//!
//! In: [`Samples`]. Out: an `.npz` file of single-precision arrays: `displacement` and `rotation` with
//! axes (camera…, face, direction…, arc length, channel), and the positions of the nodes: `camera_0`…
//! (stored camera parameters), `face`, `direction_0`…, `arc_length`. Displacement is
//! `(X(s) − X(0))/s − X'(0)` of the stored chart point, rotation the quaternion x, y, z, w (or those
//! components of it that can differ from zero).

use super::grid::Samples;
use geofan::{Error, Result, fan::ROTATION, files::write_atomically};
use ndarray::{Array1, ArrayD, Axis, IxDyn, Slice};
use ndarray_npy::{NpzWriter, WriteNpzError};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

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
    let split = samples.channels.iter().filter(|c| **c < ROTATION).count();
    let part = |slice: Slice| -> ArrayD<f32> { all.slice_axis(last, slice).to_owned() };
    npz.add_array("displacement", &part(Slice::from(..split)))?;
    npz.add_array("rotation", &part(Slice::from(split..)))?;
    npz.finish()?;
    Ok(())
}
