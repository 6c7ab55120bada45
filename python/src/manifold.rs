//! Manifolds: reading, geometry at many points, transport, exact paths.

use crate::{
    arrays::{VectorRows, arc_lengths, positive, room, same_length, tolerance, zeros},
    paths::{self, BLOCK, Places, TraceRequest},
    work::{self, About, refuse},
};
use geofan_bake::plan::discrete_symmetries;
use geofan_bundle::rays::RaySpace;
use geofan_core::{
    Error, Result,
    diagnostic::{Diagnostic, SourceText},
    field::Samples,
    geodesic::{
        check_inside, check_jumps, check_point, to_nearest_image, transport, transport_piece,
    },
    manifold::{Carried, ChartCurve, Manifold},
};
use glam::{DMat3, DVec3};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::{prelude::*, types::PyDict};
use rayon::prelude::*;
use std::{borrow::Cow, path::PathBuf, sync::Arc};

/// A manifold.
#[pyclass(frozen, name = "Manifold", module = "geofan._native")]
pub struct PyManifold {
    /// The library's.
    pub space: Arc<Manifold>,
}

/// Writes the numbers of a quantity at a point.
type Quantity = fn(&Manifold, DVec3, &mut [f64]) -> Result<()>;

/// Finds a quantity at a point by the name of the method that returns it; returns how many numbers it has, too.
fn quantity_named(name: &str) -> Option<(usize, Quantity)> {
    Some(match name {
        "metric" => (9, |space, u, out| {
            out.copy_from_slice(&rows(space.metric(u)));
            Ok(())
        }),
        "inverse" => (9, |space, u, out| {
            out.copy_from_slice(&rows(space.curvature(u)?.inverse));
            Ok(())
        }),
        "frame" => (9, |space, u, out| {
            out.copy_from_slice(&space.standard_frame(u).to_cols_array());
            Ok(())
        }),
        "connection" => (27, |space, u, out| {
            for (out, omega) in out.chunks_exact_mut(9).zip(space.connection(u)) {
                out.copy_from_slice(&rows(omega));
            }
            Ok(())
        }),
        "christoffel" => (27, |space, u, out| {
            let christoffel = space.curvature(u)?.christoffel;
            out.copy_from_slice(christoffel.as_flattened().as_flattened());
            Ok(())
        }),
        "riemann" => (81, |space, u, out| {
            let riemann = space.curvature(u)?.riemann;
            out.copy_from_slice(riemann.as_flattened().as_flattened().as_flattened());
            Ok(())
        }),
        "ricci" => (9, |space, u, out| {
            out.copy_from_slice(&rows(space.curvature(u)?.ricci));
            Ok(())
        }),
        "scalar" => (1, |space, u, out| {
            out[0] = space.curvature(u)?.scalar;
            Ok(())
        }),
        _ => return None,
    })
}

/// Returns a matrix by rows.
fn rows(m: DMat3) -> [f64; 9] {
    m.transpose().to_cols_array()
}

