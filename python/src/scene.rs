//! Scenes: reading, lighting, drawing and comparing them.

use crate::{
    arrays::{positive, tolerance},
    bundle::Bundle,
    camera::Camera,
    errors::{About, refuse},
    manifold::Manifold,
    pictures::arrays,
    work,
};
use geofan_core::{
    Error, Observer, Progress, Result, diagnostic::SourceText, geodesic::check_point,
};
use geofan_light::{
    cache,
    path_tracer::{Estimator, PassAccumulator, PathTracer, PathTracerSettings},
};
use geofan_render::{
    self as render, DrawingOptions, ExactTracer, PathSource, View, World,
    frame::{Paths, offsets, trace},
    picture::Picture,
    scene::{Mesh, SceneFile},
    shade::with_layers,
};
use geofan_study::comparison::{CompareOptions, compare};
use numpy::{PyArray2, PyArray3, PyReadonlyArray2};
use pyo3::{prelude::*, types::PyDict};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

/// A scene with everything it names.
#[pyclass(frozen, module = "geofan._native")]
pub struct Stage {
    /// The library's, and over which length its surfaces are lit.
    staged: Mutex<(render::Stage, Option<f64>)>,
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
    size: (usize, usize),
    spp: usize,
    error: f64,
    tolerance: f64,
    length: Option<f64>,
}

/// The most pixels of a picture, and samples of a pixel.
const MOST_PIXELS: usize = 1 << 28;
const MOST_SAMPLES: usize = 4096;

impl PictureRequest {
    /// Checks the numbers.
    fn checked(self, py: Python<'_>) -> PyResult<Self> {
        let pixels = self.size.0.checked_mul(self.size.1);
        if !pixels.is_some_and(|pixels| (1..=MOST_PIXELS).contains(&pixels)) {
            let message = format!("a picture has 1 to {MOST_PIXELS} pixels");
            return Err(refuse(py, "size", message));
        }
        if !(1..=MOST_SAMPLES).contains(&self.spp) {
            let message = format!("{} is not between 1 and {MOST_SAMPLES}", self.spp);
            return Err(refuse(py, "spp", message));
        }
        positive(py, "error", self.error)?;
        tolerance(py, self.tolerance)?;
        self.length
            .map_or(Ok(0.0), |length| positive(py, "length", length))?;
        Ok(self)
    }

    fn drawing(&self) -> DrawingOptions {
        DrawingOptions {
            samples: self.spp,
            error: self.error,
            tolerance: self.tolerance,
            layers: false,
        }
    }

    /// Returns what `camera`, or the view that is named, sees.
    fn view(&self, stage: &render::Stage, camera: Option<&Camera>) -> Result<View> {
        let Some(camera) = camera else {
            return stage.view_of(self.view.as_deref(), self.size);
        };
        check_point(&stage.world.manifold, "camera", camera.placed.u)?;
        Ok(camera.view(self.size))
    }
}

