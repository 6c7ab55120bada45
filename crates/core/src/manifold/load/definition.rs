//! How the manifold is given: `embedding`, `metric` or `spacetime`.

use super::{Loader, Reading};
use crate::{
    document::{Item, TomlTable},
    manifold::{
        Form,
        geometry::{Definition, PAIRS},
        wind::Medium,
    },
};
use geofan_expr::NodeId;

/// The least and the most components of an embedding.
const AMBIENT: std::ops::RangeInclusive<usize> = 3..=16;

/// A file's description of the space, in terms of the chart.
pub(super) struct Given<'d> {
    pub form: Form,
    pub definition: Definition,
    pub medium: Medium,
    /// Each must stay positive.
    pub conditions: Vec<NodeId>,
    /// Where it was read from.
    pub place: Item<'d>,
}

impl Loader<'_> {
    /// The definition with its medium.
    pub(super) fn read_definition<'d>(&mut self, root: &TomlTable<'d>) -> Reading<Given<'d>> {
        let kinds = ["embedding", "metric", "spacetime"].map(|key| root.get(key));
        match kinds {
            [Some(place), None, None] => {
                let definition = self.read_embedding(&place)?;
                self.read_medium(root, Form::Embedding, definition, place)
            }
            [None, Some(place), None] => {
                let table = place.table().map_err(|complaint| {
                    complaint
                        .with_hint("write metric = { conformal = \"…\" }, or xx, yy, zz and so on")
                })?;
                let definition = self.read_metric(&table)?;
                self.read_medium(root, Form::Metric, definition, place)
            }
            [None, None, Some(place)] => self.read_spacetime(root, place),
            [Some(_), Some(item), None] => Err(item
                .complain("both `embedding` and `metric` are given")
                .with_hint("keep exactly one of them")),
            [_, _, Some(item)] => Err(item
                .complain("`spacetime` is given beside `embedding` or `metric`")
                .with_hint("keep exactly one of them")),
            [None, None, None] => Err(root
                .complain("neither `embedding` nor `metric` is given")
                .with_hint("add one, for example metric = { conformal = \"1\" } for flat space")),
        }
    }

    fn read_embedding(&mut self, item: &Item<'_>) -> Reading<Definition> {
        let texts = item.texts()?;
        if !AMBIENT.contains(&texts.len()) {
            let (least, most) = (AMBIENT.start(), AMBIENT.end());
            return Err(item.complain(format!(
                "an embedding has {least} to {most} components, {} given",
                texts.len()
            )));
        }
        let components: Reading<Vec<_>> =
            texts.iter().map(|t| self.position_expression(t)).collect();
        Ok(Definition::Embedding(components?))
    }

    fn read_metric(&mut self, table: &TomlTable<'_>) -> Reading<Definition> {
        let zero = self.graph.constant(0.0);
        if let Some(item) = table.get("conformal") {
            table.finish().map_err(|complaint| {
                complaint.with_hint("`conformal` is the whole metric: give it, or the entries")
            })?;
            if self.pullback.is_some() {
                return Err(item
                    .complain("`conformal` is a factor of the chart's own coordinates")
                    .with_hint(
                        "with [pullback], give the entries in the coordinates named there",
                    ));
            }
            let n = self.position_expression(&item.text()?)?;
            let n2 = self.graph.mul(n, n);
            return Ok(Definition::Metric([n2, n2, n2, zero, zero, zero]));
        }
        let (entries, missing) = self.read_entries(table)?;
        // Unknown keys first: a misspelt entry is named, not the absence of the right one.
        table.finish()?;
        match missing {
            None => Ok(Definition::Metric(entries)),
            Some(i) => Err(table
                .complain(format!("`{}` is missing", self.entry_names(i, i)[0]))
                .with_hint("a metric needs its three diagonal entries, or `conformal` alone")),
        }
    }

    /// The entries of a symmetric matrix, and which diagonal one is missing.
    pub(super) fn read_entries(
        &mut self,
        table: &TomlTable<'_>,
    ) -> Reading<([NodeId; 6], Option<usize>)> {
        let mut entries = [self.graph.constant(0.0); 6];
        let mut missing = None;
        for (entry, (i, j)) in entries.iter_mut().zip(PAIRS) {
            match self.metric_entry(table, i, j)? {
                Some(item) => *entry = self.position_expression(&item.text()?)?,
                None if i == j => missing = missing.or(Some(i)),
                None => {}
            }
        }
        Ok((entries, missing))
    }

    /// The keys under which the entry (i, j) may stand: by the names of the coordinates, or x, y, z
    /// for first, second, third.
    pub(super) fn entry_names(&self, i: usize, j: usize) -> [String; 4] {
        let name = |a: &str, b: &str| format!("{a}{b}");
        let coordinates = self.written_in();
        let (a, b) = (&coordinates[i], &coordinates[j]);
        let (x, y) = (["x", "y", "z"][i], ["x", "y", "z"][j]);
        [name(a, b), name(b, a), name(x, y), name(y, x)]
    }

    fn metric_entry<'d>(
        &self,
        table: &TomlTable<'d>,
        i: usize,
        j: usize,
    ) -> Reading<Option<Item<'d>>> {
        let mut names = self.entry_names(i, j).to_vec();
        let own_xyz = ["x", "y", "z"]
            .iter()
            .any(|n| self.coordinates.iter().any(|c| c == n));
        if own_xyz || self.pullback.is_some() {
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
}
