//! The keys of the entries of a metric: two names of coordinates, written together.
//!
//! In: a table, and which entry is asked for. Out: what stands there. A key must mean one entry: of coordinates `r`, `tr` and
//! `rr`, `trr` in `[spacetime]` would be that of t and rr, and that of tr and r.

use super::{Loader, Reading};
use crate::{
    document::{Item, TomlTable},
    manifold::geometry::PAIRS,
};

/// An entry of a symmetric matrix, by the numbers of two coordinates; none is the time.
pub(super) type Entry = [Option<usize>; 2];

/// The names that stand for the first, the second and the third coordinate.
const PLACES: [&str; 3] = ["x", "y", "z"];

/// Lists the entries of a metric.
pub(super) fn of_space() -> Vec<Entry> {
    PAIRS.map(|(i, j)| [Some(i), Some(j)]).to_vec()
}

/// Lists the entries of the metric of a spacetime.
pub(super) fn with_time() -> Vec<Entry> {
    let mut entries = of_space();
    entries.push([None, None]);
    entries.extend((0..3).map(|k| [None, Some(k)]));
    entries
}

impl Loader<'_> {
    /// Reads an entry, which may stand under one key of several.
    pub(super) fn entry<'d>(
        &self,
        table: &TomlTable<'d>,
        entry: Entry,
    ) -> Reading<Option<Item<'d>>> {
        let keys = self.keys(entry);
        let mut found = keys.iter().filter_map(|key| table.get(key));
        let first = found.next();
        match found.next() {
            Some(second) => Err(second
                .complain("this entry of the symmetric metric is given twice")
                .with_hint(format!("give one of {} and {}", keys[0], keys[1]))),
            None => Ok(first),
        }
    }

    /// Refuses a key of the table that means several of these `entries`.
    pub(super) fn refuse_ambiguous(&self, table: &TomlTable<'_>, entries: &[Entry]) -> Reading<()> {
        let all: Vec<Vec<String>> = entries.iter().map(|entry| self.keys(*entry)).collect();
        let meanings = |key: &String| -> Vec<usize> {
            let means = |k: &usize| all[*k].contains(key);
            (0..entries.len()).filter(means).collect()
        };
        for key in all.iter().flatten() {
            let [a, b, ..] = meanings(key)[..] else {
                continue;
            };
            let Some(item) = table.get(key) else {
                continue;
            };
            let [first, second] = [a, b].map(|k| self.told(entries[k]));
            let plain = [a, b].map(|k| all[k].iter().find(|key| meanings(key).len() == 1));
            let hint = match plain {
                [Some(a), Some(b)] => format!("write `{a}` or `{b}`"),
                _ => "call the coordinates otherwise".into(),
            };
            return Err(item
                .complain(format!(
                    "`{key}` means the entry of {first} and that of {second}"
                ))
                .with_hint(hint));
        }
        Ok(())
    }

    /// The key of an entry of the diagonal.
    pub(super) fn diagonal_key(&self, k: usize) -> String {
        self.written_in()[k].repeat(2)
    }

    /// The keys under which an entry may stand: by the names of the coordinates, or by x, y, z for first, second, third.
    fn keys(&self, [i, j]: Entry) -> Vec<String> {
        let name = |k: Option<usize>| k.map_or("t", |k| &self.written_in()[k]);
        let place = |k: Option<usize>| k.map_or("t", |k| PLACES[k]);
        let (a, b, x, y) = (name(i), name(j), place(i), place(j));
        let mut keys = vec![format!("{a}{b}"), format!("{b}{a}")];
        if self.takes_places() {
            keys.extend([format!("{x}{y}"), format!("{y}{x}")]);
        }
        keys.dedup();
        keys
    }

    /// Tells whether x, y and z in keys mean the first, second and third coordinate, whatever these are called. Where
    /// coordinates are called x, y or z, keys mean the names, never the places.
    fn takes_places(&self) -> bool {
        let is_place = |name: &String| PLACES.contains(&name.as_str());
        !self.coordinates.iter().any(is_place) && self.pullback.is_none()
    }

    /// Names an entry in a complaint.
    fn told(&self, entry: Entry) -> String {
        let [a, b] = entry.map(|k| k.map_or("t", |k| &self.written_in()[k]));
        format!("`{a}` and `{b}`")
    }
}
