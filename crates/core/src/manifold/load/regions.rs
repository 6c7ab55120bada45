//! The sections that say where things may be: `[symmetry]` (claims that are not checked yet), `[cameras]` (where cameras
//! may be, and how far paths go), `[domain]` and `[[exit]]` (limits, glued coordinates, conditions, and named ways out).

use super::{A_LET, Loader, PULLED_BACK, Reading, at_expression, expression, three_texts};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text, TomlTable},
    manifold::{CameraRegion, Domain, EventKind, Exit, GroupLaw, Symmetry, description::digests},
};
use geofan_expr::{
    Binary, Direction, NodeId, Tape, TapeTooLarge,
    parse::{Binding, ExpressionError, parse},
};
use std::sync::Arc;

impl Loader<'_> {
    pub(super) fn read_symmetry(&mut self, item: Option<Item<'_>>) -> Reading<Symmetry> {
        let mut symmetry = Symmetry::default();
        let Some(item) = item else {
            return Ok(symmetry);
        };
        let table = item.table()?;
        if let Some(about) = table.get("rotation") {
            let about = about.text()?;
            symmetry.axis = self.coordinates.iter().position(|c| *c == about.value);
            symmetry.rotation = about.value == "origin";
            if symmetry.axis.is_none() && !symmetry.rotation {
                return Err(about
                    .complain(format!("rotations about `{}` are not known", about.value))
                    .with_hint(format!(
                        "write \"origin\", or the name of the coordinate along the axis: {}",
                        self.coordinates.join(", ")
                    )));
            }
        }
        if let Some(list) = table.get("translation") {
            for name in list.texts()? {
                symmetry.translation[self.coordinate(&name)?] = true;
            }
        }
        if let Some(list) = table.get("group") {
            symmetry.group = Some(Arc::new(self.read_group(&list)?));
        }
        table.finish()?;
        Ok(symmetry)
    }

    /// The law p·u and its differential in u.
    fn read_group(&mut self, item: &Item<'_>) -> Reading<GroupLaw> {
        let mut scope = self.scope.clone();
        for (k, name) in self.coordinates.iter().enumerate() {
            // Group laws hold on the covering chart: no wrapping here.
            let (u, p) = (k as u32, 3 + k as u32);
            scope.bind(name, Binding::fixed(self.graph.input(u)));
            scope.bind(format!("p{name}"), Binding::fixed(self.graph.input(p)));
        }
        let mut nodes = Vec::new();
        for text in three_texts(item, "components")? {
            let parsed = expression(&text, &scope, &mut self.graph)?;
            if let Some(span) = parsed.tangent_use {
                return Err(text
                    .complain_at(span, "the tangent may be used only in exits")
                    .with_hint("the law of a group depends on the two points alone"));
            }
            nodes.push(parsed.node);
        }
        self.refuse_rough(&nodes, "the law of a group", 1)?;
        for row in 0..3 {
            for k in 0..3 {
                let mut axis = Direction::of_input(&mut self.graph, k);
                nodes.push(self.graph.derivative(nodes[row], &mut axis));
            }
        }
        // Where the differential's own derivatives vanish, as expressions, it is the same everywhere.
        let is_affine = (0..3).all(|k| {
            let mut axis = Direction::of_input(&mut self.graph, k);
            let mut bends = |node: &NodeId| self.graph.derivative(*node, &mut axis);
            let bends: Vec<NodeId> = nodes[3..].iter().map(&mut bends).collect();
            bends.iter().all(|node| self.graph.is(*node, 0.0))
        });
        let tape = Tape::compile(&self.graph, &nodes, 6);
        let law = |tape| GroupLaw { tape, is_affine };
        tape.map(law).map_err(|e| item.complain(e.to_string()))
    }
}

/// Camera parameters with their intervals.
type Parameters = (Vec<String>, Vec<[f64; 2]>);

