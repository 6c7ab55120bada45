//! Pictures as arrays, what the renderer made and files; and pages of scenes, for browsers and notebooks.

use crate::work::{self, About, refuse};
use geofan_core::{Result, geodesic::UnfinishedPaths};
use geofan_render::{
    PicturePanels, World,
    picture::{self, Frame, LayerValues, Metadata, Picture, PictureFormat, read_exr},
};
use geofan_view::{Page, SpaceSource};
use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{prelude::*, types::PyDict};
use std::path::PathBuf;

/// A picture of a scene, and what is told of it.
pub struct DrawnPicture {
    /// The picture.
    pub picture: Picture,
    /// Goes with it into an EXR file.
    pub notes: Metadata,
    /// The tracer's name.
    pub tracer: &'static str,
    /// Samples of a pixel.
    pub samples: u64,
    /// Share of samples that a table gave up on.
    pub flagged: f64,
    /// Paths that were not followed far enough; `None` if they are not counted.
    pub unfinished: Option<UnfinishedPaths>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl DrawnPicture {
    /// Makes the notes for a picture's file.
    pub fn notes(world: &World, panels: &PicturePanels, tracer: &str) -> Metadata {
        let notes = Metadata::default()
            .with("manifold", &world.manifold.name)
            .with("tracer", tracer)
            .with("version", env!("CARGO_PKG_VERSION"));
        panels.described(notes)
    }

    /// Hands it over, without copying it.
    pub fn into_dict(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let unfinished = serde_json::to_string(&self.unfinished);
        let unfinished = unfinished.map_err(|e| refuse(py, "picture", e.to_string()))?;
        let (rgb, layers) = arrays(py, self.picture)?;
        let dict = PyDict::new(py);
        dict.set_item("rgb", rgb)?;
        dict.set_item("layers", layers)?;
        dict.set_item("tracer", self.tracer)?;
        dict.set_item("samples", self.samples)?;
        dict.set_item("flagged", self.flagged)?;
        dict.set_item("unfinished", unfinished)?;
        dict.set_item("warnings", self.warnings)?;
        let frame = self.notes.frame.map(|frame| (frame.size, frame.corner));
        dict.set_item("window", (frame, self.notes.screen_width))?;
        dict.set_item("notes", self.notes.notes)?;
        Ok(dict)
    }
}

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
    window: PictureWindow,
) -> PyResult<()> {
    let name = path.display().to_string();
    if PictureFormat::of(&path).is_none() {
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
    let (frame, screen_width) = window;
    let about = Metadata {
        notes,
        frame: frame.map(|(size, corner)| Frame { size, corner }),
        screen_width,
    };
    let written: Result<()> = py.detach(|| picture::write(&path, &made, &about));
    written.map_err(|e| About::Input.raise(py, e))
}

/// Size and corner of the picture that one is a part of, and its width at distance 1 in perspective.
type PictureWindow = (Option<((usize, usize), (usize, usize))>, Option<f32>);

/// What is read from a picture's file: light, layers, notes, window.
type ReadPicture<'py> = (
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyDict>,
    Vec<(String, String)>,
    PictureWindow,
);

/// Reads a PNG, HDR or EXR file as linear light, with its layers and notes.
#[pyfunction]
pub fn read_picture<'py>(py: Python<'py>, path: PathBuf) -> PyResult<ReadPicture<'py>> {
    let found = py.detach(|| match PictureFormat::of(&path) {
        Some(PictureFormat::Exr) => read_exr(&path),
        _ => picture::read(&path).map(|picture| (picture, Metadata::default())),
    });
    let (picture, notes) = found.map_err(|e| About::Input.raise(py, e))?;
    let (rgb, layers) = arrays(py, picture)?;
    let frame = notes.frame.map(|frame| (frame.size, frame.corner));
    Ok((rgb, layers, notes.notes, (frame, notes.screen_width)))
}

/// Makes the page of a scene or manifold file, as `geofan view --page` does. Returns the bytes of the files written
/// to `output`; without one, the HTML text.
#[pyfunction]
pub fn page(
    py: Python<'_>,
    file: PathBuf,
    bundle: Option<PathBuf>,
    length: Option<f64>,
    settings: Vec<(String, f64)>,
    wasm: PathBuf,
    output: Option<PathBuf>,
) -> PyResult<(usize, Option<String>)> {
    let source = SpaceSource {
        file,
        bundle,
        length,
    };
    // The files that a page reads are noted by its thread, which must not take up the work of others meanwhile.
    let own = work::fresh(py)?;
    work::watch_in(py, About::Scene, None, &own, |_| {
        let page = Page::new(&source, &settings, &wasm)?;
        match output {
            Some(output) => Ok((page.write(&output)?, None)),
            None => {
                let html = page.html()?;
                Ok((html.len(), Some(html)))
            }
        }
    })
}
