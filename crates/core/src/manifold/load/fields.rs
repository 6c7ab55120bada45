//! The `[field.NAME]` sections: functions given by samples.
//!
//! Samples come from the file that the section names, relative to the manifold's file, unless the caller has them:
//! those that a bundle brings stand before the disk.

use super::{Loader, Reading, regions::is_built_in};
use crate::{
    diagnostic::Diagnostic,
    document::{Item, Text, TomlTable},
    field::{
        Field, FieldPlan, Outside, SampleFault, Samples,
        read::{NumberType, SampleSource},
    },
    manifold::geometry::Definition,
};
use geofan_expr::{Binary, FieldId, NodeId, spline::DEGREES};
use std::{ops::Range, path::Path, sync::Arc};

/// The keys of the three axes.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Kind of the names of fields.
const A_FIELD: &str = "a field";

/// A field that has been read, with what complaints about it need.
pub(super) struct LoadedField {
    pub id: FieldId,
    pub field: Field,
    /// The place of its degree, or else of its name.
    pub degree: Range<usize>,
}

impl Loader<'_> {
    pub(super) fn read_fields(&mut self, item: Option<Item<'_>>) -> Reading<()> {
        let Some(item) = item else { return Ok(()) };
        let table = item
            .table()
            .map_err(|c| c.with_hint("write [field.NAME]"))?;
        for (name, item) in table.entries() {
            let table = item
                .table()
                .map_err(|c| c.with_hint("write [field.NAME]"))?;
            self.declare(&name, A_FIELD)?;
            self.read_field(&name, &table)?;
        }
        Ok(())
    }

    fn read_field(&mut self, name: &Text, table: &TomlTable<'_>) -> Reading<()> {
        // Unknown keys first.
        const KEYS: [&str; 10] = [
            "file", "array", "box", "degree", "outside", "smooth", "shape", "type", "order",
            "endian",
        ];
        for key in KEYS {
            table.get(key);
        }
        table.finish()?;
        let degree = self.read_degree(table)?;
        let files = read_files(table)?;
        let folder = Path::new(&self.source.name)
            .parent()
            .unwrap_or(Path::new(""));
        let source = read_source(table, files.iter().map(|file| folder.join(file)).collect())?;
        let fault = |fault: SampleFault| {
            let item = table.get(fault.key).or_else(|| table.get("file"));
            let complaint = match item {
                Some(item) => item.complain(fault.message),
                None => name.complain(fault.message),
            };
            match fault.hint {
                Some(hint) => complaint.with_hint(hint),
                None => complaint,
            }
        };
        let known = self.samples.iter().find(|(known, _)| *known == name.value);
        let samples = match known {
            Some((_, samples)) => samples.clone(),
            None => {
                let mut samples = source.read().map_err(fault)?;
                // What the section says counts, and is there wherever its text is.
                samples.limits = samples.limits.filter(|_| table.get("box").is_none());
                Arc::new(samples)
            }
        };
        let outside = self.read_outside(table)?;
        if outside.contains(&Outside::Exit) && is_built_in(&name.value) {
            return Err(name
                .complain(format!("`{}` is the name of a built-in end", name.value))
                .with_hint(
                    "paths leave where the samples end through an exit called like the field; give it another name",
                ));
        }
        let plan = FieldPlan {
            limits: self.read_box(table, name, &samples)?,
            degree,
            outside,
            smooth: read_smooth(table)?,
        };
        let field = Field::new(name.value.clone(), files, samples, plan).map_err(fault)?;
        let id = self.graph.add_field(field.spline.clone());
        let id = id.map_err(|e| name.complain(e.to_string()))?;
        self.scope.bind_field(&name.value, id);
        self.fixed.bind_field(&name.value, id);
        let degree = table
            .get("degree")
            .map_or(name.span.clone(), |item| item.span);
        self.fields.push(LoadedField { id, field, degree });
        Ok(())
    }

    fn read_degree(&self, table: &TomlTable<'_>) -> Reading<usize> {
        let Some(item) = table.get("degree") else {
            return Ok(5);
        };
        let number = item.number()?;
        let found = DEGREES.into_iter().find(|degree| *degree as f64 == number);
        found.ok_or_else(|| {
            item.complain(format!("a field has degree 1, 3 or 5, not {number}"))
                .with_hint("5 has four continuous derivatives, 3 two, 1 none")
        })
    }

    /// The keys of an axis: x, y, z, or the coordinates' own names where none of them is one of these.
    fn axis_keys(&self, k: usize) -> Vec<&str> {
        let own = self
            .coordinates
            .iter()
            .any(|name| AXES.contains(&name.as_str()));
        match own {
            true => vec![AXES[k]],
            false => vec![AXES[k], &self.coordinates[k]],
        }
    }

    fn on_axis<'d>(&self, table: &TomlTable<'d>, k: usize) -> Option<Item<'d>> {
        self.axis_keys(k).into_iter().find_map(|key| table.get(key))
    }

    fn read_outside(&self, table: &TomlTable<'_>) -> Reading<[Outside; 3]> {
        let one = |item: &Item<'_>| {
            let text = item.text()?;
            match text.value.as_str() {
                "clamp" => Ok(Outside::Clamp),
                "periodic" => Ok(Outside::Periodic),
                "exit" => Ok(Outside::Exit),
                other => Err(text
                    .complain(format!("outside its samples a field cannot be `{other}`"))
                    .with_hint("write \"clamp\", \"periodic\" or \"exit\"")),
            }
        };
        let Some(item) = table.get("outside") else {
            return Ok([Outside::Clamp; 3]);
        };
        let Some(axes) = item.as_table() else {
            return Ok([one(&item)?; 3]);
        };
        let mut outside = [Outside::Clamp; 3];
        for (k, slot) in outside.iter_mut().enumerate() {
            if let Some(item) = self.on_axis(&axes, k) {
                *slot = one(&item)?;
            }
        }
        axes.finish()?;
        Ok(outside)
    }

    /// Places of the first and last samples: those of the file's own, if no box is given.
    fn read_box(
        &self,
        table: &TomlTable<'_>,
        name: &Text,
        samples: &Samples,
    ) -> Reading<[[f64; 2]; 3]> {
        let Some(item) = table.get("box") else {
            let missing = || {
                name.complain(format!("field `{}` needs `box`", name.value))
                    .with_hint("box = { x = [first, last], y = …, z = … }: places of the first and last samples")
            };
            let own = samples.limits.ok_or_else(missing)?;
            let fits = |k: usize| match own[k] {
                _ if samples.shape[k] == 1 => true,
                [low, high] => low < high && low.is_finite() && high.is_finite(),
            };
            return match (0..3).all(fits) {
                true => Ok(own),
                false => Err(name.complain("the places of the samples in the file do not rise"))
                    .map_err(|c| c.with_hint("give `box`")),
            };
        };
        let axes = item.table()?;
        let mut limits = [[0.0, 1.0]; 3];
        for (k, slot) in limits.iter_mut().enumerate() {
            match self.on_axis(&axes, k) {
                Some(item) if samples.shape[k] == 1 => {
                    let complaint = item.complain("an axis with one sample has no places");
                    return Err(complaint.with_hint("take it away: nothing depends on it"));
                }
                Some(item) => *slot = item.interval()?,
                None if samples.shape[k] == 1 => {}
                None => {
                    let complaint = axes.complain(format!("the box has no `{}`", AXES[k]));
                    return Err(complaint.with_hint("places are given for x, y and z (or by the coordinates' own names, where none of these is x, y or z); only an axis with one sample has none"));
                }
            }
        }
        axes.finish()?;
        Ok(limits)
    }

    /// Refuses fields that are differentiated more often than they can be: `definition` is differentiated twice
    /// for neighbouring paths, an embedding three times; `others` as often as is said.
    pub(super) fn check_smoothness(
        &self,
        definition: &Definition,
        medium: &[NodeId],
    ) -> Reading<()> {
        let (what, further) = match definition {
            Definition::Embedding(_) => ("an embedding", 3),
            Definition::Metric(_) => ("a metric", 2),
        };
        self.refuse_rough(definition.nodes(), what, further)?;
        self.refuse_rough(medium, "a wind or a drift", 2)
    }

    /// Refuses fields below `roots` whose derivatives, after `further` ones, would not be continuous.
    pub(super) fn refuse_rough(&self, roots: &[NodeId], what: &str, further: usize) -> Reading<()> {
        for (id, order) in self.graph.fields_below(roots) {
            let needed = usize::from(order) + further;
            let Some(loaded) = self.fields.iter().find(|loaded| loaded.id == id) else {
                continue;
            };
            let degree = loaded.field.plan.degree;
            if needed < degree {
                continue;
            }
            let least = DEGREES.into_iter().find(|degree| needed < *degree);
            let name = &loaded.field.name;
            let message = format!(
                "field `{name}` of degree {degree} is not smooth enough for {what}: derivatives up to order {needed} must be continuous, its are up to {}",
                degree - 1
            );
            let hint = match least {
                Some(least) => format!("take degree {least}, or leave `degree` out"),
                None => "use it in a formula that is differentiated less often".into(),
            };
            let complaint = Diagnostic::new(self.source, loaded.degree.clone(), message);
            return Err(complaint.with_hint(hint));
        }
        Ok(())
    }

    /// The ways out through the limits of fields that `roots` depend on: the field's name, and what is positive
    /// beyond.
    pub(super) fn field_exits(&mut self, roots: &[NodeId]) -> Vec<(String, NodeId)> {
        let mut exits: Vec<(String, NodeId)> = Vec::new();
        for (id, at) in self.graph.calls_below(roots) {
            let Some(field) = self.fields.iter().find(|loaded| loaded.id == id) else {
                continue;
            };
            let (name, plan) = (field.field.name.clone(), field.field.plan);
            let shape = field.field.samples.shape;
            for k in (0..3).filter(|k| plan.outside[*k] == Outside::Exit && shape[*k] > 1) {
                let [low, high] = plan.limits[k].map(|x| self.graph.constant(x));
                for beyond in [self.graph.sub(low, at[k]), self.graph.sub(at[k], high)] {
                    match exits.iter_mut().find(|(known, _)| *known == name) {
                        Some((_, node)) => *node = self.graph.binary(Binary::Max, *node, beyond),
                        None => exits.push((name.clone(), beyond)),
                    }
                }
            }
        }
        exits
    }
}

