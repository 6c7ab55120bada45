//! Scenes: reading, lighting, drawing and comparing them.

use crate::{
    arrays::{memory, positive, tolerance},
    bundles::PyBundle,
    camera::PyCamera,
    manifold::PyManifold,
    picture_work::{PictureWork, Staged, light_up, passes},
    pictures::{DrawnPicture, arrays},
    work::{self, About, refuse},
};
use geofan_core::{
    Error, Observer, Result, diagnostic::SourceText, geodesic::UnfinishedPaths, manifold::Manifold,
};
use geofan_light::path_tracer::{Estimator, PanelTracers, PathTracerSettings};
use geofan_render::{
    Clock, DrawingOptions, Part, PathSource, PicturePanels, Seen, Stage, World,
    frame::Watch,
    scene::{Mesh, SceneFile},
    usual_size,
};
use geofan_study::comparison::{CompareOptions, Comparison, LocalReport, compare, compare_local};
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::{prelude::*, types::PyDict};
use std::{
    fmt::{Display, Write},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

/// A scene with everything it names.
#[pyclass(frozen, name = "Stage", module = "geofan._native")]
pub struct PyStage {
    /// The library's, and over which length its surfaces are lit. In a box, as its vectors are aligned as Python's
    /// objects are not. Locked by the thread that calls, before it gives work to others.
    staged: Mutex<Box<Staged>>,
    /// What can be told while a picture is drawn.
    about: StageNotes,
}

/// What does not change of a scene.
struct StageNotes {
    scene: SceneFile,
    manifold: Arc<Manifold>,
    warnings: Vec<String>,
}

impl StageNotes {
    fn new(Stage { scene, world }: &Stage) -> Self {
        Self {
            scene: scene.clone(),
            manifold: world.manifold.clone(),
            warnings: world.warnings.clone(),
        }
    }

    /// Returns one of the scene's cameras.
    fn camera(&self, name: Option<&str>) -> Result<PyCamera> {
        let entry = self.scene.camera_called(name)?;
        PyCamera::of_entry(&self.manifold, &self.scene.source, entry)
    }
}

/// A mesh made of arrays: its name in the scene, vertices, faces, colour, light given off.
type MadeMesh<'py> = (
    String,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, i64>,
    [f32; 3],
    [f32; 3],
);

/// What all pictures of a scene have in common.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct PictureRequest {
    /// Name of a view of the scene, if no camera is given.
    view: Option<String>,
    /// Columns and rows; half of what the program takes where none are given.
    size: Option<(usize, usize)>,
    /// First column and row, columns and rows of the part that is drawn.
    crop: Option<[usize; 4]>,
    spp: usize,
    error: f64,
    tolerance: f64,
    length: Option<f64>,
}

/// The most pixels of a picture, and samples of a pixel.
const MOST_PIXELS: usize = 1 << 28;
const MOST_SAMPLES: usize = 4096;

/// Samples of a pixel that are in memory together, and about what a pixel takes besides them: its sums, its light and its
/// layers.
const SAMPLES_AT_ONCE: usize = 16;
const PIXEL_BYTES: usize = 128;

impl PictureRequest {
    /// Checks the numbers.
    fn checked(self, py: Python<'_>, pictures: usize) -> PyResult<Self> {
        let pixels = self.size.map(|(width, height)| width.checked_mul(height));
        let fits = |pixels: Option<usize>| pixels.is_some_and(|n| (1..=MOST_PIXELS).contains(&n));
        if !pixels.is_none_or(fits) {
            let message = format!("a picture has 1 to {MOST_PIXELS} pixels");
            return Err(refuse(py, "size", message));
        }
        if !(1..=MOST_SAMPLES).contains(&self.spp) {
            let message = format!("{} is not between 1 and {MOST_SAMPLES}", self.spp);
            return Err(refuse(py, "spp", message));
        }
        memory(
            py,
            "size",
            self.bytes().and_then(|n| n.checked_mul(pictures)),
        )?;
        positive(py, "error", self.error)?;
        tolerance(py, self.tolerance)?;
        self.length
            .map_or(Ok(0.0), |length| positive(py, "length", length))?;
        Ok(self)
    }

