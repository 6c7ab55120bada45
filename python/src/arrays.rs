//! Arrays from Python, checked, and results of many rays, written side by side by many threads.
//!
//! In: numpy arrays of any strides, so that broadcast ones are not copied. Out: rows as vectors, or an
//! `InputError` that names the array and the row.
//!
//! In: numpy arrays whose first axis counts rays. Out: their slices, cut into blocks of rays ([`Columns`]), so that
//! each thread writes its rays where Python reads them and nothing is copied.

use crate::work::refuse;
use geofan_core::{
    Error, Result,
    geodesic::{TOLERANCES, unit},
};
use glam::DVec3;
use ndarray::ArrayView2;
use numpy::{Element, PyArray1, PyReadonlyArray1, PyReadonlyArray2, dtype};
use pyo3::{prelude::*, sync::PyOnceLock};

/// Rows of three numbers with the name of their argument.
#[derive(Clone, Copy)]
pub struct VectorRows<'a> {
    name: &'a str,
    rows: ArrayView2<'a, f64>,
}

impl<'a> VectorRows<'a> {
    /// Wraps the argument `name`.
    pub fn new(
        py: Python<'_>,
        name: &'a str,
        array: &'a PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let rows = array.as_array();
        match rows.dim().1 {
            3 => Ok(Self { name, rows }),
            n => Err(refuse(
                py,
                name,
                format!("the last axis has {n} entries, 3 are needed"),
            )),
        }
    }

    /// Counts the rows.
    pub fn len(&self) -> usize {
        self.rows.dim().0
    }

    /// Returns a row.
    pub fn at(&self, row: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| self.rows[(row, k)]))
    }

    /// Names a row, for complaints.
    pub fn label(&self, row: usize) -> String {
        match self.len() {
            1 => self.name.to_string(),
            _ => format!("{}[{row}]", self.name),
        }
    }

    /// Returns a row as a direction of unit length.
    ///
    /// # Errors
    /// It has none.
    pub fn direction(&self, row: usize) -> Result<DVec3> {
        unit(self.at(row)).ok_or_else(|| {
            Error::input(
                self.label(row),
                "a direction must be finite and not be zero",
            )
        })
    }

    /// Returns all rows, if they are finite.
    ///
    /// # Errors
    /// One is not.
    pub fn finite(&self) -> Result<Vec<DVec3>> {
        let finite = |row| match self.at(row) {
            v if v.is_finite() => Ok(v),
            _ => Err(Error::input(self.label(row), "is not finite")),
        };
        (0..self.len()).map(finite).collect()
    }
}

/// Checks that two arrays have as many rows.
pub fn same_length(py: Python<'_>, a: &VectorRows<'_>, b: &VectorRows<'_>) -> PyResult<()> {
    match a.len() == b.len() {
        true => Ok(()),
        false => Err(refuse(
            py,
            b.name,
            format!("has {} rows, `{}` has {}", b.len(), a.name, a.len()),
        )),
    }
}

/// Checks a number that must be finite and above zero.
pub fn positive(py: Python<'_>, name: &str, value: f64) -> PyResult<f64> {
    match value.is_finite() && value > 0.0 {
        true => Ok(value),
        false => Err(refuse(
            py,
            name,
            format!("{value} is not finite and above zero"),
        )),
    }
}

/// Checks the tolerance of an integration.
pub fn tolerance(py: Python<'_>, value: f64) -> PyResult<f64> {
    match TOLERANCES.contains(&value) {
        true => Ok(value),
        false => Err(refuse(
            py,
            "tolerance",
            format!(
                "{value:e} does not lie between {:e} and {:e}",
                TOLERANCES.start(),
                TOLERANCES.end()
            ),
        )),
    }
}

/// Returns arc lengths that are finite, not negative and ascending.
pub fn arc_lengths(py: Python<'_>, array: &PyReadonlyArray1<'_, f64>) -> PyResult<Vec<f64>> {
    let s: Vec<f64> = array.as_array().iter().copied().collect();
    let sound = s.iter().all(|x| x.is_finite() && *x >= 0.0);
    match sound && s.is_sorted() && !s.is_empty() {
        true => Ok(s),
        false => Err(refuse(
            py,
            "s",
            "arc lengths must be finite, not negative and ascending, and there must be one",
        )),
    }
}

