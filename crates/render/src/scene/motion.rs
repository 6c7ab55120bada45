//! Motion and heat in a scene file: how cameras and objects move, how hot objects are.
//!
//! In: `rest` or `velocity` of a camera, `velocity` and `temperature` of an object. Out: a
//! [`CameraMotion`], and [`Formulas`] of the chart point, numbers or expressions, that are read where the
//! manifold is known.

use super::table::{NamedTable, NamedValue, Span};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    document::place_in_string,
    error::Result,
    manifold::{ChartCurve, Manifold, PointFunctions},
};
use geofan_expr::parse::ExpressionError;
use glam::DVec3;
use std::sync::Arc;

/// Tells how a camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum CameraMotion {
    /// As the normal observer at its point, whose directions tables hold.
    #[default]
    Normal,
    /// At rest in the chart.
    Static,
    /// Past the normal observer, with a velocity in the standard frame; light has 1.
    Velocity(DVec3),
}

impl CameraMotion {
    /// Reads `rest` or `velocity`, of which a camera may have one.
    pub(super) fn read(table: &NamedTable) -> Result<(Self, Span)> {
        match (table.optional("rest"), table.optional("velocity")) {
            (None, None) => Ok((Self::Normal, table.span())),
            (Some(rest), None) => {
                let choices = [("normal", Self::Normal), ("static", Self::Static)];
                Ok((rest.choice(&choices)?, rest.span()))
            }
            (None, Some(velocity)) => {
                let v = velocity.vector()?;
                if v.length() < 1.0 {
                    return Ok((Self::Velocity(v), velocity.span()));
                }
                Err(velocity
                    .complain(String::from("`velocity` must be shorter than 1"))
                    .with_label("as fast as light, or faster")
                    .with_hint("it is past the normal observer, in the standard frame; light has 1")
                    .into())
            }
            (Some(_), Some(velocity)) => Err(velocity
                .complain(String::from("a camera has both `rest` and `velocity`"))
                .with_label("its motion is given twice")
                .with_hint("give either `rest = \"static\"` or `velocity = [0.1, 0.0, 0.0]`")
                .into()),
        }
    }

    /// Returns the velocity past the normal observer at `u`, standard frame; `None` if nothing can move
    /// like that there.
    pub fn velocity(self, manifold: &Manifold, u: DVec3) -> Option<DVec3> {
        let velocity = match self {
            Self::Normal => DVec3::ZERO,
            Self::Static => manifold.rest_velocity(u),
            Self::Velocity(velocity) => velocity,
        };
        (velocity.length() < 1.0).then_some(velocity)
    }
}

/// Holds formulas of the chart point as a scene file states them.
#[derive(Debug, Clone, PartialEq)]
pub struct Formulas {
    texts: Vec<String>,
    spans: Vec<Span>,
    /// The place of all.
    pub span: Span,
}

impl Formulas {
    /// Reads one formula.
    pub(super) fn one(value: &NamedValue) -> Result<Self> {
        let (text, span) = formula(value)?;
        Ok(Self {
            texts: vec![text],
            spans: vec![span],
            span: value.span(),
        })
    }

    /// Reads three formulas.
    pub(super) fn three(value: &NamedValue) -> Result<Self> {
        let expected = "three numbers or expressions such as [\"-y*w\", \"x*w\", 0]";
        let items = value.array(expected)?;
        if items.len() != 3 {
            return Err(value.wrong_type(expected).into());
        }
        let read = items.iter().map(formula).collect::<Result<Vec<_>>>()?;
        let (texts, spans) = read.into_iter().unzip();
        Ok(Self {
            texts,
            spans,
            span: value.span(),
        })
    }

    /// Compiles them as functions of the points of `manifold`.
    ///
    /// # Errors
    /// An expression that means nothing, at its place in `source`.
    pub fn compile(&self, manifold: &Manifold, source: &Arc<SourceText>) -> Result<PointFunctions> {
        let texts: Vec<&str> = self.texts.iter().map(String::as_str).collect();
        PointFunctions::parse(manifold, &texts)
            .map_err(|(i, error)| self.complain(source, i, error).into())
    }

    /// Compiles them as functions of the time t, up to three; others are 0.
    ///
    /// # Errors
    /// As [`Formulas::compile`].
    pub fn curve(&self, manifold: &Manifold, source: &Arc<SourceText>) -> Result<ChartCurve> {
        let texts = [0, 1, 2].map(|k| self.texts.get(k).map_or("0", String::as_str));
        ChartCurve::parse(manifold, "t", texts)
            .map_err(|(i, error)| self.complain(source, i, error).into())
    }

    /// The complaint about the formula with number `i`.
    fn complain(&self, source: &Arc<SourceText>, i: usize, error: ExpressionError) -> Diagnostic {
        let place = place_in_string(source, &self.spans[i], &self.texts[i], error.span);
        let diagnostic = Diagnostic::new(source, place, error.message);
        match error.hint {
            Some(hint) => diagnostic.with_hint(hint),
            None => diagnostic,
        }
    }
}

/// Reads a number or an expression, with its place.
fn formula(value: &NamedValue) -> Result<(String, Span)> {
    let text = match value.is_string() {
        true => value.string()?.to_owned(),
        false => format!("({:?})", value.number()?),
    };
    Ok((text, value.span()))
}
