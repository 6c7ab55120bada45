//! How the manifold is given: `embedding` or `metric`.

use super::{Loader, Reading};
use crate::{
    document::{Item, Table},
    manifold::geometry::{Definition, PAIRS},
};

/// The least and the most components of an embedding.
const AMBIENT: std::ops::RangeInclusive<usize> = 3..=16;

impl Loader<'_> {
    /// The definition, and the item that it was read from.
    pub(super) fn read_definition<'d>(
        &mut self,
        root: &Table<'d>,
    ) -> Reading<(Definition, Item<'d>)> {
        match (root.get("embedding"), root.get("metric")) {
            (Some(item), None) => Ok((self.read_embedding(&item)?, item)),
            (None, Some(item)) => {
                let table = item.table().map_err(|complaint| {
                    complaint
                        .with_hint("write metric = { conformal = \"…\" }, or xx, yy, zz and so on")
                })?;
                Ok((self.read_metric(&table)?, item))
            }
            (Some(_), Some(item)) => Err(item
                .complain("both `embedding` and `metric` are given")
                .with_hint("keep exactly one of them")),
            (None, None) => Err(root
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

    fn read_metric(&mut self, table: &Table<'_>) -> Reading<Definition> {
        let zero = self.graph.constant(0.0);
        if let Some(item) = table.get("conformal") {
            table.finish().map_err(|complaint| {
                complaint.with_hint("`conformal` is the whole metric: give it, or the entries")
            })?;
            let n = self.position_expression(&item.text()?)?;
            let n2 = self.graph.mul(n, n);
            return Ok(Definition::Metric([n2, n2, n2, zero, zero, zero]));
        }
        let mut entries = [zero; 6];
        let mut missing = None;
        for (entry, (i, j)) in entries.iter_mut().zip(PAIRS) {
            match self.metric_entry(table, i, j)? {
                Some(item) => *entry = self.position_expression(&item.text()?)?,
                None if i == j => missing = missing.or(Some(i)),
                None => {}
            }
        }
        // Unknown keys first: a misspelt entry is named, not the absence of the right one.
        table.finish()?;
        match missing {
            None => Ok(Definition::Metric(entries)),
            Some(i) => Err(table
                .complain(format!("`{}` is missing", self.entry_names(i, i)[0]))
                .with_hint("a metric needs its three diagonal entries, or `conformal` alone")),
        }
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
}
