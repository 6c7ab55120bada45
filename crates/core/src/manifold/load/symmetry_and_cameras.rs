//! The `[symmetry]` section, claims that are not checked yet; and `[cameras]`: where cameras may be, and how far
//! paths go.

use super::{A_LET, Loader, PULLED_BACK, Reading, at_expression, expression, three_texts};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text},
    manifold::{CameraRegion, Domain, GroupLaw, Symmetry},
};
use geofan_expr::{
    Direction, NodeId, Tape, TapeTooLarge,
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
            nodes.push(expression(&text, &scope, &mut self.graph)?.node);
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
