//! Everything that is evaluated over the chart, compiled: the space itself, where it ends, and expressions that a user gives
//! besides.
//!
//! In: the nodes of a manifold's geometry. Out: [`Tapes`]. What every path needs is compiled on loading; what
//! only a few callers ask for (second derivatives of the metric) on first use, so that loading stays
//! quick.
//!
//! In: limits and expressions. Out: [`Domain`], whose event tape turns (u, v) into numbers that
//! become positive where a ray must end.
//!
//! In: expressions of a curve's one parameter, or of the coordinates; both may name the manifold's own parameters.
//! Out: [`ChartCurve`], point and velocity at any parameter, the velocity exact; [`PointFunctions`], the values of what a
//! scene gives as numbers of the point: velocities, temperatures.

use super::{
    Carried, Manifold,
    geometry::{self, Definition, Geometry, PAIRS, Pullback},
    wind::{self, Medium},
};
use geofan_expr::{
    Digest, Direction, Graph, NodeId, Tape, TapeTooLarge,
    parse::{Binding, ExpressionError, Scope, parse},
};
use glam::DVec3;
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
    /// its gradient (4), and how many of these are the metric's; `None` for a smooth definition.
    pub switching: Option<(Tape, usize)>,
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
    /// textbook coordinates, `exits` the formulas of exits.
    pub fn compile(
        mut graph: Graph,
        definition: &Definition,
        medium: &Medium,
        geometry: Geometry,
        pullback: Option<&Pullback>,
        exits: &[NodeId],
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
            switching: switching(&mut graph, definition, medium, exits)?,
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

/// The switching functions with their gradients, and how many of them are the metric's; `None` for a smooth definition. Behind
/// those come the ones where the formula of an exit jumps: steps end there too, as what it says between two jumps would else
/// be seen only if a step came to end there.
fn switching(
    graph: &mut Graph,
    definition: &Definition,
    medium: &Medium,
    exits: &[NodeId],
) -> Result<Option<(Tape, usize)>, TapeTooLarge> {
    let roots: Vec<NodeId> = definition
        .nodes()
        .iter()
        .copied()
        .chain(medium.nodes())
        .collect();
    let mut functions = graph.switching_functions(&roots);
    let of_metric = functions.len();
    functions.extend(graph.jump_functions(exits, 3));
    if functions.is_empty() {
        return Ok(None);
    }
    let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
    let mut outputs = Vec::new();
    for function in functions {
        outputs.push(function);
        outputs.extend(axes.each_mut().map(|axis| graph.derivative(function, axis)));
    }
    Tape::compile(graph, &outputs, 3).map(|tape| Some((tape, of_metric)))
}

/// The kind of end that an event stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// An exit named in the file, by index.
    Exit(usize),
    /// A coordinate limit that is not glued.
    Limit,
    /// A condition of `inside` that no longer holds.
    Inside,
}

/// The domain of the chart.
#[derive(Debug, Clone)]
pub struct Domain {
    /// Lower and upper limit of each coordinate, where given.
    pub limits: [Option<[f64; 2]>; 3],
    /// Set where the limits of a coordinate are glued.
    pub periodic: [bool; 3],
    /// The meaning of each output of the event tape.
    pub kinds: Vec<EventKind>,
    pub(super) events: Tape,
    /// Hashes of the events as the file gives them.
    pub(super) meanings: Vec<Digest>,
}

impl Domain {
    /// Returns whether a ray can end anywhere, at a limit or an exit.
    pub fn ends_rays(&self) -> bool {
        !self.kinds.is_empty()
    }

    /// Whether the file names a way out, besides the limits of the chart.
    pub fn has_exits(&self) -> bool {
        let named = |kind: &EventKind| matches!(kind, EventKind::Exit(_));
        self.kinds.iter().any(named)
    }

    /// The tape (u, v) -> one number for each of [`Domain::kinds`]; a ray ends where one becomes
    /// positive.
    pub fn events(&self) -> &Tape {
        &self.events
    }

    /// The representative of `u` inside the limits of the glued coordinates.
    pub fn wrap(&self, u: DVec3) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| u[k] - self.shift(k, u[k])))
    }

    /// Returns `u` and then the points around it that stand for the same place: one period off along glued coordinates.
    pub fn same_places(&self, u: DVec3) -> Vec<DVec3> {
        let mut places = vec![u];
        for k in 0..3 {
            if let Some(period) = self.period(k) {
                let by = DVec3::AXES[k] * period;
                places = places.iter().flat_map(|u| [*u, u + by, u - by]).collect();
            }
        }
        places
    }

    /// The multiple of the period that [`Domain::wrap`] takes off coordinate `k` at value `x`.
    pub fn shift(&self, k: usize, x: f64) -> f64 {
        match self.limits[k] {
            Some([low, high]) if self.periodic[k] => {
                let period = high - low;
                period * ((x - low) / period).floor()
            }
            _ => 0.0,
        }
    }

    /// The period of coordinate `k`, if its limits are glued.
    pub fn period(&self, k: usize) -> Option<f64> {
        self.limits[k]
            .filter(|_| self.periodic[k])
            .map(|[low, high]| high - low)
    }

    /// The exit beyond which `u` lies, if any, by its index, and the value of its formula there. One that
    /// depends on the tangent counts where it is positive whichever way a ray goes.
    pub fn exit_beyond(&self, u: DVec3) -> Option<(usize, f64)> {
        let at = |v: DVec3| self.events.at(&[u.x, u.y, u.z, v.x, v.y, v.z]);
        let values = at(DVec3::ZERO);
        let any_way = |k: usize| {
            let ways = DVec3::AXES.into_iter().flat_map(|v| [v, -v]);
            ways.into_iter().all(|v| at(v)[k] > 0.0)
        };
        let beyond = |(k, kind): (usize, &EventKind)| match kind {
            EventKind::Exit(exit) if values[k] > 0.0 && any_way(k) => Some((*exit, values[k])),
            _ => None,
        };
        self.kinds.iter().enumerate().find_map(beyond)
    }

    /// The first limit or condition (not exit) violated at `u`, if any.
    pub fn violation(&self, u: DVec3) -> Option<EventKind> {
        let values = self.events.at(&[u.x, u.y, u.z, 0.0, 0.0, 0.0]);
        let mut pairs = self.kinds.iter().zip(values);
        pairs
            .find(|(kind, value)| !matches!(kind, EventKind::Exit(_)) && !(*value <= 0.0))
            .map(|(kind, _)| *kind)
    }
}

/// Says which names are known where a [`ChartCurve`] or [`PointFunctions`] is read: these and the parameters.
pub fn known_names(names: &str) -> String {
    format!(
        "names here are {names} and the parameters of the manifold, not what it has under [let]"
    )
}

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
