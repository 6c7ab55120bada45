//! The `[[glue]]` and `[quotient]` sections: faces of the domain and the maps by which paths come back.

use super::{Loader, Reading, expression, three_texts};
use crate::{
    document::Item,
    manifold::{
        Domain,
        gluing::{FaceNodes, Gluing, LinearModel, quotient},
    },
};
use geofan_expr::{
    Direction, NodeId, Tape,
    parse::{Binding, Scope},
};
use glam::DVec3;
use std::sync::Arc;

/// The names of the first components of `lift` in `drop`; those that follow are X5, X6, …
const COMPONENTS: [&str; 4] = ["X", "Y", "Z", "W"];

/// Units in which a place beside the centre is looked for at which a linear model is checked.
const MODEL_UNITS: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-9];

/// Dimensions that a linear model may have.
const DIMENSIONS: std::ops::RangeInclusive<usize> = 3..=12;

impl Loader<'_> {
    /// Reads faces, by themselves or as those of a group's domain.
    pub(super) fn read_gluing(
        &mut self,
        (glue, group): (Option<Item<'_>>, Option<Item<'_>>),
        domain: &Domain,
        metric: [NodeId; 6],
    ) -> Reading<Option<Gluing>> {
        let Some(item) = glue.as_ref().or(group.as_ref()) else {
            return Ok(None);
        };
        if domain.periodic.contains(&true) {
            return Err(item
                .complain("glued faces and `periodic` coordinates are not possible together")
                .with_hint(
                    "write the periodic coordinates as two faces each, with translations as maps",
                ));
        }
        let mut faces = Vec::new();
        if let Some(item) = &glue {
            let list = item.list();
            let list =
                list.map_err(|complaint| complaint.with_hint("write [[glue]], in double brackets"));
            for item in list? {
                faces.push(self.read_face(&item)?);
            }
        }
        if let Some(item) = &group {
            faces.extend(self.read_quotient(item, metric)?);
        }
        let gluing = Gluing::compile(&mut self.graph, faces);
        gluing.map(Some).map_err(|e| item.complain(e.to_string()))
    }

    fn read_face(&mut self, item: &Item<'_>) -> Reading<FaceNodes> {
        let table = item.table()?;
        let [face, map, opening, mirror] =
            ["face", "map", "opening", "mirror"].map(|key| table.get(key));
        table.finish()?;
        let face = face.ok_or_else(|| table.complain("a glued face needs `face`"))?;
        let mirror = mirror.map(|item| truth(&item)).transpose()?;
        let span = face.span.clone();
        let value = self.position_expression(&face.text()?)?;
        let opening = opening
            .map(|item| self.position_expression(&item.text()?))
            .transpose()?;
        let map = match (map, mirror.unwrap_or(false)) {
            (Some(map), false) => {
                let map = self.read_map(&map)?;
                self.refuse_rough(&map, "the map of a face", 2)?;
                Some(map)
            }
            (None, true) => {
                self.refuse_rough(&[value], "a mirror", 2)?;
                None
            }
            (Some(map), true) => {
                return Err(map
                    .complain("a face has a map or is a mirror")
                    .with_hint("take one of `map` and `mirror` away"));
            }
            (None, false) => {
                return Err(table
                    .complain("a glued face needs `map`")
                    .with_hint("add map = [\"…\", \"…\", \"…\"], the coordinates at which a path that leaves here comes back, or mirror = true"));
            }
        };
        Ok(FaceNodes {
            value,
            map,
            opening,
            matrix: None,
            span,
        })
    }

    fn read_map(&mut self, item: &Item<'_>) -> Reading<[NodeId; 3]> {
        let [x, y, z] = three_texts(item, "coordinates")?;
        Ok([
            self.position_expression(&x)?,
            self.position_expression(&y)?,
            self.position_expression(&z)?,
        ])
    }

    /// Reads the faces of Dirichlet's domain of a group of matrices.
    fn read_quotient(&mut self, item: &Item<'_>, metric: [NodeId; 6]) -> Reading<Vec<FaceNodes>> {
        let table = item.table()?;
        let lift = table.require("lift")?;
        let drop = table.require("drop")?;
        let generators = table.require("generators")?;
        let centre = table.get("centre");
        table.finish()?;
        let centre = match &centre {
            Some(item) => DVec3::from_array(item.numbers()?),
            None => DVec3::ZERO,
        };
        let lifted = self.read_lift(&lift)?;
        let model = self.linear_model(&lift, &lifted, &drop)?;
        check_model(&lift, &model, centre)?;
        let matrices = read_matrices(&generators, lifted.len())?;
        let metric = Tape::compile(&self.graph, &metric, 3);
        let metric = metric.map_err(|e| item.complain(e.to_string()))?;
        let metric = |u: DVec3| {
            let entries = metric.at(&u.to_array());
            std::array::from_fn(|k| entries[k])
        };
        let found = quotient::dirichlet(&model, &matrices, centre, &metric);
        let found = found.map_err(|message| {
            generators.complain(message).with_hint(
                "the group must be discrete, and no element but the identity may fix `centre`",
            )
        })?;
        let texts = three_texts(&drop, "coordinates")?;
        let mut faces = Vec::new();
        for face in found {
            let moved = face.matrix.chunks_exact(lifted.len());
            let moved: Vec<NodeId> = moved.map(|row| self.combination(row, &lifted)).collect();
            let scope = self.dropping(&moved);
            let mut map = [moved[0]; 3];
            for (slot, text) in map.iter_mut().zip(&texts) {
                *slot = expression(text, &scope, &mut self.graph)?.node;
            }
            let value = match &face.row {
                Some(row) => self.combination(row, &lifted),
                None => self.nearer(map, centre, &face.metric),
            };
            faces.push(FaceNodes {
                value,
                map: Some(map),
                opening: None,
                matrix: Some((face.matrix, model.clone())),
                span: generators.span.clone(),
            });
        }
        Ok(faces)
    }

    /// Reads the components of a point of the model.
    fn read_lift(&mut self, lift: &Item<'_>) -> Reading<Vec<NodeId>> {
        let texts = lift.texts()?;
        if !DIMENSIONS.contains(&texts.len()) {
            return Err(lift.complain(format!(
                "{} components are not possible here, 3 to 12 are",
                texts.len()
            )));
        }
        texts
            .iter()
            .map(|text| self.position_expression(text))
            .collect()
    }

    /// Builds `Σ aᵢ xᵢ`.
    fn combination(&mut self, row: &[f64], nodes: &[NodeId]) -> NodeId {
        let row: Vec<NodeId> = row.iter().map(|a| self.graph.constant(*a)).collect();
        self.graph.dot(&row, nodes)
    }

    /// Binds the components of the model to `nodes`.
    fn dropping(&self, nodes: &[NodeId]) -> Scope {
        let mut scope = self.fixed.clone();
        for (k, node) in nodes.iter().enumerate() {
            let name = match COMPONENTS.get(k) {
                Some(name) => (*name).to_string(),
                None => format!("X{}", k + 1),
            };
            scope.bind(&name, Binding::fixed(*node));
        }
        scope
    }

    fn linear_model(
        &mut self,
        lift: &Item<'_>,
        lifted: &[NodeId],
        drop: &Item<'_>,
    ) -> Reading<Arc<LinearModel>> {
        let n = lifted.len();
        let mut outputs = lifted.to_vec();
        for k in 0..3 {
            let mut axis = Direction::of_input(&mut self.graph, k);
            for node in lifted {
                outputs.push(self.graph.derivative(*node, &mut axis));
            }
        }
        let lift_tape = Tape::compile(&self.graph, &outputs, 3);
        let inputs: Vec<NodeId> = (0..n).map(|k| self.graph.input(k as u32)).collect();
        let scope = self.dropping(&inputs);
        let mut outputs = Vec::new();
        for text in three_texts(drop, "coordinates")? {
            outputs.push(expression(&text, &scope, &mut self.graph)?.node);
        }
        for k in 0..n {
            let mut axis = Direction::of_input(&mut self.graph, k as u32);
            for i in 0..3 {
                outputs.push(self.graph.derivative(outputs[i], &mut axis));
            }
        }
        Ok(Arc::new(LinearModel {
            dimension: n,
            lift: lift_tape.map_err(|e| lift.complain(e.to_string()))?,
            drop: Tape::compile(&self.graph, &outputs, n)
                .map_err(|e| drop.complain(e.to_string()))?,
        }))
    }

    /// Builds `|φ(u) − c|² − |u − c|²` in the fixed metric `g` (xx, yy, zz, xy, xz, yz).
    fn nearer(&mut self, map: [NodeId; 3], centre: DVec3, g: &[f64; 6]) -> NodeId {
        let here = [0, 1, 2].map(|k| self.graph.input(k));
        let [there, here] = [map, here].map(|point| {
            let graph = &mut self.graph;
            let off = [0, 1, 2].map(|k| {
                let c = graph.constant(centre[k]);
                graph.sub(point[k], c)
            });
            let pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
            let terms = pairs.iter().zip(g).map(|((i, j), g)| {
                let twice = if i == j { 1.0 } else { 2.0 };
                (off[*i], off[*j], g * twice)
            });
            let mut sum = graph.constant(0.0);
            for (a, b, g) in terms {
                let g = graph.constant(g);
                let product = graph.mul(a, b);
                let term = graph.mul(g, product);
                sum = graph.add(sum, term);
            }
            sum
        });
        self.graph.sub(there, here)
    }
}