    /// Estimates the memory that a picture takes while it is drawn.
    fn bytes(&self) -> Option<usize> {
        let (width, height) = match self.crop {
            Some([_, _, width, height]) => (width, height),
            None => self.size.unwrap_or_default(),
        };
        let sample = size_of::<Seen>() + 3 * size_of::<f32>();
        let pixel = sample * self.spp.min(SAMPLES_AT_ONCE) + PIXEL_BYTES;
        width.checked_mul(height)?.checked_mul(pixel)
    }

    fn drawing(&self, layers: bool) -> DrawingOptions {
        DrawingOptions {
            samples: self.spp,
            error: self.error,
            tolerance: self.tolerance,
            layers,
        }
    }

    /// Divides the picture of `camera`, or of the view that is named.
    fn panels(&self, scene: &StageNotes, camera: Option<&PyCamera>) -> Result<PicturePanels> {
        let camera = match camera {
            Some(camera) => camera.clone(),
            None => scene.camera(self.view.as_deref())?,
        };
        let size = self.size.unwrap_or_else(|| {
            let (width, height) = usual_size(&camera.lens);
            (width / 2, height / 2)
        });
        camera.panels(size, self.crop.map(part).transpose()?)
    }

    /// Draws the picture and says what should be known of it.
    fn draw(
        &self,
        world: &World,
        (source, panels): (&PathSource<'_>, &PicturePanels),
        layers: bool,
        observer: &dyn Observer,
    ) -> Result<DrawnPicture> {
        let samples = panels.parts.iter().map(|part| {
            let (width, height) = part.view.size;
            (width * height * self.spp) as u64
        });
        let work = PictureWork::new(samples.sum(), observer);
        let watch = |more: usize| work.goes_on(more);
        let options = self.drawing(layers);
        let watched: (Clock<'_>, Watch<'_>) = (&geofan_study::clock, &watch);
        let drawn = source.draw_panels_watched(world, panels, options, watched)?;
        work::go_on(observer)?;
        work.end();
        let unfinished = source.ends(world, &drawn.parts, self.tolerance);
        let by_table = matches!(source, PathSource::Table(_));
        let mut warnings = drawing_warnings(world, panels, &unfinished, by_table);
        if !drawn.shows {
            warnings.push("nothing can be seen in this picture: no path meets an object, and none ends in a sky that the scene gives".into());
        }
        Ok(DrawnPicture {
            picture: drawn.picture,
            notes: DrawnPicture::notes(world, panels, source.name()),
            tracer: source.name(),
            samples: self.spp as u64,
            flagged: drawn.flagged,
            unfinished: Some(unfinished),
            warnings,
        })
    }
}

/// Returns columns and rows of a part of a picture.
fn part([x, y, width, height]: [usize; 4]) -> Result<Part> {
    let end = |start: usize, length: usize| start.checked_add(length).filter(|_| length > 0);
    match (end(x, width), end(y, height)) {
        (Some(right), Some(bottom)) => Ok((x..right, y..bottom)),
        _ => Err(Error::input(
            "crop",
            "is first column, first row, columns and rows, of which there must be some",
        )),
    }
}

#[pymethods]
impl PyStage {
    /// Reads a scene file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, settings: Vec<(String, f64)>) -> PyResult<Self> {
        let stage = work::run(py, About::Scene, |_| Ok(Stage::load(&path, &settings)))?;
        Self::made(py, stage)
    }