#[pymethods]
impl PyManifold {
    /// Reads a manifold file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, settings: Vec<(String, f64)>) -> PyResult<Self> {
        let loaded = py.detach(|| Manifold::load(&path, &settings));
        Self::made(py, loaded)
    }

    /// Reads the text of a manifold file; samples of fields that are not given are read from the files that it names.
    #[staticmethod]
    fn parse(
        py: Python<'_>,
        name: String,
        text: String,
        settings: Vec<(String, f64)>,
        samples: Vec<(String, Vec<u8>)>,
    ) -> PyResult<Self> {
        if text.contains('\0') {
            return Err(refuse(py, &name, "is not text: it holds NUL bytes"));
        }
        let source = SourceText::new(name, text);
        let unpacked = |(field, bytes): (String, Vec<u8>)| match Samples::unpack(&bytes) {
            Ok(samples) => Ok((field, Arc::new(samples))),
            Err(fault) => Err(refuse(py, "samples", fault.to_string())),
        };
        let samples = samples
            .into_iter()
            .map(unpacked)
            .collect::<PyResult<Vec<_>>>()?;
        let loaded = py.detach(|| Manifold::with_samples(source, &settings, &samples));
        Self::made(py, loaded)
    }

    /// Returns the manifold with these values of parameters.
    fn set(&self, py: Python<'_>, settings: Vec<(String, f64)>) -> PyResult<Self> {
        let (source, fields) = (self.space.source.clone(), self.space.fields.iter());
        let samples: Vec<_> = fields
            .map(|field| (field.name.clone(), field.samples.clone()))
            .collect();
        let loaded = py.detach(|| Manifold::with_samples(source, &settings, &samples));
        Self::made(py, loaded)
    }

    /// Returns the samples of its fields, packed, by their names.
    fn samples(&self, py: Python<'_>) -> Vec<(String, Cow<'static, [u8]>)> {
        let fields = self.space.fields.iter();
        let packed = fields.map(|field| (field.name.clone(), field.samples.pack().into()));
        py.detach(|| packed.collect())
    }

    /// Returns a hash of the text, the parameters and the samples of fields.
    #[getter]
    fn fingerprint(&self) -> Cow<'static, [u8]> {
        self.space.fingerprint().to_vec().into()
    }

    /// Returns name and text of the file.
    #[getter]
    fn source(&self) -> (String, String) {
        let source = &self.space.source;
        (source.name.clone(), source.text.clone())
    }

    /// Returns the name.
    #[getter]
    fn name(&self) -> String {
        self.space.name.clone()
    }

    /// Returns the names of the coordinates.
    #[getter]
    fn coordinates(&self) -> (String, String, String) {
        self.space.coordinates.clone().into()
    }

    /// Returns the parameters, as set.
    #[getter]
    fn parameters(&self) -> Vec<(String, f64)> {
        self.space.parameters.clone()
    }

    /// Returns the names of the ways in which a path can end, in the order of their numbers.
    #[getter]
    fn ends(&self) -> Vec<String> {
        let exits = self.space.exits.iter().map(|exit| exit.name.clone());
        exits.chain(["length".into(), "singular".into()]).collect()
    }

    /// Returns how far paths are followed, if the file says.
    #[getter]
    fn length(&self) -> Option<f64> {
        self.space.length
    }

    /// Returns the dimension of the ambient space of an embedding.
    #[getter]
    fn ambient(&self) -> Option<usize> {
        self.space.ambient
    }

    /// Names what the file gives: embedding, metric or spacetime.
    #[getter]
    fn form(&self) -> &'static str {
        self.space.form.name()
    }

    /// Returns the names and intervals of camera parameters; `None` without a region.
    #[getter]
    fn cameras(&self) -> Option<Vec<(String, [f64; 2])>> {
        let region = self.space.cameras.as_ref()?;
        let names = region.names.iter().cloned();
        Some(names.zip(region.intervals.iter().copied()).collect())
    }

    /// Describes the space: lines by their titles.
    fn lines(&self) -> Vec<(&'static str, String)> {
        let space = &self.space;
        let mut lines = vec![("given by", space.form.name().to_string())];
        let medium = space.medium_names();
        if !medium.is_empty() {
            lines.push(("light", format!("meets {}", medium.join(" and "))));
        }
        lines.extend(
            space
                .domain_lines()
                .into_iter()
                .map(|line| ("domain", line)),
        );
        let exits: Vec<&str> = space.exits.iter().map(|exit| exit.name.as_str()).collect();
        lines.push(("exits", exits.join(", ")));
        lines.push(("symmetry", space.symmetry_line()));
        lines.push(("cameras", space.cameras_line()));
        lines
    }

    /// Counts the reflections and exchanges of coordinates that a bake finds and uses.
    fn mirrors(&self, py: Python<'_>, length: Option<f64>) -> PyResult<usize> {
        let length = self.path_length(py, length)?;
        let found = work::watch(py, About::Input, None, |observer| {
            let rays = RaySpace::new(self.space.clone())?;
            discrete_symmetries(&rays, length, observer)
        })?;
        Ok(found.len())
    }

    /// Tells whether two manifolds mean the same geometry; lists what differs.
    fn differences(&self, other: &Self) -> Vec<String> {
        self.space.differences(&other.space)
    }

    /// Returns the chart point at camera parameters.
    fn camera_point(&self, py: Python<'_>, given: Vec<(String, f64)>) -> PyResult<[f64; 3]> {
        let Some(region) = &self.space.cameras else {
            return Err(refuse(
                py,
                "parameters",
                "the manifold has no camera region",
            ));
        };
        let value = |name: &String| {
            let found = given.iter().find(|(n, _)| n == name);
            found.map(|(_, value)| *value)
        };
        let values: Option<Vec<f64>> = region.names.iter().map(value).collect();
        match values.filter(|values| values.len() == given.len() && region.contains(values)) {
            Some(values) => Ok(region.at(&values).to_array()),
            None => Err(refuse(
                py,
                "parameters",
                format!("the camera parameters are: {}", self.space.cameras_line()),
            )),
        }
    }

    /// Returns a quantity at many points, flattened.
    fn at<'py>(
        &self,
        py: Python<'py>,
        quantity: &str,
        u: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let points = VectorRows::new(py, "u", &u)?;
        let Some((width, write)) = quantity_named(quantity) else {
            return Err(refuse(py, "quantity", format!("`{quantity}` is not known")));
        };
        room(py, "u", &[points.len(), width])?;
        let result = zeros(py, points.len() * width)?;
        {
            let mut values = result.readwrite();
            let values = values.as_slice_mut()?;
            let manifold = &self.space;
            work::run(py, About::Input, |observer| {
                let blocks = values.par_chunks_mut(BLOCK * width).enumerate();
                blocks.try_for_each(|(block, values)| {
                    work::go_on(observer)?;
                    for (i, out) in values.chunks_exact_mut(width).enumerate() {
                        let row = block * BLOCK + i;
                        let u = points.at(row);
                        check_point(manifold, &points.label(row), u)?;
                        write(manifold, u, out)?;
                    }
                    Ok(())
                })
            })?;
        }
        Ok(result)
    }

    /// Returns the matrix of parallel transport along a curve given by expressions of `t`.
    fn transport_along(
        &self,
        py: Python<'_>,
        curve: [String; 3],
        interval: [f64; 2],
        accuracy: f64,
    ) -> PyResult<[[f64; 3]; 3]> {
        let accuracy = tolerance(py, accuracy)?;
        if !interval.iter().all(|t| t.is_finite()) {
            return Err(refuse(py, "interval", "is not finite"));
        }
        let components = [&curve[0], &curve[1], &curve[2]].map(String::as_str);
        let parsed = ChartCurve::parse(&self.space, "t", components);
        let parsed = parsed.map_err(|(i, fault)| {
            let source = SourceText::new(format!("curve[{i}]"), curve[i].as_str());
            let complaint = Diagnostic::new(&source, fault.span, fault.message);
            let complaint = match fault.hint {
                Some(hint) => complaint.with_hint(hint),
                None => complaint,
            };
            About::Manifold.raise(py, complaint.into())
        })?;
        let moved = work::run(py, About::Input, |_| {
            let (space, curve) = (&*self.space, |t| parsed.at(t));
            let length = check_inside(space, "curve", curve, interval, 1)?;
            check_jumps(space, "curve", curve, interval, length)?;
            let found = transport(space, curve, interval, accuracy);
            found.map_err(|e| Error::input("curve", e.to_string()))
        })?;
        Ok(moved.matrix().transpose().to_cols_array_2d())
    }

    /// Returns the matrix of parallel transport along straight lines of the chart between points.
    fn transport_through(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        accuracy: f64,
    ) -> PyResult<[[f64; 3]; 3]> {
        let accuracy = tolerance(py, accuracy)?;
        let curve = VectorRows::new(py, "curve", &points)?;
        let moved = work::run(py, About::Input, |observer| {
            for row in 0..curve.len() {
                work::go_on(observer)?;
                check_point(&self.space, &curve.label(row), curve.at(row))?;
            }
            let mut moved = DMat3::IDENTITY;
            for row in 1..curve.len() {
                work::go_on(observer)?;
                let (from, to) = (curve.at(row - 1), curve.at(row));
                check_joined(&self.space, &curve.label(row), [from, to])?;
                let along = to - from;
                let line = |t: f64| (from + along * t, along);
                let pieces = curve.len() - 1;
                check_inside(&self.space, &curve.label(row), line, [0.0, 1.0], pieces)?;
                let found = transport_piece(&self.space, line, [0.0, 1.0], accuracy, pieces);
                let found = found.map_err(|e| Error::input(curve.label(row), e.to_string()))?;
                moved = found.matrix() * moved;
            }
            Ok(moved)
        })?;
        Ok(moved.transpose().to_cols_array_2d())
    }

    /// Follows rays exactly.
    #[allow(clippy::too_many_arguments)]
    fn trace<'py>(
        &self,
        py: Python<'py>,
        at: PyReadonlyArray2<'py, f64>,
        direction: PyReadonlyArray2<'py, f64>,
        length: Option<f64>,
        samples: usize,
        s: Option<PyReadonlyArray1<'py, f64>>,
        accuracy: f64,
        forward: bool,
        carried: (bool, bool),
        conjugate: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let at = VectorRows::new(py, "at", &at)?;
        let directions = VectorRows::new(py, "direction", &direction)?;
        same_length(py, &at, &directions)?;
        let places = places(py, samples, s.as_ref())?;
        let asked = length.or_else(|| match &places {
            Places::At(s) => s.last().copied().filter(|s| *s > 0.0),
            Places::Even(_) => None,
        });
        let manifold = match forward {
            true => self
                .space
                .forward()
                .map_err(|e| About::Input.raise(py, e))?,
            false => Cow::Borrowed(&*self.space),
        };
        let request = TraceRequest {
            length: self.path_length(py, asked)?,
            manifold: &manifold,
            places,
            tolerance: tolerance(py, accuracy)?,
            carried: Carried {
                frame: carried.0,
                deviation: carried.1 || conjugate,
            },
            conjugate,
        };
        paths::trace(py, &request, &at, &directions)
    }

    /// Finds all geodesics from a point to others.
    fn connect<'py>(
        &self,
        py: Python<'py>,
        p: [f64; 3],
        q: PyReadonlyArray2<'py, f64>,
        length: Option<f64>,
        accuracy: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let points = VectorRows::new(py, "q", &q)?;
        let (length, accuracy) = (self.path_length(py, length)?, tolerance(py, accuracy)?);
        paths::connect(
            py,
            &self.space,
            DVec3::from_array(p),
            &points,
            length,
            accuracy,
        )
    }
}