/// Reads a truth value.
fn truth(item: &Item<'_>) -> Reading<bool> {
    item.as_truth()
        .ok_or_else(|| item.complain("true or false is needed here"))
}

/// Checks that `drop` undoes `lift`.
fn check_model(lift: &Item<'_>, model: &Arc<LinearModel>, centre: DVec3) -> Reading<()> {
    let off = |u: DVec3| {
        let lifted = model.lift.at(&u.to_array());
        let dropped = model.drop.at(&lifted[..model.dimension]);
        (DVec3::from_slice(&dropped[..3]) - u).length()
    };
    // As far from the centre as the model has points, which in a chart of small units is not far.
    let units = MODEL_UNITS.into_iter();
    let mut beside = units.map(|unit| (unit, centre + DVec3::new(0.01, -0.02, 0.015) * unit));
    let beside = beside.find(|(_, u)| off(*u).is_finite());
    for (unit, u) in std::iter::once((1.0, centre)).chain(beside) {
        let found = off(u);
        if !(found <= 1e-9 * (unit + u.length())) {
            return Err(lift
                .complain(format!(
                    "`drop` does not undo `lift`: {u} comes back {found:.2e} beside itself"
                ))
                .with_hint(
                    "drop(lift(u)) must be u; the components of `lift` are X, Y, Z, W in `drop`",
                ));
        }
    }
    Ok(())
}

/// Reads the matrices of a list, by rows.
fn read_matrices(item: &Item<'_>, n: usize) -> Reading<Vec<Vec<f64>>> {
    let mut matrices = Vec::new();
    for matrix in item.list()? {
        let rows = matrix.list()?;
        if rows.len() != n {
            let count = rows.len();
            return Err(matrix.complain(format!(
                "a matrix of {n} rows is needed here, as `lift` has {n} components; this has {count}"
            )));
        }
        let mut entries = Vec::new();
        for row in rows {
            let numbers = row.list()?;
            if numbers.len() != n {
                let count = numbers.len();
                return Err(row.complain(format!("{n} numbers are needed here, {count} given")));
            }
            for number in numbers {
                entries.push(number.number()?);
            }
        }
        matrices.push(entries);
    }
    if matrices.is_empty() {
        return Err(item.complain("a group needs generators"));
    }
    Ok(matrices)
}
