//! The text of a manifold file -> [`Manifold`], with every complaint at its place.

use super::{
    Carried, Domain, EventKind, Exit, Manifold, Symmetry,
    geometry::{self, Definition, Geometry},
    region::CameraRegion,
};
use crate::{
    diagnostic::{Diagnostic, SourceText},
    document::{self, Item, Table, Text},
    error::{Error, Result},
    expr::{
        Direction, Graph, NodeId, Tape,
        parse::{Binding, Scope, is_function, parse},
    },
    spelling::nearest,
};
use std::sync::Arc;

type Reading<T> = Result<T, Diagnostic>;

/// The names of the exits that every manifold has, after those of its file.
pub(super) const LIMIT: &str = "limit";
pub(super) const INSIDE: &str = "inside";

/// The least and the most components of an embedding.
const AMBIENT: std::ops::RangeInclusive<usize> = 3..=16;

/// What a manifold file may have at its top.
const KEYS: [&str; 10] = [
    "name",
    "coordinates",
    "embedding",
    "metric",
    "parameters",
    "let",
    "domain",
    "exit",
    "symmetry",
    "cameras",
];

/// Reads the file; nothing numerical is checked yet.
pub(super) fn from_source(
    source: &Arc<SourceText>,
    settings: &[(String, f64)],
) -> Result<Manifold> {
    if let Some((name, value)) = settings.iter().find(|(_, v)| !v.is_finite()) {
        return Err(Error::input(
            "--set",
            format!("{name}={value} is not finite"),
        ));
    }
    let mut used = vec![false; settings.len()];
    let manifold = document::read(source, |root| {
        Loader::new(source).load(&root, settings, &mut used)
    })?;
    match used.iter().position(|u| !u) {
        None => Ok(manifold),
        Some(i) => {
            let name = &settings[i].0;
            let known: Vec<&str> = manifold.parameters.iter().map(|p| p.0.as_str()).collect();
            let hint = match nearest(name, known.iter().copied()) {
                Some(near) => format!("; did you mean `{near}`?"),
                None if known.is_empty() => String::from("; it has none"),
                None => format!("; its parameters: {}", known.join(", ")),
            };
            Err(Error::input(
                "--set",
                format!("the manifold has no parameter `{name}`{hint}"),
            ))
        }
    }
}

struct Loader<'s> {
    source: &'s Arc<SourceText>,
    graph: Graph,
    scope: Scope,
    /// Names that camera expressions may use: parameters and what follows from them alone.
    fixed: Scope,
    declared: Vec<(String, &'static str)>,
    coordinates: [String; 3],
    domain_items: Domains,
}

/// The `[domain]` table, read but not yet compiled.
#[derive(Default)]
struct Domains {
    limits: [Option<[f64; 2]>; 3],
    periodic: [bool; 3],
    inside: Vec<Text>,
}

impl<'s> Loader<'s> {
    fn new(source: &'s Arc<SourceText>) -> Self {
        Self {
            source,
            graph: Graph::new(),
            scope: Scope::default(),
            fixed: Scope::default(),
            declared: Vec::new(),
            coordinates: Default::default(),
            domain_items: Domains::default(),
        }
    }

    fn load(
        mut self,
        root: &Table<'_>,
        settings: &[(String, f64)],
        used: &mut [bool],
    ) -> Reading<Manifold> {
        // First, so that a misspelt key is named and not the absence of the right one.
        for key in KEYS {
            root.get(key);
        }
        root.finish()?;
        let name = root.require("name")?.text()?.value;
        self.coordinates = self.read_coordinates(&root.require("coordinates")?)?;
        let parameters = self.read_parameters(root.get("parameters"), settings, used)?;
        self.domain_items = self.read_domain(root.get("domain"))?;
        self.bind_coordinates();
        self.read_lets(root.get("let"))?;
        let (definition, ambient, place) = self.read_definition(root)?;
        let geometry = geometry::build(&mut self.graph, &definition);
        let (exits, exit_events) = self.read_exits(root.get("exit"))?;
        let domain = self.compile_domain(exit_events)?;
        let symmetry = self.read_symmetry(root.get("symmetry"))?;
        let cameras = root.get("cameras");
        let length = self.read_length(cameras.as_ref())?;
        let region = self.read_cameras(cameras.as_ref(), &domain, &symmetry)?;
        let compiled = self
            .compile(&geometry)
            .map_err(|e| place.complain(e.to_string()))?;
        let (metric, jacobian, flows) = compiled;
        Ok(Manifold {
            source: self.source.clone(),
            name,
            coordinates: self.coordinates,
            parameters,
            domain,
            exits,
            symmetry,
            cameras: region,
            length,
            ambient,
            metric,
            jacobian,
            flows,
        })
    }