#[pymethods]
impl Stage {
    /// Reads a scene file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, settings: Vec<(String, f64)>) -> PyResult<Self> {
        let stage = py.detach(|| render::Stage::load(&path, &settings));
        Self::made(py, stage)
    }

    /// Reads the text of a scene whose manifold, and some of whose meshes, are at hand.
    #[staticmethod]
    fn parse(
        py: Python<'_>,
        text: String,
        folder: PathBuf,
        manifold: &Manifold,
        meshes: Vec<MadeMesh<'_>>,
    ) -> PyResult<Self> {
        let mut shelf = Vec::new();
        for (name, vertices, faces, colour, emission) in &meshes {
            let mesh = made_mesh(name, vertices, faces, *colour, *emission);
            let mesh = mesh.map_err(|e| About::Scene.raise(py, e))?;
            shelf.push((folder.join(name), Arc::new(mesh)));
        }
        let stage = py.detach(|| {
            let scene = SceneFile::parse(SourceText::new("scene", text), &folder)?;
            let made: Vec<PathBuf> = shelf.iter().map(|(path, _)| path.clone()).collect();
            scene.check_files(&made)?;
            let world = World::furnished(&scene, manifold.space.clone(), shelf)?;
            Ok(render::Stage { scene, world })
        });
        Self::made(py, stage)
    }

    /// Returns the text of the scene.
    #[getter]
    fn text(&self) -> String {
        self.lock().0.scene.source.text.clone()
    }

    /// Returns the manifold.
    #[getter]
    fn manifold(&self) -> Manifold {
        Manifold {
            space: self.lock().0.world.manifold.clone(),
        }
    }

    /// Returns what was mended or left out while loading.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.lock().0.world.warnings.clone()
    }

    /// Returns the names of the scene's further views.
    #[getter]
    fn views(&self) -> Vec<String> {
        let staged = self.lock();
        let names = staged.0.scene.views.iter();
        names.filter_map(|view| view.name.clone()).collect()
    }

    /// Returns one of the scene's cameras.
    fn camera(&self, py: Python<'_>, name: Option<String>) -> PyResult<Camera> {
        let staged = self.lock();
        let stage = &staged.0;
        let raise = |e| About::Scene.raise(py, e);
        let view = stage.view_of(name.as_deref(), (2, 2)).map_err(raise)?;
        let entry = stage.camera(name.as_deref()).map_err(raise)?;
        Ok(Camera::placed(
            stage.world.manifold.clone(),
            view.camera(),
            entry.fov_degrees,
        ))
    }

    /// Draws a picture by table, exactly or to first order; returns light, layers, the tracer's name and the share
    /// of samples that the table gave up on.
    #[allow(clippy::too_many_arguments)]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&Camera>,
        request: PictureRequest,
        tracer: Option<String>,
        bundle: Option<&Bundle>,
        light_file: Option<PathBuf>,
        layers: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Rendered<'py>> {
        let request = request.checked(py)?;
        let (picture, tracer, flagged) =
            work::watch(py, About::Scene, progress.as_ref(), |observer| {
                let mut staged = self.lock();
                bundle.map_or(Ok(()), |b| staged.0.check_bundle(&b.bundle))?;
                let view = request.view(&staged.0, camera)?;
                let source = source(&request, &staged.0, tracer.as_deref(), bundle)?;
                let length = match bundle {
                    Some(bundle) => bundle.bundle.table.length,
                    None => staged.0.world.manifold.length_or(request.length)?,
                };
                light_up(&mut staged, light_file.as_deref(), length, observer)?;
                let world = &staged.0.world;
                let clock = &geofan_study::clock;
                let (drawing, _) =
                    source.draw(world, &view, request.drawing(), (&mut None, clock))?;
                let flagged = drawing.flagged_share();
                let picture = match layers {
                    true => drawing.layered(world, &view, request.drawing()),
                    false => drawing.picture,
                };
                Ok((picture, source.name(), flagged))
            })?;
        let (rgb, layers) = arrays(py, picture)?;
        Ok((rgb, layers, tracer, flagged))
    }

    /// Draws a picture by path tracing.
    #[allow(clippy::too_many_arguments)]
    fn path_trace<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&Camera>,
        request: PictureRequest,
        seed: u64,
        bounces: Option<u32>,
        layers: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Rendered<'py>> {
        let request = request.checked(py)?;
        let picture = work::watch(py, About::Scene, progress.as_ref(), |observer| {
            let staged = self.lock();
            let world = &staged.0.world;
            let view = request.view(&staged.0, camera)?;
            let settings = PathTracerSettings {
                seed,
                length: world.manifold.length_or(request.length)?,
                tolerance: request.tolerance,
                bounces: bounces.unwrap_or(u32::MAX),
                estimator: Estimator::Connected,
            };
            let picture = passes(world, &view, settings, request.spp, observer)?;
            Ok(match layers {
                true => first_hits(picture, world, &view, settings),
                false => picture,
            })
        })?;
        let (rgb, layers) = arrays(py, picture)?;
        Ok((rgb, layers, "path", 0.0))
    }

    /// Compares the picture by a table with the exact one; returns the report as JSON and as text, FLIP of every
    /// pixel, and the pictures by their names.
    fn compare<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&Camera>,
        request: PictureRequest,
        bundle: &Bundle,
        light_file: Option<PathBuf>,
        frames: usize,
    ) -> PyResult<Compared<'py>> {
        let request = request.checked(py)?;
        if !(1..=1000).contains(&frames) {
            return Err(refuse(
                py,
                "frames",
                format!("{frames} is not between 1 and 1000"),
            ));
        }
        let found = work::watch(py, About::Scene, None, |observer| {
            let mut staged = self.lock();
            staged.0.check_bundle(&bundle.bundle)?;
            let view = request.view(&staged.0, camera)?;
            let length = bundle.bundle.table.length;
            light_up(&mut staged, light_file.as_deref(), length, observer)?;
            let options = CompareOptions {
                samples: request.spp,
                promise: bundle.bundle.header.plan.max_error,
                error: request.error,
                tolerance: request.tolerance,
                frames,
            };
            compare(&staged.0.world, &view, &bundle.bundle.table, options)
        })?;
        let report = serde_json::to_string(&found.report);
        let report = report.map_err(|e| refuse(py, "compare", e.to_string()))?;
        let pictures = PyDict::new(py);
        for (name, picture) in found.pictures {
            pictures.set_item(name, arrays(py, picture)?.0)?;
        }
        let flip = PyArray2::from_owned_array(py, found.flip);
        Ok((report, found.report.to_string(), flip, pictures))
    }
}

