//! Everything that a manifold evaluates over its chart, compiled.
//!
//! In: the nodes of its geometry. Out: [`Tapes`]. What every path needs is compiled on loading; what
//! only a few callers ask for (second derivatives of the metric) on first use, so that loading stays
//! quick.

use super::{
    Carried,
    geometry::{self, Definition, Geometry, PAIRS},
    pullback::Pullback,
    wind::{self, Medium},
};
use geofan_expr::{Direction, Graph, NodeId, Tape, TapeTooLarge};
use std::sync::{Arc, OnceLock};

/// The tapes of one manifold.
#[derive(Debug, Clone)]
pub(super) struct Tapes {
    /// u -> G (6), S (6).
    pub metric: Tape,
    /// Set if G is a factor times the unit matrix.
    pub conformal: bool,
    /// u -> the first three rows of the Jacobian, for an embedding.
    pub jacobian: Option<Tape>,
    /// Flows by [`Carried::index`].
    pub flows: [Tape; 4],
    /// u, v -> ω (3): in a medium for paths of light, else for any curve.
    pub turning: Tape,
    /// u -> W (3), N (1), b (3), as light meets them; `None` without a medium.
    pub medium: Option<Tape>,
    /// u -> db (3: 12, 13, 23), ∂_k W (3 × 3); `None` without a medium.
    pub medium_slopes: Option<Tape>,
    /// The expressions of the medium's parts, as far as it has them.
    pub parts: Medium,
    /// u -> the differential of the textbook coordinates (by rows) and its determinant, where the space is
    /// written in them.
    pub pullback: Option<Tape>,
    /// u -> for each place where the definition is not smooth, a function φ that vanishes there and
    /// its gradient (4); `None` for a smooth definition.
    pub switching: Option<Tape>,
    jet: Arc<Jet>,
}

/// An expression left to compile, and the result once it is.
#[derive(Debug)]
struct Jet {
    graph: Graph,
    metric: [NodeId; 6],
    tape: OnceLock<Result<Tape, TapeTooLarge>>,
}

impl Tapes {
    /// For paths through `medium`, of which `geometry` has been made; `pullback` are the
    /// textbook coordinates.
    pub fn compile(
        mut graph: Graph,
        definition: &Definition,
        medium: &Medium,
        geometry: Geometry,
        pullback: Option<&Pullback>,
    ) -> Result<Self, TapeTooLarge> {
        let metric: Vec<_> = [geometry.metric, geometry.frame].concat();
        let jacobian = geometry.jacobian.as_ref().map(|rows| {
            let first: Vec<_> = rows.iter().take(3).flatten().copied().collect();
            Tape::compile(&graph, &first, 3)
        });
        Ok(Self {
            metric: Tape::compile(&graph, &metric, 3)?,
            jacobian: jacobian.transpose()?,
            flows: flows(&mut graph, &geometry)?,
            turning: Tape::compile(&graph, &geometry.turning, 6)?,
            medium: medium_tape(&mut graph, medium)?,
            medium_slopes: medium_slopes(&mut graph, medium)?,
            pullback: pullback
                .map(|pullback| Tape::compile(&graph, &pullback.nodes(), 3))
                .transpose()?,
            parts: *medium,
            switching: switching(&mut graph, definition, medium)?,
            conformal: geometry::is_conformal(&mut graph, geometry.metric),
            jet: Arc::new(Jet {
                graph,
                metric: geometry.metric,
                tape: OnceLock::new(),
            }),
        })
    }

    /// u -> G (6), ∂_k G (3 × 6), ∂_k ∂_l G (6 × 6), pairs in the order of [`PAIRS`].
    pub fn jet(&self) -> Result<&Tape, TapeTooLarge> {
        let tape = self.jet.tape.get_or_init(|| self.jet.compile());
        tape.as_ref().map_err(|e| *e)
    }
}

impl Jet {
    fn compile(&self) -> Result<Tape, TapeTooLarge> {
        let mut graph = self.graph.clone();
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(&mut graph, k));
        let mut outputs = self.metric.to_vec();
        for axis in &mut axes {
            outputs.extend(self.metric.map(|g| graph.derivative(g, axis)));
        }
        for (k, l) in PAIRS {
            for entry in 0..6 {
                let first = outputs[6 + 6 * k + entry];
                outputs.push(graph.derivative(first, &mut axes[l]));
            }
        }
        Tape::compile(&graph, &outputs, 3)
    }
}

/// The four right-hand sides, by [`Carried::index`].
fn flows(graph: &mut Graph, geometry: &Geometry) -> Result<[Tape; 4], TapeTooLarge> {
    let rates = geometry::deviation_rates(graph, geometry.acceleration);
    let flow = |frame: bool, deviation: bool| {
        let carried = Carried { frame, deviation };
        let mut outputs = geometry.acceleration.to_vec();
        if carried.frame {
            outputs.extend(geometry.turning);
        }
        if carried.deviation {
            outputs.extend(rates.iter().flatten());
        }
        let mut rest = geometry.metric.to_vec();
        rest.extend(geometry.wind.iter().flatten());
        Tape::compile_parts(graph, &outputs, &rest, geometry::DEVIATION + 12)
    };
    Ok([
        flow(false, false)?,
        flow(true, false)?,
        flow(false, true)?,
        flow(true, true)?,
    ])
}

/// Wind, lapse and drift; `None` without a medium.
fn medium_tape(graph: &mut Graph, medium: &Medium) -> Result<Option<Tape>, TapeTooLarge> {
    if !medium.is_some() {
        return Ok(None);
    }
    let still = [graph.constant(0.0); 3];
    let one = graph.constant(1.0);
    let mut outputs = medium.wind.unwrap_or(still).to_vec();
    outputs.push(medium.lapse.unwrap_or(one));
    outputs.extend(medium.drift.unwrap_or(still));
    Tape::compile(graph, &outputs, 3).map(Some)
}

/// The drift's exterior derivative and the derivatives of the wind; `None` without a medium.
fn medium_slopes(graph: &mut Graph, medium: &Medium) -> Result<Option<Tape>, TapeTooLarge> {
    if !medium.is_some() {
        return Ok(None);
    }
    let still = [graph.constant(0.0); 3];
    let mut outputs = wind::exterior(graph, medium.drift.unwrap_or(still)).to_vec();
    let wind = medium.wind.unwrap_or(still);
    for k in 0..3 {
        let mut axis = Direction::of_input(graph, k);
        outputs.extend(wind.map(|w| graph.derivative(w, &mut axis)));
    }
    Tape::compile(graph, &outputs, 3).map(Some)
}

/// The switching functions with their gradients; `None` for a smooth definition.
fn switching(
    graph: &mut Graph,
    definition: &Definition,
    medium: &Medium,
) -> Result<Option<Tape>, TapeTooLarge> {
    let roots: Vec<NodeId> = definition
        .nodes()
        .iter()
        .copied()
        .chain(medium.nodes())
        .collect();
    let functions = graph.switching_functions(&roots);
    if functions.is_empty() {
        return Ok(None);
    }
    let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
    let mut outputs = Vec::new();
    for function in functions {
        outputs.push(function);
        outputs.extend(axes.each_mut().map(|axis| graph.derivative(function, axis)));
    }
    Tape::compile(graph, &outputs, 3).map(Some)
}