    fn declare(&mut self, name: &Text, kind: &'static str) -> Reading<()> {
        let n = &name.value;
        let valid = n.chars().all(|c| c.is_alphanumeric() || c == '_')
            && n.chars()
                .next()
                .is_some_and(|c| c.is_alphabetic() || c == '_');
        if !valid {
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

    fn read_coordinates(&mut self, item: &Item<'_>) -> Reading<[String; 3]> {
        let mut names = Vec::new();
        for name in item.exactly::<3>("coordinate names")? {
            let name = name.text()?;
            self.declare(&name, "a coordinate")?;
            names.push(name.value);
        }
        for name in &names {
            let tangent = format!("v{name}");
            if names.contains(&tangent) {
                return Err(item.complain(format!(
                    "`{tangent}` names both a coordinate and the tangent's component along `{name}`"
                )));
            }
            self.declared.push((tangent, "a component of the tangent"));
        }
        Ok(names.try_into().unwrap_or_default())
    }

    fn read_parameters(
        &mut self,
        item: Option<Item<'_>>,
        settings: &[(String, f64)],
        used: &mut [bool],
    ) -> Reading<Vec<(String, f64)>> {
        let mut parameters = Vec::new();
        let Some(item) = item else {
            return Ok(parameters);
        };
        for (name, item) in item.table()?.entries() {
            self.declare(&name, "a parameter")?;
            let mut value = item.number()?;
            for (setting, used) in settings.iter().zip(used.iter_mut()) {
                if setting.0 == name.value {
                    (value, *used) = (setting.1, true);
                }
            }
            let node = self.graph.constant(value);
            let binding = Binding {
                node,
                uses_tangent: false,
            };
            self.scope.bind(&name.value, binding);
            self.fixed.bind(&name.value, binding);
            parameters.push((name.value, value));
        }
        Ok(parameters)
    }

    fn coordinate(&self, name: &Text) -> Reading<usize> {
        let found = self.coordinates.iter().position(|c| *c == name.value);
        found.ok_or_else(|| {
            name.complain(format!("`{}` is not a coordinate", name.value))
                .with_hint(format!(
                    "the coordinates are {}",
                    self.coordinates.join(", ")
                ))
        })
    }

    fn read_domain(&self, item: Option<Item<'_>>) -> Reading<Domains> {
        let mut domains = Domains::default();
        let Some(item) = item else {
            return Ok(domains);
        };
        let table = item.table()?;
        for (k, name) in self.coordinates.iter().enumerate() {
            domains.limits[k] = table.get(name).map(|i| i.interval()).transpose()?;
        }
        if let Some(list) = table.get("periodic") {
            for name in list.texts()? {
                let k = self.coordinate(&name)?;
                if domains.limits[k].is_none() {
                    return Err(name
                        .complain(format!("`{}` is periodic but has no limits", name.value))
                        .with_hint(format!("add `{} = [lower, upper]`", name.value)));
                }
                domains.periodic[k] = true;
            }
        }
        if let Some(list) = table.get("inside") {
            domains.inside = list.texts()?;
        }
        table.finish()?;
        Ok(domains)
    }

    /// Binds the coordinates and the tangent. A glued coordinate is seen by expressions inside its
    /// limits only, so that paths may run on in the covering chart without a jump.
    fn bind_coordinates(&mut self) {
        for (k, name) in self.coordinates.iter().enumerate() {
            let mut node = self.graph.input(k as u32);
            if let (Some([low, high]), true) =
                (self.domain_items.limits[k], self.domain_items.periodic[k])
            {
                node = wrapped(&mut self.graph, node, low, high);
            }
            let tangent = self.graph.input((geometry::TANGENT + k) as u32);
            self.scope.bind(
                name,
                Binding {
                    node,
                    uses_tangent: false,
                },
            );
            let binding = Binding {
                node: tangent,
                uses_tangent: true,
            };
            self.scope.bind(format!("v{name}"), binding);
        }
    }

    fn read_lets(&mut self, item: Option<Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        for (name, item) in item.table()?.entries() {
            let text = item.text()?;
            let parsed = parse(&text.value, &self.scope, &mut self.graph);
            let parsed = parsed.map_err(|e| at_expression(&text, e))?;
            self.declare(&name, "a let")?;
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

    /// An expression of the coordinates alone.
    fn position_expression(&mut self, text: &Text) -> Reading<NodeId> {
        let parsed =
            parse(&text.value, &self.scope, &mut self.graph).map_err(|e| at_expression(text, e))?;
        match parsed.tangent_use {
            None => Ok(parsed.node),
            Some(span) => Err(text
                .complain_at(span, "the tangent may be used only in exits")
                .with_hint("metrics, embeddings and domains depend on the point alone")),
        }
    }

    /// An expression of the coordinates and the tangent.
    fn ray_expression(&mut self, text: &Text) -> Reading<NodeId> {
        let parsed = parse(&text.value, &self.scope, &mut self.graph);
        parsed.map(|p| p.node).map_err(|e| at_expression(text, e))
    }

    fn read_definition<'d>(
        &mut self,
        root: &Table<'d>,
    ) -> Reading<(Definition, Option<usize>, Item<'d>)> {
        match (root.get("embedding"), root.get("metric")) {
            (Some(item), None) => {
                let texts = item.texts()?;
                if !AMBIENT.contains(&texts.len()) {
                    return Err(item.complain(format!(
                        "an embedding has 3 to 16 components, {} given",
                        texts.len()
                    )));
                }
                let f: Reading<Vec<_>> =
                    texts.iter().map(|t| self.position_expression(t)).collect();
                Ok((Definition::Embedding(f?), Some(texts.len()), item))
            }
            (None, Some(item)) => Ok((self.read_metric(&item.table()?)?, None, item)),
            (Some(_), Some(item)) => Err(item
                .complain("both `embedding` and `metric` are given")
                .with_hint("keep exactly one of them")),
            (None, None) => Err(root
                .complain("neither `embedding` nor `metric` is given")
                .with_hint("add one, for example metric = { conformal = \"1\" } for flat space")),
        }
    }

    fn read_metric(&mut self, table: &Table<'_>) -> Reading<Definition> {
        let zero = self.graph.constant(0.0);
        if let Some(item) = table.get("conformal") {
            table.finish()?;
            let n = self.position_expression(&item.text()?)?;
            let n2 = self.graph.mul(n, n);
            return Ok(Definition::Metric([n2, n2, n2, zero, zero, zero]));
        }
        let mut entries = [zero; 6];
        let pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        for (entry, (i, j)) in entries.iter_mut().zip(pairs) {
            match self.metric_entry(table, i, j)? {
                Some(item) => *entry = self.position_expression(&item.text()?)?,
                None if i == j => {
                    return Err(
                        table.complain(format!("`{}` is missing", self.entry_names(i, j)[0]))
                    );
                }
                None => {}
            }
        }
        table.finish()?;
        Ok(Definition::Metric(entries))
    }

    /// The keys under which the entry (i, j) may stand: by the names of the coordinates, or x, y, z
    /// for first, second, third.
    fn entry_names(&self, i: usize, j: usize) -> [String; 4] {
        let name = |a: &str, b: &str| format!("{a}{b}");
        let (a, b) = (&self.coordinates[i], &self.coordinates[j]);
        let (x, y) = (["x", "y", "z"][i], ["x", "y", "z"][j]);
        [name(a, b), name(b, a), name(x, y), name(y, x)]
    }

    fn metric_entry<'d>(&self, table: &Table<'d>, i: usize, j: usize) -> Reading<Option<Item<'d>>> {
        let mut names = self.entry_names(i, j).to_vec();
        let own_xyz = ["x", "y", "z"]
            .iter()
            .any(|n| self.coordinates.iter().any(|c| c == n));
        if own_xyz {
            // Where coordinates are called x, y or z, keys mean the names, never the places.
            names.truncate(2);
        }
        names.dedup();
        let mut found = names.iter().filter_map(|n| table.get(n));
        let first = found.next();
        match found.next() {
            Some(second) if first.as_ref().is_some_and(|f| f.span != second.span) => Err(second
                .complain("this entry of the symmetric metric is given twice")
                .with_hint("give one of xy and yx")),
            _ => Ok(first),
        }
    }

    /// The exits with their event expressions.
    fn read_exits(&mut self, item: Option<Item<'_>>) -> Reading<(Vec<Exit>, Vec<NodeId>)> {
        let (mut exits, mut events) = (Vec::<Exit>::new(), Vec::new());
        for item in item.map(|i| i.list()).transpose()?.unwrap_or_default() {
            let table = item.table()?;
            let name = table.require("name")?.text()?;
            if [LIMIT, INSIDE, "length", "singular"].contains(&name.value.as_str()) {
                return Err(name
                    .complain(format!("`{}` is the name of a built-in end", name.value))
                    .with_hint("choose another name"));
            }
            if exits.iter().any(|e| e.name == name.value) {
                return Err(name.complain(format!("a second exit is called `{}`", name.value)));
            }
            events.push(self.ray_expression(&table.require("when")?.text()?)?);
            let direction = table
                .get("direction")
                .map(|d| self.read_direction(&d))
                .transpose()?;
            table.finish()?;
            exits.push(Exit {
                name: name.value,
                direction,
            });
        }
        for name in [LIMIT, INSIDE] {
            exits.push(Exit {
                name: name.into(),
                direction: None,
            });
        }
        Ok((exits, events))
    }

    fn read_direction(&mut self, item: &Item<'_>) -> Reading<Tape> {
        let mut nodes = Vec::new();
        for component in item.exactly::<3>("components")? {
            nodes.push(self.ray_expression(&component.text()?)?);
        }
        Tape::compile(&self.graph, &nodes, 6).map_err(|e| item.complain(e.to_string()))
    }

    /// Limits, conditions and exits as one event tape.
    fn compile_domain(&mut self, exits: Vec<NodeId>) -> Reading<Domain> {
        let Domains {
            limits,
            periodic,
            inside,
        } = std::mem::take(&mut self.domain_items);
        let mut kinds: Vec<EventKind> = (0..exits.len()).map(EventKind::Exit).collect();
        let mut events = exits;
        for k in 0..3 {
            if let (Some([low, high]), false) = (limits[k], periodic[k]) {
                let u = self.graph.input(k as u32);
                let (low, high) = (self.graph.constant(low), self.graph.constant(high));
                events.extend([self.graph.sub(low, u), self.graph.sub(u, high)]);
                kinds.extend([EventKind::Limit; 2]);
            }
        }
        for text in &inside {
            let value = self.position_expression(text)?;
            events.push(self.graph.neg(value));
            kinds.push(EventKind::Inside);
        }
        let place = || Diagnostic::new(self.source, 0..0, "the exits and conditions are too large");
        let events = Tape::compile(&self.graph, &events, 6).map_err(|_| place())?;
        Ok(Domain {
            limits,
            periodic,
            kinds,
            events,
        })
    }

    fn read_symmetry(&mut self, item: Option<Item<'_>>) -> Reading<Symmetry> {
        let mut symmetry = Symmetry::default();
        let Some(item) = item else {
            return Ok(symmetry);
        };
        let table = item.table()?;
        if let Some(about) = table.get("rotation") {
            let about = about.text()?;
            if about.value != "origin" {
                return Err(about
                    .complain(format!("rotations about `{}` are not known", about.value))
                    .with_hint("only rotation = \"origin\" can be claimed"));
            }
            symmetry.rotation = true;
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

    /// (u, p) -> p·u and its differential in u.
    fn read_group(&mut self, item: &Item<'_>) -> Reading<Tape> {
        let mut scope = self.scope.clone();
        for (k, name) in self.coordinates.iter().enumerate() {
            let binding = |node| Binding {
                node,
                uses_tangent: false,
            };
            // Group laws hold on the covering chart: no wrapping here.
            scope.bind(name, binding(self.graph.input(k as u32)));
            scope.bind(format!("p{name}"), binding(self.graph.input(3 + k as u32)));
        }
        let mut nodes = Vec::new();
        for component in item.exactly::<3>("components")? {
            let text = component.text()?;
            let parsed = parse(&text.value, &scope, &mut self.graph);
            nodes.push(parsed.map_err(|e| at_expression(&text, e))?.node);
        }
        for row in 0..3 {
            for k in 0..3 {
                let (u, one) = (self.graph.input(k), self.graph.constant(1.0));
                let rate = self
                    .graph
                    .derivative(nodes[row], &mut Direction::new([(u, one)]));
                nodes.push(rate);
            }
        }
        Tape::compile(&self.graph, &nodes, 6).map_err(|e| item.complain(e.to_string()))
    }

    fn read_length(&self, item: Option<&Item<'_>>) -> Reading<Option<f64>> {
        let Some(item) = item else { return Ok(None) };
        let Some(length) = item.table()?.get("length") else {
            return Ok(None);
        };
        match length.number()? {
            value if value > 0.0 => Ok(Some(value)),
            _ => Err(length.complain("a length must be positive")),
        }
    }

    /// The camera region: as written, else the box of the coordinate limits, else (with a group)
    /// the identity alone.
    fn read_cameras(
        &mut self,
        item: Option<&Item<'_>>,
        domain: &Domain,
        symmetry: &Symmetry,
    ) -> Reading<Option<CameraRegion>> {
        let table = item.map(|i| i.table()).transpose()?;
        let at = table.as_ref().and_then(|t| t.get("at"));
        let (names, intervals) = match table.as_ref().and_then(|t| t.get("parameters")) {
            Some(item) => self.read_camera_parameters(&item, at.is_some())?,
            None => Default::default(),
        };
        if let Some(table) = &table {
            table.get("length");
            table.finish()?;
        }
        match (at, domain.limits.iter().copied().collect()) {
            (Some(at), _) => self.written_region(&at, names, intervals).map(Some),
            (None, _) if symmetry.group.is_some() => Ok(Some(self.identity_region()?)),
            (None, Some(intervals)) => Ok(Some(self.box_region(intervals)?)),
            (None, None) => Ok(None),
        }
    }

    fn read_camera_parameters(
        &mut self,
        item: &Item<'_>,
        used: bool,
    ) -> Reading<(Vec<String>, Vec<[f64; 2]>)> {
        let entries = item.table()?.entries();
        if entries.len() > 3 {
            return Err(item.complain("a camera region has at most 3 parameters"));
        }
        if !used && !entries.is_empty() {
            return Err(item.complain("camera parameters need `at`").with_hint(
                "add at = [\"…\", \"…\", \"…\"], the chart point as expressions of them",
            ));
        }
        let mut found = (Vec::new(), Vec::new());
        for (name, interval) in entries {
            self.declare(&name, "a camera parameter")?;
            found.1.push(interval.interval()?);
            found.0.push(name.value);
        }
        Ok(found)
    }

    fn written_region(
        &mut self,
        at: &Item<'_>,
        names: Vec<String>,
        intervals: Vec<[f64; 2]>,
    ) -> Reading<CameraRegion> {
        let mut scope = self.fixed.clone();
        for (k, name) in names.iter().enumerate() {
            let node = self.graph.input(k as u32);
            scope.bind(
                name,
                Binding {
                    node,
                    uses_tangent: false,
                },
            );
        }
        let mut nodes = Vec::new();
        for component in at.exactly::<3>("coordinates")? {
            let text = component.text()?;
            let parsed = parse(&text.value, &scope, &mut self.graph);
            nodes.push(
                parsed
                    .map_err(|e| at_camera(&text, e, &self.declared))?
                    .node,
            );
        }
        self.region(names, intervals, nodes)
            .map_err(|e| at.complain(e.to_string()))
    }

    fn box_region(&mut self, intervals: Vec<[f64; 2]>) -> Reading<CameraRegion> {
        let nodes = (0..3).map(|k| self.graph.input(k)).collect();
        self.region(self.coordinates.to_vec(), intervals, nodes)
            .map_err(|e| Diagnostic::new(self.source, 0..0, e.to_string()))
    }

    fn identity_region(&mut self) -> Reading<CameraRegion> {
        let zero = self.graph.constant(0.0);
        self.region(Vec::new(), Vec::new(), vec![zero; 3])
            .map_err(|e| Diagnostic::new(self.source, 0..0, e.to_string()))
    }

    fn region(
        &mut self,
        names: Vec<String>,
        intervals: Vec<[f64; 2]>,
        mut nodes: Vec<NodeId>,
    ) -> Result<CameraRegion, crate::expr::TapeTooLarge> {
        for k in 0..names.len() {
            let (p, one) = (self.graph.input(k as u32), self.graph.constant(1.0));
            let mut direction = Direction::new([(p, one)]);
            for i in 0..3 {
                let rate = self.graph.derivative(nodes[i], &mut direction);
                nodes.push(rate);
            }
        }
        let map = Tape::compile(&self.graph, &nodes, names.len())?;
        Ok(CameraRegion {
            names,
            intervals,
            map,
        })
    }

    #[allow(clippy::type_complexity)]
    fn compile(
        &mut self,
        geometry: &Geometry,
    ) -> Result<(Tape, Option<Tape>, [Tape; 4]), crate::expr::TapeTooLarge> {
        let metric: Vec<_> = geometry
            .metric
            .iter()
            .chain(&geometry.frame)
            .copied()
            .collect();
        let metric = Tape::compile(&self.graph, &metric, 3)?;
        let ambient = geometry.jacobian.as_ref().map(|rows| {
            let first: Vec<_> = rows.iter().take(3).flatten().copied().collect();
            Tape::compile(&self.graph, &first, 3)
        });
        let rates = geometry::deviation_rates(&mut self.graph, geometry.acceleration);
        let flow = |carried: Carried| {
            let mut outputs = geometry.acceleration.to_vec();
            outputs.extend(geometry.metric);
            if carried.frame {
                outputs.extend(geometry.turning);
            }
            if carried.deviation {
                outputs.extend(rates.iter().flatten());
            }
            Tape::compile(&self.graph, &outputs, geometry::DEVIATION + 12)
        };
        let flows = [
            flow(Carried {
                frame: false,
                deviation: false,
            })?,
            flow(Carried {
                frame: true,
                deviation: false,
            })?,
            flow(Carried {
                frame: false,
                deviation: true,
            })?,
            flow(Carried {
                frame: true,
                deviation: true,
            })?,
        ];
        Ok((metric, ambient.transpose()?, flows))
    }
}

/// `x − P ⌊(x − low)/P⌋`
fn wrapped(graph: &mut Graph, x: NodeId, low: f64, high: f64) -> NodeId {
    let (origin, period) = (graph.constant(low), graph.constant(high - low));
    let offset = graph.sub(x, origin);
    let turns = graph.div(offset, period);
    let turns = graph.unary(crate::expr::Unary::Floor, turns);
    let shift = graph.mul(period, turns);
    graph.sub(x, shift)
}

fn at_expression(text: &Text, error: crate::expr::parse::ExpressionError) -> Diagnostic {
    let diagnostic = text.complain_at(error.span, error.message);
    match error.hint {
        Some(hint) => diagnostic.with_hint(hint),
        None => diagnostic,
    }
}

/// As [`at_expression`], with a better hint for names that exist but not for cameras.
fn at_camera(
    text: &Text,
    error: crate::expr::parse::ExpressionError,
    declared: &[(String, &'static str)],
) -> Diagnostic {
    let name = text.value.get(error.span.clone()).unwrap_or_default();
    let known = declared.iter().find(|(d, _)| d == name);
    let diagnostic = at_expression(text, error.clone());
    match known {
        Some((name, kind)) if error.message.starts_with("unknown name") => diagnostic.with_hint(
            format!("`{name}` is {kind}; a camera's position uses [parameters] and the camera parameters"),
        ),
        _ => diagnostic,
    }
}
