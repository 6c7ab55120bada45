//! The text of a manifold file -> [`Manifold`], with every complaint at its place.
//!
//! In: the file as TOML and values that replace its parameters. Out: a [`Manifold`] of which nothing
//! numerical is checked yet. Sections of the file have files here, in the order of reading:
//! [`names`] (coordinates, parameters, textbook coordinates, lets), [`domain_and_exits`], [`fields`], [`definition`]
//! (embedding, metric or spacetime, wind and drift), [`gluing`], [`symmetry_and_cameras`].

mod definition;
mod domain_and_exits;
mod fields;
mod gluing;
mod names;
mod symmetry_and_cameras;

use super::{Follows, Kin, Manifold, geometry, pullback::Pullback, tapes::Tapes};
use crate::{
    diagnostic::{Diagnostic, SourceText},
    document::{self, Item, Reading, Text, TomlTable},
    error::{Error, Result},
    field::NamedSamples,
};
use definition::Given;
use fields::LoadedField;
use geofan_expr::{
    Graph, NodeId, TapeTooLarge,
    parse::{ExpressionError, Parsed, Scope, parse},
    spelling::nearest,
};
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
        self.read_pullback(root.get("pullback"))?;
        self.read_lets(root.get("let"))?;
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
        let pullback = self.pullback.as_ref().map(|p| p.1.clone());
        let kin = Kin::new(&self.graph, &definition, medium, pullback.as_ref());
        let kin = kin.map_err(too_large)?;
        let seen = match &kin {
            Some(_) => medium.reversed(&mut self.graph),
            None => medium,
        };
        let geometry = geometry::build(&mut self.graph, &definition, &seen);
        let (exits, events) = self.read_exits(root.get("exit"), field_exits)?;
        let domain = self.compile_domain(domain, events, conditions)?;
        let faces = (root.get("glue"), root.get("quotient"));
        let gluing = self.read_gluing(faces, &domain, geometry.metric)?;
        let symmetry = self.read_symmetry(root.get("symmetry"))?;
        let section = root.get("cameras");
        let length = self.read_length(section.as_ref())?;
        let cameras = self.read_cameras(section.as_ref(), &domain, &symmetry)?;
        let tapes = Tapes::compile(self.graph, &definition, &seen, geometry, pullback.as_ref());
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
        match parsed.tangent_use {
            None => Ok(parsed.node),
            Some(span) => Err(text
                .complain_at(span, "the tangent may be used only in exits")
                .with_hint("metrics, embeddings and domains depend on the point alone")),
        }
    }

    /// An expression of the coordinates and the tangent.
    fn ray_expression(&mut self, text: &Text) -> Reading<NodeId> {
        expression(text, &self.scope, &mut self.graph).map(|parsed| parsed.node)
    }
}

/// First of all, so that a misspelt key is named and not the absence of the right one.
fn refuse_unknown_keys(root: &TomlTable<'_>) -> Reading<()> {
    if let (Some(item), None) = (root.get("manifold"), root.get("coordinates")) {
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

/// The complaint about a part of the expression `text`.
fn at_expression(text: &Text, error: ExpressionError) -> Diagnostic {
    let diagnostic = text.complain_at(error.span, error.message);
    match error.hint {
        Some(hint) => diagnostic.with_hint(hint),
        None => diagnostic,
    }
}

/// The three strings of a list, for example of a direction's components.
fn three_texts(item: &Item<'_>, what: &str) -> Reading<[Text; 3]> {
    let [a, b, c] = item.exactly::<3>(what)?;
    Ok([a.text()?, b.text()?, c.text()?])
}
