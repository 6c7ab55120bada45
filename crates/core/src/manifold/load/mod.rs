//! The text of a manifold file -> [`Manifold`], with every complaint at its place.
//!
//! In: the file as TOML and values that replace its parameters. Out: a [`Manifold`] of which nothing
//! numerical is checked yet. The names of the file (coordinates, parameters, textbook coordinates, lets) are read here into
//! scopes in which later sections are read: a name may be declared once, before its use, and what a let names must stand
//! above it. Other sections have files: [`regions`] (domain, exits, symmetry, cameras), [`fields`], [`definition`]
//! (embedding, metric or spacetime, wind and drift; [`entry_keys`]), [`gluing`].

mod definition;
mod entry_keys;
mod fields;
mod gluing;
mod regions;

use super::{
    Follows, Kin, Manifold,
    geometry::{self, Pullback},
    tapes::Tapes,
};
use crate::{
    diagnostic::{Diagnostic, SourceText},
    document::{self, Item, Reading, Text, TomlTable},
    error::{Error, Result},
    field::NamedSamples,
};
use definition::Given;
use fields::LoadedField;
use geofan_expr::{
    Graph, NodeId, TapeTooLarge, Unary,
    parse::{Binding, ExpressionError, Parsed, Scope, is_function, parse},
    spelling::nearest,
};
use regions::Limits;
use std::sync::Arc;

/// The keys that a manifold file may have at its top.
const KEYS: [&str; 19] = [
    "name",
    "coordinates",
    "embedding",
    "metric",
    "spacetime",
    "pullback",
    "wind",
    "shift",
    "lapse",
    "drift",
    "parameters",
    "field",
    "let",
    "domain",
    "exit",
    "glue",
    "quotient",
    "symmetry",
    "cameras",
];

/// Reads the file; nothing numerical is checked yet. Fields in `samples` need no files.
pub(super) fn from_source(
    source: &Arc<SourceText>,
    settings: &[(String, f64)],
    samples: &NamedSamples,
) -> Result<Manifold> {
    if let Some((name, value)) = settings.iter().find(|(_, v)| !v.is_finite()) {
        return Err(Error::input(
            "--set",
            format!("{name}={value} is not finite"),
        ));
    }
    let read = |root: TomlTable<'_>| Loader::new(source, samples).load(&root, settings);
    let manifold = document::read(source, read)?;
    for (name, _) in settings {
        refuse_unless_known(name, &manifold.parameters)?;
    }
    Ok(manifold)
}

