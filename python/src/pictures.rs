//! Pictures as arrays: what the renderer made, and files.

use crate::errors::{About, refuse};
use geofan_core::Result;
use geofan_render::picture::{self, Format, LayerValues, Metadata, Picture, read_exr};
use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{prelude::*, types::PyDict};
use std::path::PathBuf;

/// Hands a picture over: `rgb` and the layers by their names, without copying them.
pub fn arrays<'py>(
    py: Python<'py>,
    picture: Picture,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyDict>)> {
    let layers = PyDict::new(py);
    for layer in picture.layers {
        match layer.values {
            LayerValues::Float(values) => {
                layers.set_item(layer.name, PyArray2::from_owned_array(py, values))?;
            }
            LayerValues::Index(values) => {
                layers.set_item(layer.name, PyArray2::from_owned_array(py, values))?;
            }
        }
    }
    Ok((PyArray3::from_owned_array(py, picture.rgb), layers))
}

/// Writes arrays as a PNG or EXR file.
#[pyfunction]
pub fn write_picture(
    py: Python<'_>,
    path: PathBuf,
    rgb: PyReadonlyArray3<'_, f32>,
    floats: Vec<(String, PyReadonlyArray2<'_, f32>)>,
    indices: Vec<(String, PyReadonlyArray2<'_, u32>)>,
    notes: Vec<(String, String)>,
) -> PyResult<()> {
    let name = path.display().to_string();
    if Format::of(&path).is_none() {
        return Err(refuse(py, &name, "pictures are .png or .exr"));
    }
    let rgb = rgb.as_array();
    let (height, width, channels) = rgb.dim();
    let sizes = floats.iter().map(|(_, layer)| layer.as_array().dim());
    let mut sizes = sizes.chain(indices.iter().map(|(_, layer)| layer.as_array().dim()));
    if channels != 3 || height * width == 0 || sizes.any(|size| size != (height, width)) {
        return Err(refuse(
            py,
            "rgb",
            "a picture is (height, width, 3), its layers (height, width)",
        ));
    }
    let mut made = Picture::new(rgb.to_owned());
    for (name, layer) in floats {
        made = made.with_float(name, layer.as_array().to_owned());
    }
    for (name, layer) in indices {
        made = made.with_index(name, layer.as_array().to_owned());
    }
    let written: Result<()> = py.detach(|| picture::write(&path, &made, &with_notes(notes)));
    written.map_err(|e| About::Input.raise(py, e))
}

/// Makes the notes for a picture's file.
fn with_notes(notes: Vec<(String, String)>) -> Metadata {
    Metadata {
        notes,
        ..Metadata::default()
    }
}

/// What is read from a picture's file: light, layers, notes.
type ReadPicture<'py> = (
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyDict>,
    Vec<(String, String)>,
);

/// Reads a PNG, HDR or EXR file as linear light, with its layers and notes.
#[pyfunction]
pub fn read_picture<'py>(py: Python<'py>, path: PathBuf) -> PyResult<ReadPicture<'py>> {
    let found = py.detach(|| match Format::of(&path) {
        Some(Format::Exr) => read_exr(&path),
        _ => picture::read(&path).map(|picture| (picture, Metadata::default())),
    });
    let (picture, notes) = found.map_err(|e| About::Input.raise(py, e))?;
    let (rgb, layers) = arrays(py, picture)?;
    Ok((rgb, layers, notes.notes))
}
