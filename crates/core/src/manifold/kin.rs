//! One space, three kinds of paths.
//!
//! In: the definition of a stationary spacetime. Out: the same [`Manifold`] for lines of sight (light
//! followed into the past), for light followed into the future, and for geodesics of the metric, along
//! which things are carried and distances measured. Without wind and drift all are the same.

use super::{
    Manifold,
    geometry::{self, Definition},
    pullback::Pullback,
    tapes::Tapes,
    wind::Medium,
};
use crate::error::{Error, Result};
use geofan_expr::{Graph, TapeTooLarge};
use std::{
    borrow::Cow,
    sync::{Arc, OnceLock},
};

/// The paths that a manifold follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Follows {
    /// Light into the past, as an eye does.
    #[default]
    Sight,
    /// Light into the future, from a lamp.
    Light,
    /// Geodesics of the metric.
    Geodesics,
}

/// The sources of the tapes for other paths.
#[derive(Debug)]
pub(super) struct Kin {
    graph: Graph,
    definition: Definition,
    medium: Medium,
    pullback: Option<Pullback>,
    light: OnceLock<Result<Arc<Tapes>, TapeTooLarge>>,
    /// The connection of the metric, without which nothing can be said of errors.
    pub geodesics: Arc<Tapes>,
}

impl Kin {
    /// For light in `medium`; `None` if that does not move.
    pub fn new(
        graph: &Graph,
        definition: &Definition,
        medium: Medium,
        pullback: Option<&Pullback>,
    ) -> Result<Option<Arc<Self>>, TapeTooLarge> {
        if !medium.moves() {
            return Ok(None);
        }
        let alone = Medium {
            lapse: medium.lapse,
            ..Medium::default()
        };
        let geodesics = compiled(graph.clone(), definition, &alone, pullback)?;
        Ok(Some(Arc::new(Self {
            graph: graph.clone(),
            definition: definition.clone(),
            medium,
            pullback: pullback.cloned(),
            light: OnceLock::new(),
            geodesics,
        })))
    }

    fn light(&self) -> Result<Arc<Tapes>, TapeTooLarge> {
        let pullback = self.pullback.as_ref();
        let graph = || self.graph.clone();
        let compile = || compiled(graph(), &self.definition, &self.medium, pullback);
        self.light.get_or_init(compile).clone()
    }
}

/// The tapes for paths of light in `medium`.
fn compiled(
    mut graph: Graph,
    definition: &Definition,
    medium: &Medium,
    pullback: Option<&Pullback>,
) -> Result<Arc<Tapes>, TapeTooLarge> {
    let geometry = geometry::build(&mut graph, definition, medium);
    Tapes::compile(graph, definition, medium, geometry, pullback).map(Arc::new)
}

impl Manifold {
    /// Returns the kind of paths that it follows.
    pub fn follows(&self) -> Follows {
        self.follows
    }

    /// Returns this space with light followed into the future.
    ///
    /// # Errors
    /// Its expressions are too large to be compiled.
    pub fn forward(&self) -> Result<Cow<'_, Self>> {
        let Some(kin) = &self.kin else {
            return Ok(Cow::Borrowed(self));
        };
        let tapes = kin.light().map_err(|e| {
            let subject = self.source.name.clone();
            Error::input(subject, format!("light cannot be followed forward: {e}"))
        })?;
        Ok(Cow::Owned(self.with(Follows::Light, tapes)))
    }

    /// Returns this space without wind and drift: geodesics of the metric.
    pub fn still(&self) -> Cow<'_, Self> {
        match &self.kin {
            Some(kin) => Cow::Owned(self.with(Follows::Geodesics, kin.geodesics.clone())),
            None => Cow::Borrowed(self),
        }
    }

    fn with(&self, follows: Follows, tapes: Arc<Tapes>) -> Self {
        Self {
            follows,
            tapes,
            ..self.clone()
        }
    }

    /// The tapes of the metric's own connection.
    pub(super) fn levi_civita(&self) -> &Tapes {
        match &self.kin {
            Some(kin) => &kin.geodesics,
            None => &self.tapes,
        }
    }
}