/// Refuses to set a parameter that the file does not have.
fn refuse_unless_known(name: &str, parameters: &[(String, f64)]) -> Result<()> {
    let known: Vec<&str> = parameters.iter().map(|p| p.0.as_str()).collect();
    if known.contains(&name) {
        return Ok(());
    }
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

/// The parts of the file that have been read so far.
struct Loader<'s> {
    source: &'s Arc<SourceText>,
    graph: Graph,
    /// The names that expressions over the chart may use.
    scope: Scope,
    /// The names that camera expressions may use: parameters and what follows from them alone.
    fixed: Scope,
    /// Every name with what it is, for complaints.
    declared: Vec<(String, &'static str)>,
    coordinates: [String; 3],
    /// The coordinates in which the space is written, where they are not those of the chart.
    pullback: Option<([String; 3], Pullback)>,
    /// Samples that need not be read.
    samples: &'s NamedSamples,
    fields: Vec<LoadedField>,
}

impl<'s> Loader<'s> {
    fn new(source: &'s Arc<SourceText>, samples: &'s NamedSamples) -> Self {
        Self {
            source,
            graph: Graph::new(),
            scope: Scope::default(),
            fixed: Scope::default(),
            declared: Vec::new(),
            coordinates: Default::default(),
            pullback: None,
            samples,
            fields: Vec::new(),
        }
    }

    fn load(mut self, root: &TomlTable<'_>, settings: &[(String, f64)]) -> Reading<Manifold> {
        refuse_unknown_keys(root)?;
        let name = root.require("name")?.text()?.value;
        self.coordinates = self.read_coordinates(&root.require("coordinates")?)?;
        let parameters = self.read_parameters(root.get("parameters"), settings)?;
        let domain = self.read_domain(root.get("domain"))?;
        self.bind_coordinates(&domain);
        self.read_fields(root.get("field"))?;
        let lets = root.get("let");
        self.read_pullback(root.get("pullback"), lets.as_ref())?;
        self.read_lets(lets)?;
        let Given {
            form,
            definition,
            medium,
            conditions,
            place,
        } = self.read_definition(root)?;
        let medium_nodes: Vec<NodeId> = medium.nodes().collect();
        self.check_smoothness(&definition, &medium_nodes)?;
        let field_exits = self.field_exits(&[definition.nodes(), &medium_nodes].concat());
        let too_large = |e: TapeTooLarge| place.complain(e.to_string());
        let seen = match medium.moves() {
            true => medium.reversed(&mut self.graph),
            false => medium,
        };
        let geometry = geometry::build(&mut self.graph, &definition, &seen);
        let (exits, events) = self.read_exits(root.get("exit"), field_exits)?;
        let pullback = self.pullback.as_ref().map(|p| p.1.clone());
        let pullback = pullback.as_ref();
        let kin = Kin::new(&self.graph, &definition, medium, pullback, &events);
        let kin = kin.map_err(too_large)?;
        let domain = self.compile_domain(domain, &events, conditions)?;
        let faces = (root.get("glue"), root.get("quotient"));
        let gluing = self.read_gluing(faces, &domain, geometry.metric)?;
        let symmetry = self.read_symmetry(root.get("symmetry"))?;
        let section = root.get("cameras");
        let length = self.read_length(section.as_ref())?;
        let cameras = self.read_cameras(section.as_ref(), &domain, &symmetry)?;
        let tapes = Tapes::compile(self.graph, &definition, &seen, geometry, pullback, &events);
        Ok(Manifold {
            source: self.source.clone(),
            name,
            coordinates: self.coordinates,
            parameters,
            domain,
            exits,
            symmetry,
            cameras,
            length,
            ambient: definition.ambient(),
            form,
            fields: self.fields.into_iter().map(|loaded| loaded.field).collect(),
            tapes: Arc::new(tapes.map_err(too_large)?),
            kin,
            follows: Follows::Sight,
            gluing: gluing.map(Arc::new),
            unfolded: false,
        })
    }

    /// An expression of the coordinates alone.
    fn position_expression(&mut self, text: &Text) -> Reading<NodeId> {
        let parsed = expression(text, &self.scope, &mut self.graph)?;
        of_position(text, parsed)
    }

    /// An expression of the coordinates and the tangent.
    fn ray_expression(&mut self, text: &Text) -> Reading<NodeId> {
        expression(text, &self.scope, &mut self.graph).map(|parsed| parsed.node)
    }
}

/// First of all, so that a misspelt key is named and not the absence of the right one.
fn refuse_unknown_keys(root: &TomlTable<'_>) -> Reading<()> {
    if root.get("coordinates").is_none()
        && let Some(item) = root.get("manifold")
    {
        return Err(item
            .complain("this is a scene, not a manifold")
            .with_hint("its manifold is the file that it names here; `geofan render` and `geofan view` take scenes"));
    }
    for key in KEYS {
        root.get(key);
    }
    root.finish()
}

/// The expression `text` in `graph`, with a complaint at its place in the file.
fn expression(text: &Text, scope: &Scope, graph: &mut Graph) -> Reading<Parsed> {
    parse(&text.value, scope, graph).map_err(|e| at_expression(text, e))
}

/// An expression that must not name the tangent.
fn of_position(text: &Text, parsed: Parsed) -> Reading<NodeId> {
    match parsed.tangent_use {
        None => Ok(parsed.node),
        Some(span) => Err(text
            .complain_at(span, "the tangent may be used only in exits")
            .with_hint("metrics, embeddings and domains depend on the point alone")),
    }
}

/// The complaint about a part of the expression `text`.
fn at_expression(text: &Text, error: ExpressionError) -> Diagnostic {
    let advice = match error.unknown.as_deref() {
        Some("t") => Some("nothing depends on time: a metric is that of one moment, a spacetime is the same at all times".into()),
        _ => error.advice("declare it under [parameters] or [let]"),
    };
    let diagnostic = text.complain_at(error.span, error.message);
    match advice {
        Some(hint) => diagnostic.with_hint(hint),
        None => diagnostic,
    }
}

/// Makes a complaint about a value that no parameter or let has one about its name, if that is a key of the file's top.
fn misplaced(name: &Text, fault: Diagnostic) -> Diagnostic {
    match KEYS.contains(&name.value.as_str()) {
        true => name
            .complain(format!("`{}` belongs to the file's top", name.value))
            .with_hint("write it above the first [header]: all that is below one belongs to it"),
        false => fault,
    }
}

/// The three strings of a list, for example of a direction's components.
fn three_texts(item: &Item<'_>, what: &str) -> Reading<[Text; 3]> {
    let [a, b, c] = item.exactly::<3>(what)?;
    Ok([a.text()?, b.text()?, c.text()?])
}

/// Kinds of names that depend on the chart.
const A_LET: &str = "a let";
const PULLED_BACK: &str = "a pulled-back coordinate";

impl Loader<'_> {
    fn declare(&mut self, name: &Text, kind: &'static str) -> Reading<()> {
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

    fn read_coordinates(&mut self, item: &Item<'_>) -> Reading<[String; 3]> {
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

    fn read_parameters(
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
            let own = item.number().map_err(|fault| misplaced(&name, fault))?;
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

    /// Binds the coordinates and the tangent. A glued coordinate is seen by expressions inside its
    /// limits only, so that paths may run on in the covering chart without a jump.
    fn bind_coordinates(&mut self, limits: &Limits) {
        for (k, name) in self.coordinates.iter().enumerate() {
            self.fixed.hide(name);
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
    /// drifts are then written in them, and `lets` may name them, not they lets.
    fn read_pullback(&mut self, item: Option<Item<'_>>, lets: Option<&Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        let lets = lets.map(|lets| Ok(lets.table()?.entries())).transpose()?;
        let lets = lets.unwrap_or_default();
        let entries = item.table()?.entries();
        let count = entries.len();
        let entries: [_; 3] = entries.try_into().map_err(|_| {
            item.complain(format!("3 coordinates are needed here, {count} given"))
                .with_hint("write each as an expression of the chart's coordinates")
        })?;
        let mut names: [String; 3] = Default::default();
        let mut nodes = [self.graph.constant(0.0); 3];
        for (k, (name, item)) in entries.into_iter().enumerate() {
            let text = item.text()?;
            let parsed = parse(&text.value, &self.scope, &mut self.graph);
            let parsed = parsed.map_err(|e| {
                let names = lets.iter().map(|(name, _)| name.value.as_str());
                at_name(&text, e, names, "is a let; here coordinates, parameters and fields are known, and the entries above")
            })?;
            nodes[k] = of_position(&text, parsed)?;
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
    fn written_in(&self) -> &[String; 3] {
        self.pullback
            .as_ref()
            .map_or(&self.coordinates, |(names, _)| names)
    }

    fn read_lets(&mut self, item: Option<Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        let entries = item.table()?.entries();
        for (i, (name, item)) in entries.iter().enumerate() {
            let text = item.text().map_err(|fault| misplaced(name, fault))?;
            let parsed = parse(&text.value, &self.scope, &mut self.graph);
            let parsed = parsed.map_err(|e| {
                let below = entries[i..].iter().map(|(name, _)| name.value.as_str());
                at_name(
                    &text,
                    e,
                    below,
                    "is declared here or below; a let knows only those above it",
                )
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

/// As [`at_expression`], with a better hint for `names` that the file declares: why they are not known here.
fn at_name<'n>(
    text: &Text,
    error: ExpressionError,
    mut names: impl Iterator<Item = &'n str>,
    why: &str,
) -> Diagnostic {
    let unknown = error.unknown.clone();
    let complaint = at_expression(text, error);
    match unknown.filter(|unknown| names.any(|name| name == unknown)) {
        Some(name) => complaint.with_hint(format!("`{name}` {why}")),
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
