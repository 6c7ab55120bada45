//! Bundles: reading, baking, checking, and the accuracy of tables against their size. Paths of many rays are looked up
//! in [`paths`](crate::paths).

use crate::{
    arrays::{Columns, VectorRows, arc_lengths, positive, room, same_length, tolerance, zeros},
    manifold::{PyManifold, places},
    paths::{BLOCK, Places, TableTrace, TraceArrays, is_known_to_table, look_up, see_skies},
    work::{self, About, refuse, refuse_with_hint},
};
use geofan_bake::{BakeOptions, BakeResult, PROMISES, Share, bake, certify, merge};
use geofan_bundle::{Bundle, Fan, TangentPromise, container::VERSION};
use geofan_core::{
    Observer, Progress, Result,
    geodesic::{UnfinishedPaths, check_point},
};
use geofan_study::sweep::{MOST_CELLS, SweepOptions};
use glam::DVec3;
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict},
};
use rayon::prelude::*;
use serde_json::json;
use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

/// A bundle.
#[pyclass(frozen, name = "Bundle", module = "geofan._native")]
pub struct PyBundle {
    /// The library's.
    pub bundle: Arc<Bundle>,
}

#[pymethods]
impl PyBundle {
    /// Reads a bundle file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let bundle = work::watch(py, About::Input, None, |_| Bundle::read(&path))?;
        Ok(Self::new(bundle))
    }

    /// Reads the bytes of a bundle file.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        let bundle = work::run(py, About::Input, |_| Ok(Bundle::from_bytes(bytes)))?;
        let bundle = bundle.map_err(|e| refuse(py, "bundle", e.to_string()))?;
        Ok(Self::new(bundle))
    }

    /// Bakes a manifold, or a share of it, into the file `output`; returns the bundle, if it is a whole one, and
    /// what the user should know.
    #[staticmethod]
    #[allow(clippy::too_many_arguments)]
    fn bake(
        py: Python<'_>,
        manifold: &PyManifold,
        output: PathBuf,
        promises: (Option<f64>, Option<f64>),
        max_size: Option<u64>,
        length: Option<f64>,
        switches: (bool, bool, bool, bool),
        share: Option<(u32, u32)>,
        certify_rays: u64,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<(Option<Self>, Vec<String>)> {
        let (max_error, max_sky_error) = promises;
        check_promise(py, "max_error", max_error)?;
        check_promise(py, "max_sky_error", max_sky_error)?;
        check_rays(py, "certify_rays", certify_rays)?;
        if let Some((index, of)) = share.filter(|(index, of)| !(1..=*of).contains(index)) {
            let numbered = match of {
                0 => "(1, 4) is the first of four".to_string(),
                _ => format!("shares are numbered from 1 to {of}"),
            };
            let message = format!("({index}, {of}) is none: {numbered}");
            return Err(refuse(py, "share", message));
        }
        let (frames, mirrors, resume, wait) = switches;
        if !frames && max_sky_error.is_some() {
            let message = "without frames no directions are promised";
            return Err(refuse(py, "max_sky_error", message));
        }
        let options = BakeOptions {
            max_error,
            max_sky_error,
            max_size,
            length: Some(manifold.path_length(py, length)?),
            frames,
            mirrors,
            share: share.map(|(index, of)| Share { index, of }),
            resume,
            wait,
            certify_rays,
            ..BakeOptions::default()
        };
        let baked = work::watch(py, About::Input, progress.as_ref(), |observer| {
            bake(manifold.space.clone(), &output, &options, observer)
        })?;
        match baked {
            BakeResult::Bundle {
                bundle, unfinished, ..
            } => Ok(Self::made(*bundle, &unfinished)),
            BakeResult::TooLarge { reason, advice } => {
                Err(refuse_with_hint(py, "max_size", reason, advice))
            }
            BakeResult::Shard { .. } => Ok((None, Vec::new())),
        }
    }

    /// Joins the shares of one bake into the file `output`; returns the bundle and what the user should know.
    #[staticmethod]
    fn merge(
        py: Python<'_>,
        shares: Vec<PathBuf>,
        output: PathBuf,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<(Option<Self>, Vec<String>)> {
        if shares.is_empty() {
            return Err(refuse(py, "shares", "there is none"));
        }
        let merged = work::watch(py, About::Input, progress.as_ref(), |o| {
            let merged = merge(&shares, &output, o)?;
            Ok((Bundle::read(&output)?, merged.unfinished))
        });
        let (bundle, unfinished) = merged?;
        Ok(Self::made(bundle, &unfinished))
    }

    /// Returns the bytes of the file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let encoded = work::watch(py, About::Input, None, |_| {
            Ok(self.bundle.contents().encode())
        });
        let bytes = encoded?;
        let bytes = bytes.map_err(|e| refuse(py, "bundle", e.to_string()))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Writes the file and returns its size.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<u64> {
        let written = py.detach(|| self.bundle.write(&path));
        written.map_err(|e| About::Input.raise(py, e))
    }

    /// Returns the manifold.
    #[getter]
    fn manifold(&self) -> PyManifold {
        PyManifold {
            space: self.bundle.manifold.clone(),
        }
    }

    /// Returns the length of the paths.
    #[getter]
    fn length(&self) -> f64 {
        self.bundle.table.length
    }

    /// Returns the checksum by which it is known.
    #[getter]
    fn id(&self) -> String {
        let bytes = self.bundle.id.iter();
        bytes.map(|byte| format!("{byte:02x}")).collect()
    }

    /// Describes the bundle as JSON.
    fn info(&self, py: Python<'_>) -> PyResult<String> {
        let bundle = &self.bundle;
        let (header, plan) = (&bundle.header, &bundle.header.plan);
        let counts = work::run(py, About::Input, |_| Ok(bundle.table.counts()?))?;
        let parameters: serde_json::Map<_, _> = (header.manifold.parameters.iter())
            .map(|(name, value)| (name.clone(), json!(value)))
            .collect();
        let info = json!({
            "format": VERSION,
            "generator": header.generator,
            "id": self.id(),
            "name": header.manifold.name,
            "manifold": header.manifold.source,
            "parameters": parameters,
            "cameras": bundle.table.space.describe(),
            "reduction": header.reduction.name(),
            "stored_cameras": header.cameras,
            "mirrors": plan.mirrors.len(),
            "length": plan.length,
            "frames": plan.tangents != TangentPromise::None,
            "sky_promise": plan.tangents.mrad(plan.max_error),
            "promise": plan.max_error,
            "tolerance": plan.tolerance,
            "chunks": bundle.table.chunks.len(),
            "patches": counts.0,
            "flagged_boxes": counts.1,
            "certificate": header.certificate,
        });
        Ok(info.to_string())
    }

    /// Tells whether the certificate of the bundle keeps its promises; `None` without one.
    #[getter]
    fn kept(&self) -> Option<bool> {
        let header = &self.bundle.header;
        let certificate = header.certificate.as_ref()?;
        Some(header.plan.is_kept(certificate))
    }

    /// Tells whether it keeps what is promised of directions; `None` without any.
    #[getter]
    fn sky_kept(&self) -> Option<bool> {
        let header = &self.bundle.header;
        header.plan.is_sky_kept(header.certificate.as_ref()?)
    }

    /// Compares the table with exact paths of fresh random rays; returns JSON.
    fn check(
        &self,
        py: Python<'_>,
        rays: u64,
        seed: u64,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<String> {
        check_rays(py, "rays", rays)?;
        let plan = &self.bundle.header.plan;
        let checked = work::watch(py, About::Input, progress.as_ref(), |observer| {
            let done = AtomicU64::new(0);
            let told = |count| tell(observer, &done, count, rays);
            let (tolerance, promise) = (plan.tolerance, plan.max_error);
            certify(
                &self.bundle.table,
                rays as usize,
                seed,
                tolerance,
                promise,
                told,
            )
        })?;
        let worst: Vec<_> = (checked.worst.iter())
            .map(|outlier| json!({ "ray": outlier, "why": outlier.why() }))
            .collect();
        let report = json!({
            "certificate": checked.certificate,
            "kept": plan.is_kept(&checked.certificate),
            "sky_kept": plan.is_sky_kept(&checked.certificate),
            "promise": plan.max_error,
            "sky_promise": plan.tangents.mrad(plan.max_error),
            "beyond_20_promises": checked.far,
            "unfinished": checked.unfinished,
            "worst": worst,
        });
        Ok(report.to_string())
    }

    /// Reads paths as `geofan trace --bundle` does: each ended where its ray leaves.
    #[allow(clippy::too_many_arguments)]
    fn trace<'py>(
        &self,
        py: Python<'py>,
        at: PyReadonlyArray2<'py, f64>,
        direction: PyReadonlyArray2<'py, f64>,
        length: Option<f64>,
        samples: usize,
        accuracy: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let at = VectorRows::new(py, "at", &at)?;
        let directions = VectorRows::new(py, "direction", &direction)?;
        same_length(py, &at, &directions)?;
        let count = places(py, samples, None).map(|places| Places::count(&places))?;
        let request = TableTrace {
            bundle: &self.bundle,
            at: &at,
            directions: &directions,
            length: self.length_within(py, "length", length)?,
            samples: count,
            tolerance: tolerance(py, accuracy)?,
        };
        let rays = at.len();
        let frames = request.has_frames();
        let wanted = |column| is_known_to_table(column, frames);
        let arrays = TraceArrays::new(py, rays, count, wanted)?;
        let exact = arrays.fill(|columns| {
            work::run(py, About::Input, |observer| {
                let blocks = columns.blocks(rays, BLOCK).into_par_iter().enumerate();
                let exact: Result<Vec<Vec<bool>>> = blocks
                    .map(|(i, columns)| request.block(i * BLOCK, columns, observer))
                    .collect();
                Ok(exact?.concat())
            })
        })?;
        let dict = arrays.into_dict(py)?;
        dict.set_item("exact", PyArray1::from_vec(py, exact))?;
        Ok(dict)
    }

    /// Looks up points and tangents of the rays from one camera at the same arc lengths.
    fn paths<'py>(
        &self,
        py: Python<'py>,
        camera: [f64; 3],
        directions: PyReadonlyArray2<'py, f64>,
        s: PyReadonlyArray1<'py, f64>,
        accuracy: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let directions = VectorRows::new(py, "directions", &directions)?;
        let s = arc_lengths(py, &s)?;
        let (rays, samples) = (directions.len(), s.len());
        self.length_within(py, "s", s.last().copied().filter(|s| *s > 0.0))?;
        room(py, "s", &[rays, samples, 6])?;
        let accuracy = tolerance(py, accuracy)?;
        let floats = [
            zeros(py, rays * samples * 3)?,
            zeros(py, rays * samples * 3)?,
        ];
        let flagged = zeros(py, rays)?;
        {
            let mut floats = floats.each_ref().map(|array| array.readwrite());
            let mut flagged = flagged.readwrite();
            let columns = Columns {
                floats: floats.each_mut().map(|array| {
                    let column = array.as_slice_mut().expect("a fresh array is contiguous");
                    (column, 3 * samples)
                }),
                integers: [flagged.as_slice_mut()?],
            };
            work::run(py, About::Input, |observer| {
                let fan = self.fan(camera)?;
                let blocks = columns.blocks(rays, BLOCK).into_par_iter().enumerate();
                blocks.try_for_each(|(i, columns)| {
                    look_up(
                        &fan,
                        (&directions, i * BLOCK),
                        &s,
                        accuracy,
                        columns,
                        observer,
                    )
                })
            })?;
        }
        let dict = PyDict::new(py);
        let [u, v] = floats;
        dict.set_item("u", u)?;
        dict.set_item("v", v)?;
        dict.set_item("flagged", flagged)?;
        Ok(dict)
    }

    /// Tells where the rays from one camera leave, and in which directions their skies are looked up.
    fn sky<'py>(
        &self,
        py: Python<'py>,
        camera: [f64; 3],
        directions: PyReadonlyArray2<'py, f64>,
        accuracy: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let directions = VectorRows::new(py, "directions", &directions)?;
        let (rays, accuracy) = (directions.len(), tolerance(py, accuracy)?);
        room(py, "directions", &[rays, 8])?;
        let widths = [3, 3, 1];
        let floats = [zeros(py, rays * 3)?, zeros(py, rays * 3)?, zeros(py, rays)?];
        let end = zeros(py, rays)?;
        {
            let mut floats = floats.each_ref().map(|array| array.readwrite());
            let mut end = end.readwrite();
            let mut widths = widths.into_iter();
            let columns = Columns {
                floats: floats.each_mut().map(|array| {
                    let column = array.as_slice_mut().expect("a fresh array is contiguous");
                    (column, widths.next().unwrap_or(1))
                }),
                integers: [end.as_slice_mut()?],
            };
            work::run(py, About::Input, |observer| {
                let fan = self.fan(camera)?;
                let length = self.bundle.table.length;
                let blocks = columns.blocks(rays, BLOCK).into_par_iter().enumerate();
                blocks.try_for_each(|(i, columns)| {
                    see_skies(
                        &fan,
                        (&directions, i * BLOCK),
                        length,
                        accuracy,
                        columns,
                        observer,
                    )
                })
            })?;
        }
        let dict = PyDict::new(py);
        for (name, array) in ["u", "direction", "length"].into_iter().zip(floats) {
            dict.set_item(name, array)?;
        }
        dict.set_item("end", end)?;
        Ok(dict)
    }
}

