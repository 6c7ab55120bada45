//! What can go wrong between a file and a picture, sorted by whose move it is next.

use crate::diagnostic::Diagnostic;
use std::{io, path::Path};

/// The library's error: every variant says which file and what was wrong.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A text file says something that cannot work; the place is known.
    #[error("{0}")]
    Source(#[from] Box<Diagnostic>),
    /// An input that is not text, or a request that cannot be met.
    #[error("{subject}: {message}")]
    Input {
        /// The file, flag or thing at fault.
        subject: String,
        /// The fault, and advice to the user.
        message: String,
    },
    /// The machine could not do it: unreadable file, full disk.
    #[error("{path}: {source}")]
    Environment {
        /// The file concerned.
        path: String,
        /// The operating system's answer.
        source: io::Error,
    },
    /// Stopped by the user; what was done is kept and can be resumed.
    #[error("interrupted; {resume}")]
    Interrupted {
        /// Advice on how to go on.
        resume: String,
    },
}

/// The library's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl From<Diagnostic> for Error {
    fn from(diagnostic: Diagnostic) -> Self {
        Self::Source(Box::new(diagnostic))
    }
}

/// Writes control characters, as in names of files, so that a terminal does not obey them.
#[cfg(feature = "report")]
fn printable(text: &str) -> String {
    let is_obeyed = |c: char| c.is_control() && c != '\n';
    let shown = text.chars().map(|c| match is_obeyed(c) {
        true => c.escape_default().to_string(),
        false => c.into(),
    });
    shown.collect()
}

impl Error {
    /// An [`Error::Input`].
    pub fn input(subject: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Input {
            subject: subject.into(),
            message: message.into(),
        }
    }

    /// Sorts an I/O error: a file that is not there is bad input, anything else the environment.
    pub fn io(path: &Path, source: io::Error) -> Self {
        let path = path.display().to_string();
        match source.kind() {
            io::ErrorKind::NotFound => Self::input(path, "no such file or folder"),
            io::ErrorKind::IsADirectory => Self::input(path, "is a folder, a file is needed"),
            io::ErrorKind::InvalidData => Self::input(path, "is not UTF-8 text"),
            _ if path.contains('\0') => Self::input(
                path.escape_default().to_string(),
                "is no name of a file: it holds a NUL character",
            ),
            _ => Self::Environment { path, source },
        }
    }

    /// The process exit code that belongs to this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Source(_) | Self::Input { .. } => 2,
            Self::Environment { .. } => 3,
            Self::Interrupted { .. } => 75,
        }
    }

    /// The text for a terminal: rustc-style with the source underlined where there is a source.
    #[cfg(feature = "report")]
    pub fn report(&self, colour: bool) -> String {
        match self {
            Self::Source(diagnostic) => diagnostic.report(colour),
            other => format!("error: {}", printable(&other.to_string())),
        }
    }
}
