//! Messages that point at a place in a text file the user wrote.
//!
//! In: a source text, a byte span in it, what was wrong and what to do.
//! Out: one line (`Display`) or a rustc-style report with the span underlined
//! ([`Diagnostic::report`]).

#[cfg(feature = "report")]
use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use std::{fmt, ops::Range, sync::Arc};

/// A text file as it was read, kept so that errors found later can quote it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceText {
    /// The user's name of the file: its path, or `<bundle>` for embedded text.
    pub name: String,
    /// The whole text.
    pub text: String,
}

impl SourceText {
    /// Wraps `text` under the name `name`.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Arc<Self> {
        Arc::new(Self {
            name: name.into(),
            text: text.into(),
        })
    }

    /// Line and column, both from 1, of the byte offset `at` (columns count characters).
    pub fn line_column(&self, at: usize) -> (usize, usize) {
        let before = &self.text[..self.floor(at)];
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        let line = before.matches('\n').count() + 1;
        (line, before[line_start..].chars().count() + 1)
    }

    /// Returns the byte offset of the last boundary of characters that is not beyond `at`.
    fn floor(&self, at: usize) -> usize {
        (0..=at.min(self.text.len()))
            .rev()
            .find(|&i| self.text.is_char_boundary(i))
            .unwrap_or(0)
    }
}

/// Something wrong at a place of a source text, with a hint of what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// The file.
    pub source: Arc<SourceText>,
    /// Byte range in `source.text`; may be empty.
    pub span: Range<usize>,
    /// The fault, in one line, no final stop.
    pub message: String,
    /// Words beside the underlined text; may be empty.
    pub label: String,
    /// Advice to the user.
    pub hint: Option<String>,
}

impl Diagnostic {
    /// A diagnostic without label or hint.
    pub fn new(source: &Arc<SourceText>, span: Range<usize>, message: impl Into<String>) -> Self {
        Self {
            source: source.clone(),
            span,
            message: message.into(),
            label: String::new(),
            hint: None,
        }
    }

    /// Adds the words beside the underlined text.
    pub fn with_label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// Adds what the user can do.
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// The whole report with the source line quoted and underlined, with ANSI colours if `colour`.
    #[cfg(feature = "report")]
    pub fn report(&self, colour: bool) -> String {
        let span = self.safe_span();
        let label = (!self.label.is_empty()).then_some(self.label.as_str());
        let mut group = Level::ERROR.primary_title(self.message.as_str()).element(
            Snippet::source(self.source.text.as_str())
                .path(self.source.name.as_str())
                .annotation(AnnotationKind::Primary.span(span).label(label)),
        );
        if let Some(hint) = &self.hint {
            group = group.element(Level::HELP.message(hint.as_str()));
        }
        let renderer = if colour {
            Renderer::styled()
        } else {
            Renderer::plain()
        };
        renderer.render(&[group])
    }

    /// The span clamped to the text and to character boundaries, so that no damage in a span can
    /// make the renderer panic.
    #[cfg(feature = "report")]
    fn safe_span(&self) -> Range<usize> {
        let start = self.source.floor(self.span.start);
        start..self.source.floor(self.span.end).max(start)
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, column) = self.source.line_column(self.span.start);
        write!(f, "{}:{line}:{column}: {}", self.source.name, self.message)?;
        if let Some(hint) = &self.hint {
            write!(f, " ({hint})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}