/// Checks that an array of so many numbers can be made.
pub fn room(py: Python<'_>, name: &str, counts: &[usize]) -> PyResult<()> {
    let bytes = counts.iter().try_fold(8_usize, |n, c| n.checked_mul(*c));
    memory(py, name, bytes)
}

/// Refuses what would take more bytes than may be taken on this machine; `None` is more than can be counted.
pub fn memory(py: Python<'_>, name: &str, bytes: Option<usize>) -> PyResult<()> {
    if bytes.is_some_and(|bytes| bytes <= SMALL) {
        return Ok(());
    }
    let most: usize = py
        .import("geofan._memory")?
        .getattr("most_bytes")?
        .call0()?
        .extract()?;
    let Some(bytes) = bytes else {
        return Err(refuse(py, name, "the result would not fit into memory"));
    };
    match bytes <= most {
        true => Ok(()),
        false => {
            let [bytes, most] = [bytes, most].map(|n| n as f64 / 1e9);
            let message = format!(
                "the result takes {bytes:.1} GB of memory, of which {most:.1} GB are free to use"
            );
            Err(refuse(py, name, message))
        }
    }
}

/// Bytes that are taken without asking how many there are.
const SMALL: usize = 1 << 26;

/// Makes an array of zeros. If there is not enough memory, numpy says so, where its interface for Rust panics.
pub fn zeros<T: Element>(py: Python<'_>, count: usize) -> PyResult<Bound<'_, PyArray1<T>>> {
    static ZEROS: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let zeros = ZEROS.import(py, "numpy", "zeros")?;
    let made = zeros.call1((count, dtype::<T>(py)))?;
    Ok(made.cast_into::<PyArray1<T>>()?)
}

/// Columns of the rays of a block; those that are not wanted are empty.
pub struct Columns<'a, const F: usize, const I: usize> {
    /// Columns of numbers, with how many each ray has.
    pub floats: [(&'a mut [f64], usize); F],
    /// Columns of whole numbers, one a ray.
    pub integers: [&'a mut [i32]; I],
}

impl<'a, const F: usize, const I: usize> Columns<'a, F, I> {
    /// Cuts them after so many rays.
    fn split(self, rays: usize) -> (Self, Self) {
        let floats = self.floats.map(|(column, width)| {
            let (head, tail) = column.split_at_mut((rays * width).min(column.len()));
            ((head, width), (tail, width))
        });
        let integers = self
            .integers
            .map(|column| column.split_at_mut(rays.min(column.len())));
        let (mut heads, mut tails) = (Vec::new(), Vec::new());
        for (head, tail) in floats {
            heads.push(head);
            tails.push(tail);
        }
        let (mut first, mut last) = (Vec::new(), Vec::new());
        for (head, tail) in integers {
            first.push(head);
            last.push(tail);
        }
        let join = |floats: Vec<_>, integers: Vec<_>| Self {
            floats: floats
                .try_into()
                .unwrap_or_else(|_| unreachable!("as many as before")),
            integers: integers
                .try_into()
                .unwrap_or_else(|_| unreachable!("as many as before")),
        };
        (join(heads, first), join(tails, last))
    }

    /// Cuts the columns of `rays` rays into blocks.
    pub fn blocks(self, rays: usize, block: usize) -> Vec<Self> {
        let mut blocks = Vec::with_capacity(rays.div_ceil(block));
        let (mut rest, mut left) = (self, rays);
        while left > block {
            let (head, tail) = rest.split(block);
            blocks.push(head);
            (rest, left) = (tail, left - block);
        }
        if left > 0 {
            blocks.push(rest);
        }
        blocks
    }

    /// Writes `values` of a ray from its place `at` on into a column; nothing if the column is not wanted.
    pub fn put(&mut self, column: usize, ray: usize, at: usize, values: &[f64]) {
        let (numbers, width) = &mut self.floats[column];
        if !numbers.is_empty() {
            let start = ray * *width + at;
            numbers[start..start + values.len()].copy_from_slice(values);
        }
    }

    /// Fills what a column has for a ray, from its place `at` on, with values that are not numbers.
    pub fn blank(&mut self, column: usize, ray: usize, at: usize) {
        let (numbers, width) = &mut self.floats[column];
        if !numbers.is_empty() {
            numbers[ray * *width + at..(ray + 1) * *width].fill(f64::NAN);
        }
    }
}