impl PyBundle {
    fn new(bundle: Bundle) -> Self {
        Self {
            bundle: Arc::new(bundle),
        }
    }

    /// Wraps what was baked, with what the user should know of it.
    fn made(bundle: Bundle, unfinished: &UnfinishedPaths) -> (Option<Self>, Vec<String>) {
        let plan = &bundle.header.plan;
        let short = "bake with a greater `length`";
        let short = unfinished.warning("paths end before they leave", short);
        let short = short.filter(|_| bundle.manifold.domain.has_exits());
        let certificate = bundle.header.certificate.as_ref();
        let broken = certificate.filter(|found| !plan.is_kept(found)).map(|_| {
            let promises = plan.promises(&bundle.table.space);
            format!("the promise is not kept ({promises}); see `certificate`")
        });
        let broken = broken.or_else(|| plan.sky_excess(certificate?));
        let warnings = short.into_iter().chain(broken).collect();
        (Some(Self::new(bundle)), warnings)
    }

    /// Contracts the table to the fan of a camera.
    fn fan(&self, camera: [f64; 3]) -> Result<Fan> {
        let u = DVec3::from_array(camera);
        check_point(&self.bundle.manifold, "camera", u)?;
        Ok(self.bundle.fan(u)?)
    }

    /// Returns the length to follow paths over, at most that of the table.
    fn length_within(&self, py: Python<'_>, name: &str, asked: Option<f64>) -> PyResult<f64> {
        let most = self.bundle.table.length;
        match asked {
            None => Ok(most),
            Some(length) if positive(py, name, length)? <= most => Ok(length),
            Some(_) => {
                let message = format!("the bundle's paths end at {most}");
                Err(refuse(py, name, message))
            }
        }
    }
}

