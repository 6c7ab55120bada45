//! The `[domain]` and `[[exit]]` sections: limits, glued coordinates, conditions, and named ways out.

use super::{Loader, Reading, three_texts};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text, TomlTable},
    manifold::{Domain, EventKind, Exit},
};
use geofan_expr::{NodeId, Tape};

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
        exits: Vec<NodeId>,
        conditions: Vec<NodeId>,
    ) -> Reading<Domain> {
        let exits = exits.into_iter().enumerate();
        let mut events: Vec<_> = exits.map(|(i, e)| (EventKind::Exit(i), e)).collect();
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
        let too_large =
            |_| Diagnostic::new(self.source, 0..0, "the exits and conditions are too large");
        Ok(Domain {
            limits: limits.intervals,
            periodic: limits.periodic,
            kinds,
            events: Tape::compile(&self.graph, &nodes, 6).map_err(too_large)?,
        })
    }

    fn limit_events(&mut self, k: usize, [low, high]: [f64; 2]) -> [(EventKind, NodeId); 2] {
        let u = self.graph.input(k as u32);
        let (low, high) = (self.graph.constant(low), self.graph.constant(high));
        let beyond = [self.graph.sub(low, u), self.graph.sub(u, high)];
        beyond.map(|node| (EventKind::Limit, node))
    }
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
