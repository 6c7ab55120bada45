//! The `[domain]` section: limits, glued coordinates, conditions.

use super::{Loader, Reading};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text, TomlTable},
    manifold::{Domain, EventKind},
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

/// Events with what each stands for.
type EventNodes = Vec<(EventKind, NodeId)>;

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
        let mut events: EventNodes = exits.map(|(i, e)| (EventKind::Exit(i), e)).collect();
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

    fn limit_events(&mut self, k: usize, [low, high]: [f64; 2]) -> EventNodes {
        let u = self.graph.input(k as u32);
        let (low, high) = (self.graph.constant(low), self.graph.constant(high));
        let beyond = [self.graph.sub(low, u), self.graph.sub(u, high)];
        beyond.map(|node| (EventKind::Limit, node)).to_vec()
    }
}