/// Checks a promise, mrad.
fn check_promise(py: Python<'_>, name: &str, promise: Option<f64>) -> PyResult<()> {
    let Some(promise) = promise.filter(|promise| !PROMISES.contains(promise)) else {
        return Ok(());
    };
    let (start, end) = (PROMISES.start(), PROMISES.end());
    let message = format!("{promise} does not lie between {start} and {end} mrad");
    Err(refuse(py, name, message))
}

/// Checks a number of random rays.
fn check_rays(py: Python<'_>, name: &str, rays: u64) -> PyResult<()> {
    match (1..=1_000_000_000).contains(&rays) {
        true => Ok(()),
        false => Err(refuse(
            py,
            name,
            format!("{rays} is not between 1 and 1000000000"),
        )),
    }
}

/// Tells an observer that `count` more rays have been compared; an error if it ends the work.
fn tell(observer: &dyn Observer, done: &AtomicU64, count: u64, total: u64) -> Result<()> {
    let done = done.fetch_add(count, Ordering::Relaxed) + count;
    observer.progress(Progress {
        work: "checking",
        done,
        total,
        detail: "",
    });
    work::go_on(observer)
}

/// Measures tables of manifold files into a folder; returns how many points there are and how many were measured.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn sweep(
    py: Python<'_>,
    manifolds: Vec<PathBuf>,
    out: PathBuf,
    quick: bool,
    max_error: Vec<f64>,
    cells: Vec<f64>,
    rays: Option<usize>,
    seed: u64,
    progress: Option<Py<PyAny>>,
) -> PyResult<(usize, usize)> {
    if manifolds.is_empty() {
        return Err(refuse(py, "manifolds", "there is none"));
    }
    if let Some(promise) = max_error.iter().find(|promise| !PROMISES.contains(promise)) {
        let (start, end) = (PROMISES.start(), PROMISES.end());
        let message = format!("{promise} does not lie between {start} and {end} mrad");
        return Err(refuse(py, "max_error", message));
    }
    if let Some(cells) = cells
        .iter()
        .find(|cells| !(**cells > 0.0 && **cells <= MOST_CELLS))
    {
        let message = format!("{cells} is not above 0 and at most {MOST_CELLS}");
        return Err(refuse(py, "cells", message));
    }
    if let Some(rays) = rays.filter(|rays| !(100..=10_000_000).contains(rays)) {
        let message = format!("{rays} is not between 100 and 10000000");
        return Err(refuse(py, "rays", message));
    }
    let options = SweepOptions {
        manifolds,
        out,
        quick,
        max_error,
        cells,
        rays,
        export_npz: false,
        seed,
        tensor: None,
        command: "geofan.sweep(...)".into(),
    };
    let summary = work::watch(py, About::Manifold, progress.as_ref(), |observer| {
        geofan_study::sweep::run(&options, observer)
    })?;
    Ok((summary.points, summary.measured))
}