    /// Reads the text of a scene whose manifold, and some of whose meshes, are at hand.
    #[staticmethod]
    fn parse(
        py: Python<'_>,
        text: String,
        folder: PathBuf,
        manifold: &PyManifold,
        meshes: Vec<MadeMesh<'_>>,
    ) -> PyResult<Self> {
        let mut shelf = Vec::new();
        for (name, vertices, faces, colour, emission) in &meshes {
            let mesh = made_mesh(name, vertices, faces, *colour, *emission);
            let mesh = mesh.map_err(|e| About::Scene.raise(py, e))?;
            shelf.push((folder.join(name), Arc::new(mesh)));
        }
        let furnish = || {
            let scene = SceneFile::parse(SourceText::new("scene", text), &folder)?;
            let made: Vec<PathBuf> = shelf.iter().map(|(path, _)| path.clone()).collect();
            scene.check_files(&made)?;
            let world = World::furnished(&scene, (manifold.space.clone(), 0.0), shelf)?;
            Ok(Stage { scene, world })
        };
        let stage = work::run(py, About::Scene, |_| Ok(furnish()))?;
        Self::made(py, stage)
    }

    /// Returns the text of the scene.
    #[getter]
    fn text(&self) -> String {
        self.about.scene.source.text.clone()
    }

    /// Returns the manifold.
    #[getter]
    fn manifold(&self) -> PyManifold {
        PyManifold {
            space: self.about.manifold.clone(),
        }
    }

    /// Returns what was mended or left out while loading.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.about.warnings.clone()
    }

    /// Returns the names of the scene's further views.
    #[getter]
    fn views(&self) -> Vec<String> {
        let views = self.about.scene.views.iter();
        views.filter_map(|view| view.name.clone()).collect()
    }

    /// Returns one of the scene's cameras.
    fn camera(&self, py: Python<'_>, name: Option<String>) -> PyResult<PyCamera> {
        let camera = py.detach(|| self.about.camera(name.as_deref()));
        camera.map_err(|e| About::Scene.raise(py, e))
    }

    /// Draws a picture by table, exactly or to first order.
    #[allow(clippy::too_many_arguments)]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&PyCamera>,
        request: PictureRequest,
        tracer: Option<String>,
        bundle: Option<&PyBundle>,
        light_file: Option<PathBuf>,
        layers: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let request = request.checked(py, 1)?;
        let mut staged = work::lock(py, &self.staged)?;
        let staged: &mut Staged = &mut staged;
        let drawn = work::watch(py, About::Scene, progress.as_ref(), |observer| {
            bundle.map_or(Ok(()), |b| staged.0.check_bundle(&b.bundle))?;
            let panels = request.panels(&self.about, camera)?;
            let source = source(&request, &staged.0, tracer.as_deref(), bundle)?;
            let length = match bundle {
                Some(bundle) => bundle.bundle.table.length,
                None => staged.0.world.manifold.length_or(request.length)?,
            };
            light_up(staged, light_file.as_deref(), length, observer);
            request.draw(&staged.0.world, (&source, &panels), layers, observer)
        })?;
        drawn.into_dict(py)
    }

    /// Draws a picture by path tracing.
    #[allow(clippy::too_many_arguments)]
    fn path_trace<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&PyCamera>,
        request: PictureRequest,
        seed: u64,
        bounces: Option<u32>,
        seconds: Option<f64>,
        layers: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let request = request.checked(py, 1)?;
        seconds.map_or(Ok(0.0), |seconds| positive(py, "seconds", seconds))?;
        let staged = work::lock(py, &self.staged)?;
        let staged: &Staged = &staged;
        let drawn = work::watch(py, About::Scene, progress.as_ref(), |observer| {
            let world = &staged.0.world;
            if world.is_coloured_by_frequency() {
                let message = "`path` knows neither `redshift` nor `temperature` of the scene; draw it by another tracer, or take them out";
                return Err(Error::input("tracer", message));
            }
            let panels = request.panels(&self.about, camera)?;
            let settings = PathTracerSettings {
                seed,
                length: world.manifold.length_or(request.length)?,
                tolerance: request.tolerance,
                bounces: bounces.unwrap_or(u32::MAX),
                estimator: Estimator::Connected,
            };
            let tracers = PanelTracers::new(world, &panels, settings);
            let film = passes(&tracers, panels.size, (request.spp, seconds), observer)?;
            work::go_on(observer)?;
            let picture = film.picture();
            let mut warnings = Vec::new();
            if picture.rgb.iter().all(|light| *light == 0.0) {
                warnings.push("the picture is black: no lamp, no glowing surface and no sky of the scene lights what is seen".into());
            }
            Ok(DrawnPicture {
                picture: match layers {
                    true => tracers.layered(picture),
                    false => picture,
                },
                notes: DrawnPicture::notes(world, &panels, "path"),
                tracer: "path",
                samples: film.passes(),
                flagged: 0.0,
                unfinished: None,
                warnings,
            })
        })?;
        drawn.into_dict(py)
    }

    /// Compares the picture by a table with the exact one.
    fn compare<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&PyCamera>,
        request: PictureRequest,
        bundle: &PyBundle,
        light_file: Option<PathBuf>,
        frames: usize,
    ) -> PyResult<Compared<'py>> {
        let request = request.checked(py, PICTURES_COMPARED)?;
        if !(1..=1000).contains(&frames) {
            let message = format!("{frames} is not between 1 and 1000");
            return Err(refuse(py, "frames", message));
        }
        let mut staged = work::lock(py, &self.staged)?;
        let staged: &mut Staged = &mut staged;
        let found = work::run(py, About::Scene, |observer| {
            staged.0.check_bundle(&bundle.bundle)?;
            let view = request.panels(&self.about, camera)?.single()?;
            let length = bundle.bundle.table.length;
            light_up(staged, light_file.as_deref(), length, observer);
            let options = CompareOptions {
                samples: request.spp,
                promise: bundle.bundle.header.plan.max_error,
                error: request.error,
                tolerance: request.tolerance,
                frames,
            };
            compare(&staged.0.world, &view, &bundle.bundle.table, options)
        })?;
        compared(py, found)
    }

    /// Compares the picture by straight lines of the chart with the exact one.
    fn compare_local<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&PyCamera>,
        request: PictureRequest,
    ) -> PyResult<Compared<'py>> {
        let request = request.checked(py, PICTURES_COMPARED)?;
        let mut staged = work::lock(py, &self.staged)?;
        let staged: &mut Staged = &mut staged;
        let found = work::run(py, About::Scene, |observer| {
            let view = request.panels(&self.about, camera)?.single()?;
            let length = staged.0.world.manifold.length_or(request.length)?;
            light_up(staged, None, length, observer);
            let (samples, tolerance) = (request.spp, request.tolerance);
            let found: Result<Comparison<LocalReport>> =
                compare_local(&staged.0.world, &view, samples, length, tolerance);
            found
        })?;
        compared(py, found)
    }
}

