//! Numbers that a scene gives as expressions of the chart point: velocities, temperatures.
//!
//! In: expressions of the coordinates and of the manifold's parameters. Out: [`PointFunctions`], their
//! values at any point.

use super::Manifold;
use geofan_expr::{
    Graph, Tape,
    parse::{Binding, ExpressionError, Scope, parse},
};
use glam::DVec3;

/// Evaluates expressions of the chart point.
#[derive(Debug, Clone)]
pub struct PointFunctions {
    tape: Tape,
}

impl PointFunctions {
    /// Reads `texts`, expressions of the coordinates and the parameters of `manifold` (as set).
    ///
    /// # Errors
    /// The index of a text and what is wrong with it.
    pub fn parse(manifold: &Manifold, texts: &[&str]) -> Result<Self, (usize, ExpressionError)> {
        let (mut graph, mut scope) = (Graph::new(), Scope::default());
        for (name, value) in &manifold.parameters {
            scope.bind(name, Binding::fixed(graph.constant(*value)));
        }
        for (k, name) in manifold.coordinates.iter().enumerate() {
            scope.bind(name, Binding::fixed(graph.input(k as u32)));
        }
        let mut outputs = Vec::new();
        for (i, text) in texts.iter().enumerate() {
            outputs.push(parse(text, &scope, &mut graph).map_err(|e| (i, e))?.node);
        }
        let too_large = |e: geofan_expr::TapeTooLarge| {
            let whole = 0..texts.first().map_or(0, |text| text.len());
            (0, ExpressionError::new(whole, e.to_string()))
        };
        let tape = Tape::compile(&graph, &outputs, 3).map_err(too_large)?;
        Ok(Self { tape })
    }

    /// Computes the values at `u`, in the order of the texts.
    pub fn at(&self, u: DVec3) -> Vec<f64> {
        self.tape.at(&u.to_array())
    }

    /// Computes the values at many points, a row for each, at a fraction of the cost.
    pub fn at_each(&self, points: impl ExactSizeIterator<Item = DVec3>) -> Vec<f64> {
        self.tape.at_each(points.map(|u| u.to_array()))
    }
}