impl PyManifold {
    /// Wraps what was loaded.
    fn made(py: Python<'_>, loaded: Result<Manifold>) -> PyResult<Self> {
        let space = loaded.map_err(|error| About::Manifold.raise(py, error))?;
        Ok(Self {
            space: Arc::new(space),
        })
    }

    /// Returns the length to follow paths over: the one asked for, or the file's.
    pub fn path_length(&self, py: Python<'_>, asked: Option<f64>) -> PyResult<f64> {
        match asked {
            Some(length) => positive(py, "length", length),
            None => {
                let length = self.space.length_or(None);
                length.map_err(|_| {
                    refuse(
                        py,
                        "length",
                        "the manifold has no `length` under [cameras]; give one",
                    )
                })
            }
        }
    }
}

/// Refuses the straight line from one point to the next where it goes the long way round a coordinate that is glued, as from
/// samples of a path, which are between its limits.
fn check_joined(manifold: &Manifold, subject: &str, [from, to]: [DVec3; 2]) -> Result<()> {
    let longer = to - from - to_nearest_image(manifold, from, to);
    match (0..3).find(|k| longer[*k] != 0.0) {
        Some(k) => Err(Error::input(
            subject,
            format!(
                "is more than half a period of `{}` away from the point before it: let the coordinate go on over its limits (numpy.unwrap), or give points between them",
                manifold.coordinates[k]
            ),
        )),
        None => Ok(()),
    }
}

/// Reads where samples are wanted.
pub fn places(
    py: Python<'_>,
    samples: usize,
    s: Option<&PyReadonlyArray1<'_, f64>>,
) -> PyResult<Places> {
    match s {
        Some(s) => {
            room(py, "s", &[s.len()])?;
            Ok(Places::At(arc_lengths(py, s)?))
        }
        None if (2..=MOST_SAMPLES).contains(&samples) => Ok(Places::Even(samples)),
        None => Err(refuse(
            py,
            "samples",
            format!("{samples} is not between 2 and {MOST_SAMPLES}"),
        )),
    }
}

/// The most samples of a path.
const MOST_SAMPLES: usize = 10_000_000;

/// Copies vectors into an array of rows.
pub fn vectors<'py>(
    py: Python<'py>,
    vectors: impl ExactSizeIterator<Item = DVec3>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let count = vectors.len();
    let numbers: Vec<f64> = vectors.flat_map(|v| v.to_array()).collect();
    PyArray1::from_vec(py, numbers).reshape([count, 3])
}
