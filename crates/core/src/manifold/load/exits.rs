//! The `[[exit]]` sections: named ways out.

use super::{Loader, Reading, three_texts};
use crate::{
    document::{Item, TomlTable},
    manifold::Exit,
};
use geofan_expr::{NodeId, Tape};

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
        if BUILT_IN.iter().chain(&OTHER_ENDS).any(|n| *n == name.value) {
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