/// Pictures that a comparison holds at once, about.
const PICTURES_COMPARED: usize = 4;

/// A comparison: report as JSON and as text, FLIP, pictures.
type Compared<'py> = (
    String,
    String,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyDict>,
);

/// Hands a comparison over.
fn compared<R: serde::Serialize + Display>(
    py: Python<'_>,
    found: Comparison<R>,
) -> PyResult<Compared<'_>> {
    let report = serde_json::to_string(&found.report);
    let report = report.map_err(|e| refuse(py, "compare", e.to_string()))?;
    let pictures = PyDict::new(py);
    for (name, picture) in found.pictures {
        pictures.set_item(name, arrays(py, picture)?.0)?;
    }
    let flip = PyArray2::from_owned_array(py, found.flip);
    Ok((report, found.report.to_string(), flip, pictures))
}

/// Lists what the user should know of a picture's shape and of where its paths end.
fn drawing_warnings(
    world: &World,
    panels: &PicturePanels,
    unfinished: &UnfinishedPaths,
    by_table: bool,
) -> Vec<String> {
    let longer = match by_table {
        true => "bake with a `length`",
        false => "give a `length`, here or to the manifold",
    };
    let remedy = format!("{longer}; or give the scene a `length` sky");
    let black = unfinished.warning("this view is black in parts", &remedy);
    let black = black.filter(|_| !world.has_length_sky());
    panels.warning().into_iter().chain(black).collect()
}