/// The files that samples are in.
fn read_files(table: &TomlTable<'_>) -> Reading<Vec<String>> {
    let item = table.require("file")?;
    match item.as_list() {
        None => Ok(vec![item.text()?.value]),
        Some(list) if list.is_empty() => Err(item.complain("there are no slices")),
        Some(list) => list.iter().map(|item| Ok(item.text()?.value)).collect(),
    }
}

/// What is said about the files.
fn read_source(table: &TomlTable<'_>, files: Vec<std::path::PathBuf>) -> Reading<SampleSource> {
    let word = |key: &str| table.get(key).map(|item| item.text()).transpose();
    let one_of = |key: &str, words: [&str; 2]| match word(key)? {
        None => Ok(None),
        Some(text) if text.value == words[0] => Ok(Some(false)),
        Some(text) if text.value == words[1] => Ok(Some(true)),
        Some(text) => Err(text
            .complain(format!("`{key}` cannot be `{}`", text.value))
            .with_hint(format!("write \"{}\" or \"{}\"", words[0], words[1]))),
    };
    let number = word("type")?.map(|text| {
        NumberType::named(&text.value).ok_or_else(|| {
            text.complain(format!("`{}` is no type of numbers", text.value))
                .with_hint(format!("the types are {}", NumberType::names().join(", ")))
        })
    });
    Ok(SampleSource {
        files,
        array: word("array")?.map(|text| text.value),
        shape: table
            .get("shape")
            .map(|item| read_shape(&item))
            .transpose()?,
        number: number.transpose()?,
        x_fastest: one_of("order", ["z fastest", "x fastest"])?,
        big_endian: one_of("endian", ["little", "big"])?,
    })
}

fn read_shape(item: &Item<'_>) -> Reading<[usize; 3]> {
    let numbers = item.numbers::<3>()?;
    let count = |x: f64| (x >= 1.0 && x.fract() == 0.0 && x < 1e9).then_some(x as usize);
    match numbers.map(count) {
        [Some(x), Some(y), Some(z)] => Ok([x, y, z]),
        _ => Err(item.complain("a shape has three whole numbers from 1 on: samples along x, y, z")),
    }
}

fn read_smooth(table: &TomlTable<'_>) -> Reading<f64> {
    let Some(item) = table.get("smooth") else {
        return Ok(0.0);
    };
    match item.number()? {
        sigma if sigma >= 0.0 => Ok(sigma),
        _ => Err(item.complain("a standard deviation cannot be negative")),
    }
}