/// A picture: light, layers, the tracer's name, the share of samples that a table gave up on.
type Rendered<'py> = (
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyDict>,
    &'static str,
    f64,
);

/// A comparison: report as JSON and as text, FLIP, pictures.
type Compared<'py> = (
    String,
    String,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyDict>,
);

type Staged = (render::Stage, Option<f64>);

impl Stage {
    fn made(py: Python<'_>, stage: Result<render::Stage>) -> PyResult<Self> {
        let stage = stage.map_err(|error| {
            let about = match &error {
                Error::Source(found) if is_manifold(&found.source) => About::Manifold,
                _ => About::Scene,
            };
            about.raise(py, error)
        })?;
        Ok(Self {
            staged: Mutex::new((stage, None)),
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Staged> {
        self.staged.lock().unwrap_or_else(PoisonError::into_inner)
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
    stage: &render::Stage,
    tracer: Option<&str>,
    bundle: Option<&'b Bundle>,
) -> Result<PathSource<'b>> {
    let length = || stage.world.manifold.length_or(request.length);
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

/// Lights the surfaces over `length`, unless they are already.
fn light_up(
    staged: &mut Staged,
    file: Option<&Path>,
    length: f64,
    observer: &dyn Observer,
) -> Result<()> {
    if staged.1 == Some(length) {
        return Ok(());
    }
    let lit = AtomicUsize::new(0);
    let done = |more: usize, all: usize| {
        let done = lit.fetch_add(more, Ordering::Relaxed) + more;
        observer.progress(Progress {
            work: "light",
            done: done as u64,
            total: all as u64,
            detail: "",
        });
    };
    cache::light_up(&mut staged.0.world, file, length, done)?;
    staged.1 = Some(length);
    Ok(())
}

/// Adds passes of the path tracer.
fn passes(
    world: &World,
    view: &View,
    settings: PathTracerSettings,
    count: usize,
    observer: &dyn Observer,
) -> Result<Picture> {
    let tracer = PathTracer::new(world, view, settings);
    let mut film = PassAccumulator::new(view.size);
    for number in 0..count as u64 {
        let pass = tracer.pass(number, || observer.cancelled());
        let Some(pass) = pass else {
            return Err(Error::Interrupted {
                resume: "nothing is kept".into(),
            });
        };
        film.add(&pass);
        observer.progress(Progress {
            work: "samples",
            done: number + 1,
            total: count as u64,
            detail: "",
        });
    }
    Ok(film.picture())
}

/// Adds the layers of what the camera's rays meet first.
fn first_hits(
    picture: Picture,
    world: &World,
    view: &View,
    settings: PathTracerSettings,
) -> Picture {
    let tracer = ExactTracer::new(&world.manifold, view.u, settings.length, settings.tolerance);
    let traced = trace(world, view, Paths::Exact(&tracer), &offsets(1));
    with_layers(picture, world, traced.outcomes.view(), &[])
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
