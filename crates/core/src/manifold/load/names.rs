//! The names of a manifold file: coordinates, parameters, lets.
//!
//! In: the sections that declare names. Out: scopes in which later sections are read. A name may be
//! declared once, before its use: what a let names must stand above it.

use super::{Loader, Reading, at_expression, domain_and_exits::Limits, three_texts};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text},
    manifold::{geometry, pullback::Pullback},
};
use geofan_expr::{
    Graph, NodeId, Unary,
    parse::{Binding, ExpressionError, is_function, parse},
};

/// Kinds of names that depend on the chart.
pub(super) const A_LET: &str = "a let";
pub(super) const PULLED_BACK: &str = "a pulled-back coordinate";

impl Loader<'_> {
    pub(super) fn declare(&mut self, name: &Text, kind: &'static str) -> Reading<()> {
        let n = &name.value;
        if !is_name(n) {
            return Err(name
                .complain(format!("`{n}` is not a name"))
                .with_hint("a name has letters, digits and `_`, and does not start with a digit"));
        }
        if is_function(n) {
            return Err(name
                .complain(format!("`{n}` is a function and cannot be declared"))
                .with_hint("choose another name"));
        }
        if let Some((_, earlier)) = self.declared.iter().find(|(d, _)| d == n) {
            return Err(name
                .complain(format!("`{n}` is declared twice: it is already {earlier}"))
                .with_hint("a name may be declared once; choose another"));
        }
        self.declared.push((n.clone(), kind));
        Ok(())
    }

    pub(super) fn read_coordinates(&mut self, item: &Item<'_>) -> Reading<[String; 3]> {
        let texts = three_texts(item, "coordinate names")?;
        for name in &texts {
            self.declare(name, "a coordinate")?;
        }
        let names = texts.map(|text| text.value);
        for name in &names {
            let tangent = format!("v{name}");
            if names.contains(&tangent) {
                return Err(item.complain(format!(
                    "`{tangent}` names both a coordinate and the tangent's component along `{name}`"
                )));
            }
            self.declared.push((tangent, "a component of the tangent"));
        }
        Ok(names)
    }

    pub(super) fn read_parameters(
        &mut self,
        item: Option<Item<'_>>,
        settings: &[(String, f64)],
    ) -> Reading<Vec<(String, f64)>> {
        let mut parameters = Vec::new();
        let Some(item) = item else {
            return Ok(parameters);
        };
        for (name, item) in item.table()?.entries() {
            self.declare(&name, "a parameter")?;
            let own = item.number()?;
            let set = settings.iter().rev().find(|s| s.0 == name.value);
            let value = set.map_or(own, |s| s.1);
            let binding = Binding::fixed(self.graph.constant(value));
            self.scope.bind(&name.value, binding);
            self.fixed.bind(&name.value, binding);
            parameters.push((name.value, value));
        }
        Ok(parameters)
    }

    /// Finds the coordinate called `name`.
    pub(super) fn coordinate(&self, name: &Text) -> Reading<usize> {
        let found = self.coordinates.iter().position(|c| *c == name.value);
        found.ok_or_else(|| {
            name.complain(format!("`{}` is not a coordinate", name.value))
                .with_hint(format!(
                    "the coordinates are {}",
                    self.coordinates.join(", ")
                ))
        })
    }

    /// Binds the coordinates and the tangent. A glued coordinate is seen by expressions inside its
    /// limits only, so that paths may run on in the covering chart without a jump.
    pub(super) fn bind_coordinates(&mut self, limits: &Limits) {
        for (k, name) in self.coordinates.iter().enumerate() {
            let mut node = self.graph.input((geometry::POINT + k) as u32);
            if let Some(interval) = limits.glued(k) {
                node = wrapped(&mut self.graph, node, interval);
            }
            self.scope.bind(name, Binding::fixed(node));
            let tangent = Binding {
                node: self.graph.input((geometry::TANGENT + k) as u32),
                uses_tangent: true,
            };
            self.scope.bind(format!("v{name}"), tangent);
        }
    }

    /// The `[pullback]` section: textbook coordinates as functions of the chart. Metrics, winds and
    /// drifts are then written in them.
    pub(super) fn read_pullback(&mut self, item: Option<Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        let entries = item.table()?.entries();
        let count = entries.len();
        let entries: [_; 3] = entries.try_into().map_err(|_| {
            item.complain(format!("3 coordinates are needed here, {count} given"))
                .with_hint("write each as an expression of the chart's coordinates")
        })?;
        let mut names: [String; 3] = Default::default();
        let mut nodes = [self.graph.constant(0.0); 3];
        for (k, (name, item)) in entries.into_iter().enumerate() {
            nodes[k] = self.position_expression(&item.text()?)?;
            self.declare(&name, PULLED_BACK)?;
            self.scope.bind(&name.value, Binding::fixed(nodes[k]));
            names[k] = name.value;
        }
        let pullback = Pullback::new(&mut self.graph, nodes);
        if self.graph.is(pullback.determinant, 0.0) {
            return Err(item
                .complain("these are not three independent coordinates")
                .with_hint("their differentials are dependent everywhere"));
        }
        self.pullback = Some((names, pullback));
        Ok(())
    }

    /// The names of the coordinates in which metric, wind and drift are written.
    pub(super) fn written_in(&self) -> &[String; 3] {
        self.pullback
            .as_ref()
            .map_or(&self.coordinates, |(names, _)| names)
    }

    pub(super) fn read_lets(&mut self, item: Option<Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        let entries = item.table()?.entries();
        for (i, (name, item)) in entries.iter().enumerate() {
            let text = item.text()?;
            let parsed = parse(&text.value, &self.scope, &mut self.graph);
            let parsed = parsed.map_err(|e| {
                let below = entries[i..].iter().map(|(name, _)| name.value.as_str());
                at_let(&text, e, below)
            })?;
            self.declare(name, A_LET)?;
            let binding = Binding {
                node: parsed.node,
                uses_tangent: parsed.tangent_use.is_some(),
            };
            self.scope.bind(&name.value, binding);
            if self.graph.value(parsed.node).is_some() {
                self.fixed.bind(&name.value, binding);
            }
        }
        Ok(())
    }
}

/// Returns whether `text` could be a name at all.
fn is_name(text: &str) -> bool {
    let starts = |c: char| c.is_alphabetic() || c == '_';
    text.starts_with(starts) && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// As [`at_expression`], with a better hint for the names of `below`: this let and those after it.
fn at_let<'n>(
    text: &Text,
    error: ExpressionError,
    mut below: impl Iterator<Item = &'n str>,
) -> Diagnostic {
    let unknown = error.unknown.clone();
    let complaint = at_expression(text, error);
    match unknown.filter(|unknown| below.any(|name| name == unknown)) {
        Some(name) => complaint.with_hint(format!(
            "`{name}` is declared here or below; a let knows only those above it"
        )),
        None => complaint,
    }
}

/// `x − P ⌊(x − low)/P⌋` with `P = high − low`.
fn wrapped(graph: &mut Graph, x: NodeId, [low, high]: [f64; 2]) -> NodeId {
    let (origin, period) = (graph.constant(low), graph.constant(high - low));
    let offset = graph.sub(x, origin);
    let turns = graph.div(offset, period);
    let turns = graph.unary(Unary::Floor, turns);
    let shift = graph.mul(period, turns);
    graph.sub(x, shift)
}
