//! The `[symmetry]` section: claims, not yet checked.

use super::{Loader, Reading, expression, three_texts};
use crate::{document::Item, manifold::Symmetry};
use geofan_expr::{Direction, Tape, parse::Binding};
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

    /// (u, p) -> p·u and its differential in u.
    fn read_group(&mut self, item: &Item<'_>) -> Reading<Tape> {
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
        Tape::compile(&self.graph, &nodes, 6).map_err(|e| item.complain(e.to_string()))
    }
}
