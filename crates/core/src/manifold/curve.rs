//! A curve of the chart, written as expressions of one parameter.
//!
//! In: three expressions of a parameter and of the manifold's own parameters. Out: [`ChartCurve`]:
//! point and velocity at any parameter, the velocity exact.

use super::Manifold;
use geofan_expr::{
    Direction, Graph, Tape,
    parse::{Binding, ExpressionError, Scope, parse},
};
use glam::DVec3;

/// A curve `t -> u(t)`.
#[derive(Debug, Clone)]
pub struct ChartCurve {
    /// t -> u (3), u̇ (3).
    tape: Tape,
}

impl ChartCurve {
    /// The curve whose coordinates are `components`, expressions of `parameter` and of the parameters
    /// of `manifold` (as set); `parameter` hides one of the same name.
    ///
    /// # Errors
    /// A component's index (0 to 2) and what is wrong with it.
    pub fn parse(
        manifold: &Manifold,
        parameter: &str,
        components: [&str; 3],
    ) -> Result<Self, (usize, ExpressionError)> {
        let (mut graph, mut scope) = (Graph::new(), Scope::default());
        for (name, value) in &manifold.parameters {
            scope.bind(name, Binding::fixed(graph.constant(*value)));
        }
        scope.bind(parameter, Binding::fixed(graph.input(0)));
        let mut outputs = Vec::new();
        for (i, text) in components.iter().enumerate() {
            outputs.push(parse(text, &scope, &mut graph).map_err(|e| (i, e))?.node);
        }
        let mut along = Direction::of_input(&mut graph, 0);
        for i in 0..3 {
            outputs.push(graph.derivative(outputs[i], &mut along));
        }
        let too_large = |e: geofan_expr::TapeTooLarge| {
            let whole = 0..components[0].len();
            (0, ExpressionError::new(whole, e.to_string()))
        };
        let tape = Tape::compile(&graph, &outputs, 1).map_err(too_large)?;
        Ok(Self { tape })
    }

    /// Point and velocity at `t`, chart components.
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let o = self.tape.at(&[t]);
        (DVec3::from_slice(&o[..3]), DVec3::from_slice(&o[3..]))
    }
}
