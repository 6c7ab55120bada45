//! How the space is given: `embedding`, `metric` or `spacetime`, with the keys `wind`, `shift`, `lapse`, `drift` and
//! `[spacetime]`.
//!
//! In: expressions in the coordinates in which the space is written. Out: metric and medium in terms of
//! the chart.

use super::{
    Loader, Reading,
    entry_keys::{of_space, with_time},
    three_texts,
};
use crate::{
    document::{Item, TomlTable},
    manifold::{
        Form,
        geometry::{Definition, PAIRS},
        wind::{self, Entries, Medium},
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
                .complain("none of `embedding`, `metric` and `spacetime` is given")
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
        self.refuse_ambiguous(table, &of_space())?;
        let (entries, missing) = self.read_entries(table)?;
        // Unknown keys first: a misspelt entry is named, not the absence of the right one.
        table.finish()?;
        match missing {
            None => Ok(Definition::Metric(entries)),
            Some(i) => Err(table
                .complain(format!("`{}` is missing", self.diagonal_key(i)))
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
            match self.entry(table, [Some(i), Some(j)])? {
                Some(item) => *entry = self.position_expression(&item.text()?)?,
                None if i == j => missing = missing.or(Some(i)),
                None => {}
            }
        }
        Ok((entries, missing))
    }
}

/// The keys that stand beside `metric` and `embedding`.
const KEYS: [&str; 4] = ["wind", "shift", "lapse", "drift"];

impl Loader<'_> {
    /// Reads what stands beside a metric or an embedding.
    pub(super) fn read_medium<'d>(
        &mut self,
        root: &TomlTable<'d>,
        form: Form,
        mut definition: Definition,
        place: Item<'d>,
    ) -> Reading<Given<'d>> {
        let [wind, shift, lapse, drift] = KEYS.map(|key| root.get(key));
        let lapse = lapse.map(|item| self.position_expression(&item.text()?));
        let mut medium = Medium {
            wind: wind.as_ref().map(|w| self.vector(w)).transpose()?,
            drift: drift.as_ref().map(|b| self.vector(b)).transpose()?,
            lapse: lapse.transpose()?,
        };
        if let Some(item) = shift {
            let space = slices(&definition, &item, &medium)?;
            let shift = self.vector(&item)?;
            let one = self.graph.constant(1.0);
            let lapse = medium.lapse.unwrap_or(one);
            let square = self.graph.mul(lapse, lapse);
            let (metric, wind) = wind::sliced(&mut self.graph, space, shift, square);
            definition = Definition::Metric(metric);
            medium.wind = Some(wind);
        }
        Ok(self.given(form, definition, medium, place))
    }

    /// The `[spacetime]` section.
    pub(super) fn read_spacetime<'d>(
        &mut self,
        root: &TomlTable<'d>,
        place: Item<'d>,
    ) -> Reading<Given<'d>> {
        if let Some(item) = KEYS.iter().find_map(|key| root.get(key)) {
            return Err(item
                .complain("[spacetime] has wind, shift, lapse and drift of its own")
                .with_hint("take this away, or give `metric` in place of [spacetime]"));
        }
        let table = place.table()?;
        let form = read_observers(&table)?;
        let entries = self.read_spacetime_entries(&table)?;
        let (metric, medium, condition) = match form {
            Form::Static => {
                let (metric, medium, square) = wind::fixed(&mut self.graph, &entries);
                (metric, medium, Some(square))
            }
            _ => {
                let (metric, medium) = wind::normal(&mut self.graph, &entries);
                (metric, medium, None)
            }
        };
        let mut given = self.given(form, Definition::Metric(metric), medium, place);
        given.conditions.extend(condition);
        Ok(given)
    }

    fn read_spacetime_entries(&mut self, table: &TomlTable<'_>) -> Reading<Entries> {
        let names = self.written_in().clone();
        if names.iter().any(|name| name == "t") {
            return Err(table
                .complain("`t` is the time in [spacetime], and a coordinate is called so")
                .with_hint("call the coordinate otherwise"));
        }
        let entry = |loader: &mut Self, item: Item<'_>| loader.position_expression(&item.text()?);
        self.refuse_ambiguous(table, &with_time())?;
        let time = table.get("tt");
        let mut mixed = [self.graph.constant(0.0); 3];
        for (k, slot) in mixed.iter_mut().enumerate() {
            if let Some(item) = self.entry(table, [None, Some(k)])? {
                *slot = entry(self, item)?;
            }
        }
        let (space, missing) = self.read_entries(table)?;
        table.finish()?;
        let missing = match (&time, missing) {
            (None, _) => Some("tt".to_string()),
            (_, missing) => missing.map(|i| self.diagonal_key(i)),
        };
        match (time, missing) {
            (Some(time), None) => Ok(Entries {
                tt: entry(self, time)?,
                t: mixed,
                space,
            }),
            (_, missing) => Err(table
                .complain(format!("`{}` is missing", missing.unwrap_or_default()))
                .with_hint("a spacetime needs its four diagonal entries, others are 0 if absent")),
        }
    }

    /// Three expressions of the point.
    fn vector(&mut self, item: &Item<'_>) -> Reading<[NodeId; 3]> {
        let [x, y, z] = three_texts(item, "components")?;
        Ok([
            self.position_expression(&x)?,
            self.position_expression(&y)?,
            self.position_expression(&z)?,
        ])
    }

    /// Definition and medium in terms of the chart.
    fn given<'d>(
        &mut self,
        form: Form,
        mut definition: Definition,
        mut medium: Medium,
        place: Item<'d>,
    ) -> Given<'d> {
        if let Some((_, pullback)) = &self.pullback {
            let graph = &mut self.graph;
            if let Definition::Metric(g) = &mut definition {
                *g = pullback.metric(graph, *g);
            }
            medium.wind = medium.wind.map(|w| pullback.vector(graph, w));
            medium.drift = medium.drift.map(|b| pullback.covector(graph, b));
        }
        Given {
            form,
            definition,
            medium,
            conditions: Vec::new(),
            place,
        }
    }
}

/// The metric of the slices to which a `shift` belongs.
fn slices(definition: &Definition, shift: &Item<'_>, medium: &Medium) -> Reading<[NodeId; 6]> {
    if medium.wind.is_some() {
        let complaint = shift.complain("both `wind` and `shift` are given");
        return Err(complaint.with_hint(
            "keep one of them: with `shift` the metric is divided by lapse^2, and the wind is -shift",
        ));
    }
    match definition {
        Definition::Metric(space) => Ok(*space),
        Definition::Embedding(_) => Err(shift
            .complain("`shift` belongs to a metric, and this is an embedding")
            .with_hint("give the embedding of what light sees, and `wind`")),
    }
}

/// Whose directions `[spacetime]` speaks of.
fn read_observers(table: &TomlTable<'_>) -> Reading<Form> {
    let Some(item) = table.get("observers") else {
        return Ok(Form::Normal);
    };
    let text = item.text()?;
    match text.value.as_str() {
        "normal" => Ok(Form::Normal),
        "static" => Ok(Form::Static),
        other => Err(text
            .complain(format!("observers cannot be `{other}`"))
            .with_hint(
                "\"normal\": at rest on the slices t = const; \"static\": in the coordinates",
            )),
    }
}
