//! Errors of the libraries as Python exceptions.
//!
//! In: an [`Error`] and what it is about. Out: an exception of `geofan._errors` that carries the file, line,
//! column and hint where there are any.

use geofan_core::{Error, diagnostic::Diagnostic};
use pyo3::{
    exceptions::{PyKeyboardInterrupt, PyOSError},
    prelude::*,
    types::PyDict,
};

/// Names the exception that bad input raises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// `ManifoldError`
    Manifold,
    /// `SceneError`
    Scene,
    /// `InputError`
    Input,
}

impl About {
    /// Names the class.
    fn class(self) -> &'static str {
        match self {
            Self::Manifold => "ManifoldError",
            Self::Scene => "SceneError",
            Self::Input => "InputError",
        }
    }

    /// Makes the exception of an error.
    pub fn raise(self, py: Python<'_>, error: Error) -> PyErr {
        let made = match &error {
            Error::Source(diagnostic) => self.at_place(py, diagnostic, &error),
            Error::Input { subject, message } => self.about(py, subject, message),
            Error::Environment { path, source } => {
                let number = source.raw_os_error().unwrap_or(0);
                return PyOSError::new_err((number, source.to_string(), path.clone()));
            }
            Error::Interrupted { resume } => {
                return PyKeyboardInterrupt::new_err(format!("interrupted; {resume}"));
            }
        };
        made.unwrap_or_else(|failure| failure)
    }

    /// Makes the exception of a mistake in a text.
    fn at_place(self, py: Python<'_>, found: &Diagnostic, error: &Error) -> PyResult<PyErr> {
        let (line, column) = found.source.line_column(found.span.start);
        let details = PyDict::new(py);
        details.set_item("subject", &found.source.name)?;
        details.set_item("file", &found.source.name)?;
        details.set_item("line", line)?;
        details.set_item("column", column)?;
        details.set_item("hint", &found.hint)?;
        details.set_item("report", error.report(false))?;
        self.make(py, found.message.clone(), &details)
    }

    /// Makes the exception of an input that is no text.
    fn about(self, py: Python<'_>, subject: &str, message: &str) -> PyResult<PyErr> {
        // Options of the command line are keywords here.
        let subject = subject.trim_start_matches('-').replace('-', "_");
        let details = PyDict::new(py);
        let message = match subject.is_empty() {
            true => message.to_string(),
            false => format!("{subject}: {message}"),
        };
        details.set_item("subject", subject)?;
        self.make(py, message, &details)
    }

    fn make(self, py: Python<'_>, message: String, details: &Bound<'_, PyDict>) -> PyResult<PyErr> {
        let class = py.import("geofan._errors")?.getattr(self.class())?;
        Ok(PyErr::from_value(class.call((message,), Some(details))?))
    }
}

/// Makes an `InputError` about `subject`.
pub fn refuse(py: Python<'_>, subject: &str, message: impl Into<String>) -> PyErr {
    About::Input.raise(py, Error::input(subject, message))
}