impl Loader<'_> {
    pub(super) fn read_length(&self, item: Option<&Item<'_>>) -> Reading<Option<f64>> {
        let Some(item) = item else { return Ok(None) };
        let Some(length) = item.table()?.get("length") else {
            return Ok(None);
        };
        match length.number()? {
            value if value > 0.0 => Ok(Some(value)),
            _ => Err(length.complain("a length must be positive")),
        }
    }

    /// The camera region: as written, else (with a group) the identity alone, else the box of the
    /// coordinate limits.
    pub(super) fn read_cameras(
        &mut self,
        item: Option<&Item<'_>>,
        domain: &Domain,
        symmetry: &Symmetry,
    ) -> Reading<Option<CameraRegion>> {
        let table = item.map(|i| i.table()).transpose()?;
        let get = |key| table.as_ref().and_then(|t| t.get(key));
        let (at, parameters) = (get("at"), get("parameters"));
        if let Some(table) = &table {
            table.get("length");
            table.finish()?;
        }
        let parameters = match parameters {
            Some(item) => self.read_camera_parameters(&item, at.is_some())?,
            None => Default::default(),
        };
        match (at, domain.limits.iter().copied().collect()) {
            (Some(at), _) => self.written_region(&at, parameters).map(Some),
            (None, _) if symmetry.group.is_some() => self.identity_region().map(Some),
            (None, Some(intervals)) => self.box_region(intervals).map(Some),
            (None, None) => Ok(None),
        }
    }

    fn read_camera_parameters(&mut self, item: &Item<'_>, used: bool) -> Reading<Parameters> {
        let entries = item.table()?.entries();
        if entries.len() > 3 {
            return Err(item.complain("a camera region has at most 3 parameters"));
        }
        if !used && !entries.is_empty() {
            return Err(item.complain("camera parameters need `at`").with_hint(
                "add at = [\"…\", \"…\", \"…\"], the chart point as expressions of them",
            ));
        }
        let mut found = Parameters::default();
        for (name, interval) in entries {
            self.declare_camera(&name)?;
            found.1.push(interval.interval()?);
            found.0.push(name.value);
        }
        Ok(found)
    }

    /// Declares a camera parameter. It may hide what depends on the chart, of which a camera's position
    /// knows nothing: textbooks call both a coordinate and where an observer stands `r`.
    fn declare_camera(&mut self, name: &Text) -> Reading<()> {
        let hidden = |(d, kind): &&(String, &'static str)| {
            *d == name.value && [A_LET, PULLED_BACK].contains(kind)
        };
        match self.declared.iter().find(hidden) {
            Some(_) if !self.fixed.knows(&name.value) => Ok(()),
            _ => self.declare(name, "a camera parameter"),
        }
    }

    fn written_region(&mut self, at: &Item<'_>, parameters: Parameters) -> Reading<CameraRegion> {
        let mut scope = self.fixed.clone();
        for (k, name) in parameters.0.iter().enumerate() {
            scope.bind(name, Binding::fixed(self.graph.input(k as u32)));
        }
        let mut nodes = Vec::new();
        for text in three_texts(at, "coordinates")? {
            let parsed = parse(&text.value, &scope, &mut self.graph);
            let parsed = parsed.map_err(|e| at_camera(&text, e, &self.declared))?;
            nodes.push(parsed.node);
        }
        self.refuse_rough(&nodes, "a camera's position", 1)?;
        let region = self.region(parameters, nodes);
        let region = region.map_err(|e| at.complain(e.to_string()))?;
        Ok(CameraRegion {
            written: true,
            ..region
        })
    }

    fn box_region(&mut self, intervals: Vec<[f64; 2]>) -> Reading<CameraRegion> {
        let nodes = (0..3).map(|k| self.graph.input(k)).collect();
        self.region((self.coordinates.to_vec(), intervals), nodes)
            .map_err(|e| Diagnostic::new(self.source, 0..0, e.to_string()))
    }

    fn identity_region(&mut self) -> Reading<CameraRegion> {
        let zero = self.graph.constant(0.0);
        self.region(Parameters::default(), vec![zero; 3])
            .map_err(|e| Diagnostic::new(self.source, 0..0, e.to_string()))
    }

    fn region(
        &mut self,
        (names, intervals): Parameters,
        mut nodes: Vec<NodeId>,
    ) -> Result<CameraRegion, TapeTooLarge> {
        for k in 0..names.len() {
            let mut axis = Direction::of_input(&mut self.graph, k as u32);
            for i in 0..3 {
                nodes.push(self.graph.derivative(nodes[i], &mut axis));
            }
        }
        let map = Tape::compile(&self.graph, &nodes, names.len())?;
        Ok(CameraRegion {
            names,
            intervals,
            written: false,
            map,
        })
    }
}