impl PyStage {
    fn made(py: Python<'_>, stage: Result<Stage>) -> PyResult<Self> {
        let stage = stage.map_err(|error| {
            let about = match &error {
                Error::Source(found) if is_manifold(&found.source) => About::Manifold,
                _ => About::Scene,
            };
            about.raise(py, error)
        })?;
        Ok(Self {
            about: StageNotes::new(&stage),
            staged: Mutex::new(Box::new((stage, None))),
        })
    }
}

/// Tells by its text whether a mistake is in a manifold file and not in a scene: scenes have no coordinates.
fn is_manifold(source: &SourceText) -> bool {
    let keys = source
        .text
        .lines()
        .filter_map(|line| line.split('=').next());
    keys.map(str::trim).any(|key| key == "coordinates")
}

/// Chooses where paths come from.
fn source<'b>(
    request: &PictureRequest,
    stage: &Stage,
    tracer: Option<&str>,
    bundle: Option<&'b PyBundle>,
) -> Result<PathSource<'b>> {
    let length = || stage.world.manifold.length_or(request.length);
    if bundle.is_some() && request.length.is_some() && tracer != Some("exact") {
        let message =
            "the paths of a bundle have their length; leave it out, or give the tracer `exact`";
        return Err(Error::input("length", message));
    }
    match (tracer, bundle) {
        (None | Some("table"), Some(bundle)) => {
            Ok(PathSource::table(&bundle.bundle, request.tolerance))
        }
        (Some("table"), None) => Err(Error::input(
            "tracer",
            "`table` needs a bundle; bake one with Manifold.bake",
        )),
        (Some("local"), Some(bundle)) => Ok(PathSource::Local(bundle.bundle.table.length)),
        (Some("local"), None) => Ok(PathSource::Local(length()?)),
        (None | Some("exact"), _) => Ok(PathSource::Exact(length()?)),
        (Some(other), _) => {
            let message = format!("`{other}` is none of table, exact, local, path");
            Err(Error::input("tracer", message))
        }
    }
}

/// Makes a mesh of vertices and faces, by way of the text of an OBJ file, whose reader checks it.
fn made_mesh(
    name: &str,
    vertices: &PyReadonlyArray2<'_, f64>,
    faces: &PyReadonlyArray2<'_, i64>,
    colour: [f32; 3],
    emission: [f32; 3],
) -> Result<Mesh> {
    let (vertices, faces) = (vertices.as_array(), faces.as_array());
    if vertices.dim().1 != 3 || !(3..=4).contains(&faces.dim().1) {
        let message = "vertices have 3 coordinates, faces 3 or 4 corners";
        return Err(Error::input(name, message));
    }
    let mut text = String::new();
    for (row, vertex) in vertices.rows().into_iter().enumerate() {
        if !vertex.iter().all(|x| x.is_finite()) {
            return Err(Error::input(name, format!("vertices[{row}] is not finite")));
        }
        let _ = writeln!(text, "v {} {} {}", vertex[0], vertex[1], vertex[2]);
    }
    let count = vertices.dim().0 as i64;
    for (row, face) in faces.rows().into_iter().enumerate() {
        if !face.iter().all(|corner| (0..count).contains(corner)) {
            let message = format!("faces[{row}] names a vertex that is not there");
            return Err(Error::input(name, message));
        }
        text.push('f');
        face.iter().for_each(|corner| {
            let _ = write!(text, " {}", corner + 1);
        });
        text.push('\n');
    }
    let mut mesh = Mesh::parse(name, &text, Path::new(""))?;
    for material in &mut mesh.materials {
        (material.kd, material.ke) = (colour, emission);
    }
    Ok(mesh)
}