/// As [`at_expression`], with a better hint for names that exist but not for cameras.
fn at_camera(
    text: &Text,
    error: ExpressionError,
    declared: &[(String, &'static str)],
) -> Diagnostic {
    let unknown = error.unknown.clone();
    let known = declared.iter().find(|(d, _)| Some(d) == unknown.as_ref());
    let complaint = at_expression(text, error);
    match known {
        Some((name, kind)) => complaint.with_hint(format!(
            "`{name}` is {kind}; a camera's position uses [parameters] and the camera parameters"
        )),
        None => complaint,
    }
}

/// The `[domain]` section, read but not yet compiled.
#[derive(Default)]
pub(super) struct Limits {
    intervals: [Option<[f64; 2]>; 3],
    periodic: [bool; 3],
    inside: Vec<Text>,
}

impl Limits {
    /// The interval of coordinate `k` if its limits are glued.
    pub fn glued(&self, k: usize) -> Option<[f64; 2]> {
        self.intervals[k].filter(|_| self.periodic[k])
    }
}

impl Loader<'_> {
    pub(super) fn read_domain(&self, item: Option<Item<'_>>) -> Reading<Limits> {
        let mut limits = Limits::default();
        let Some(item) = item else {
            return Ok(limits);
        };
        let table = item.table()?;
        for (k, name) in self.coordinates.iter().enumerate() {
            limits.intervals[k] = table.get(name).map(|i| i.interval()).transpose()?;
        }
        self.read_glued(&table, &mut limits)?;
        if let Some(list) = table.get("inside") {
            limits.inside = list.texts()?;
        }
        table.finish()?;
        Ok(limits)
    }

    fn read_glued(&self, table: &TomlTable<'_>, limits: &mut Limits) -> Reading<()> {
        let Some(list) = table.get("periodic") else {
            return Ok(());
        };
        for name in list.texts()? {
            let k = self.coordinate(&name)?;
            if limits.intervals[k].is_none() {
                return Err(name
                    .complain(format!("`{}` is periodic but has no limits", name.value))
                    .with_hint(format!("add `{} = [lower, upper]`", name.value)));
            }
            limits.periodic[k] = true;
        }
        Ok(())
    }

    /// Exits, limits and conditions as one event tape; `conditions` are those of the space itself.
    pub(super) fn compile_domain(
        &mut self,
        limits: Limits,
        exits: &[NodeId],
        conditions: Vec<NodeId>,
    ) -> Reading<Domain> {
        let exits = exits.iter().enumerate();
        let mut events: Vec<_> = exits.map(|(i, e)| (EventKind::Exit(i), *e)).collect();
        for k in 0..3 {
            if let (Some(interval), None) = (limits.intervals[k], limits.glued(k)) {
                events.extend(self.limit_events(k, interval));
            }
        }
        for text in &limits.inside {
            let value = self.position_expression(text)?;
            events.push((EventKind::Inside, self.graph.neg(value)));
        }
        for value in conditions {
            events.push((EventKind::Inside, self.graph.neg(value)));
        }
        let (kinds, nodes): (Vec<_>, Vec<_>) = events.into_iter().unzip();
        let guarded: Vec<NodeId> = kinds
            .iter()
            .zip(&nodes)
            .map(|(kind, node)| match kind {
                EventKind::Inside => self.violated_without_value(*node),
                EventKind::Exit(_) | EventKind::Limit => *node,
            })
            .collect();
        let compiled = |nodes: &[NodeId]| {
            Tape::compile(&self.graph, nodes, 6).map_err(|_| {
                Diagnostic::new(self.source, 0..0, "the exits and conditions are too large")
            })
        };
        Ok(Domain {
            limits: limits.intervals,
            periodic: limits.periodic,
            kinds,
            events: compiled(&guarded)?,
            meanings: digests(&compiled(&nodes)?),
        })
    }

    /// Makes the event of a condition positive where that has no value, as behind the edge of a root: a path ends there.
    fn violated_without_value(&mut self, event: NodeId) -> NodeId {
        let [most, one] = [f64::MAX, 1.0].map(|value| self.graph.constant(value));
        let has_value = self.graph.binary(Binary::LessEqual, event, most);
        self.graph.select(has_value, event, one)
    }

    fn limit_events(&mut self, k: usize, [low, high]: [f64; 2]) -> [(EventKind, NodeId); 2] {
        let u = self.graph.input(k as u32);
        let (low, high) = (self.graph.constant(low), self.graph.constant(high));
        let beyond = [self.graph.sub(low, u), self.graph.sub(u, high)];
        beyond.map(|node| (EventKind::Limit, node))
    }
}

/// Returns whether `name` is that of an end that every manifold has.
pub(super) fn is_built_in(name: &str) -> bool {
    BUILT_IN.iter().chain(&OTHER_ENDS).any(|end| *end == name)
}

/// The names of the exits that every manifold has, after those of its file: a coordinate limit, and
/// a condition of `inside`.
const BUILT_IN: [&str; 2] = ["limit", "inside"];

/// Ends of paths that are no exits.
const OTHER_ENDS: [&str; 2] = ["length", "singular"];

impl Loader<'_> {
    /// All exits, and the event expressions of those of the file and of `fields`, which end at their samples.
    pub(super) fn read_exits(
        &mut self,
        item: Option<Item<'_>>,
        fields: Vec<(String, NodeId)>,
    ) -> Reading<(Vec<Exit>, Vec<NodeId>)> {
        let (mut exits, mut events) = (Vec::<Exit>::new(), Vec::new());
        let list = item.map(|item| {
            let list = item.list();
            list.map_err(|complaint| complaint.with_hint("write [[exit]], in double brackets"))
        });
        for item in list.transpose()?.unwrap_or_default() {
            let table = item.table()?;
            exits.push(self.read_exit(&table, &exits, &fields)?);
            events.push(self.ray_expression(&table.require("when")?.text()?)?);
        }
        for (name, beyond) in fields {
            exits.push(Exit {
                name,
                direction: None,
            });
            events.push(beyond);
        }
        exits.extend(BUILT_IN.map(|name| Exit {
            name: name.into(),
            direction: None,
        }));
        Ok((exits, events))
    }

    fn read_exit(
        &mut self,
        table: &TomlTable<'_>,
        earlier: &[Exit],
        fields: &[(String, NodeId)],
    ) -> Reading<Exit> {
        let (name, when) = (table.get("name"), table.get("when"));
        let direction = table.get("direction");
        table.finish()?;
        let missing = |key: &str| table.complain(format!("an exit needs `{key}`"));
        let name = name.ok_or_else(|| missing("name"))?.text()?;
        when.ok_or_else(|| missing("when"))?;
        if is_built_in(&name.value) {
            return Err(name
                .complain(format!("`{}` is the name of a built-in end", name.value))
                .with_hint("choose another name"));
        }
        if fields.iter().any(|(field, _)| *field == name.value) {
            return Err(name
                .complain(format!(
                    "`{}` is already the exit through the end of a field",
                    name.value
                ))
                .with_hint("choose another name"));
        }
        if earlier.iter().any(|e| e.name == name.value) {
            return Err(name
                .complain(format!("a second exit is called `{}`", name.value))
                .with_hint("each exit has a sky of its own; choose another name"));
        }
        Ok(Exit {
            name: name.value,
            direction: direction.map(|d| self.read_direction(&d)).transpose()?,
        })
    }

    fn read_direction(&mut self, item: &Item<'_>) -> Reading<Tape> {
        let [x, y, z] = three_texts(item, "components")?;
        let nodes = [
            self.ray_expression(&x)?,
            self.ray_expression(&y)?,
            self.ray_expression(&z)?,
        ];
        Tape::compile(&self.graph, &nodes, 6).map_err(|e| item.complain(e.to_string()))
    }
}
