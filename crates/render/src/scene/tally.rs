//! What of an OBJ text is left out or mended, counted: a line for each kind, however often it occurs.

use std::collections::BTreeMap;

/// Counts of what the user should know although the mesh is usable.
#[derive(Default)]
pub(super) struct Tally {
    /// Faces of fewer than three corners.
    pub slivers: usize,
    /// Vertices that a painted mesh has no colour for.
    pub unpainted: usize,
    /// Number and first line of each kind of statement that is left out.
    left_out: BTreeMap<&'static str, (usize, usize)>,
    /// Faces that cross themselves: their number, and the first.
    crossing: (usize, usize),
    /// Vertices with words that mean nothing: their number, and the first.
    odd_vertices: (usize, usize),
}

/// Statements with a meaning that is lost, and what they are.
const MEANT: &[(&str, &str)] = &[
    ("p", "points"),
    ("l", "lines"),
    ("curv", FREE_FORM),
    ("curv2", FREE_FORM),
    ("surf", FREE_FORM),
    ("call", "other files (`call`)"),
    ("csh", "commands (`csh`)"),
];

const FREE_FORM: &str = "curves and free-form surfaces";

impl Tally {
    /// Notes a statement that is not read; most of those mean nothing for a picture.
    pub(super) fn leave_out(&mut self, key: &str, line: usize) {
        if let Some((_, what)) = MEANT.iter().find(|(known, _)| *known == key) {
            count(self.left_out.entry(what).or_default(), line);
        }
    }

    /// Notes a face that crosses itself.
    pub(super) fn cross(&mut self, line: usize) {
        count(&mut self.crossing, line);
    }

    /// Notes a vertex with words that mean nothing.
    pub(super) fn odd_vertex(&mut self, line: usize) {
        count(&mut self.odd_vertices, line);
    }

    /// Tells whether there are surfaces that could be exported as faces.
    pub(super) fn has_free_form(&self) -> bool {
        self.left_out.contains_key(FREE_FORM)
    }

    /// Returns what to say about the text that the user calls `name`.
    pub(super) fn warnings(&self, name: &str) -> Vec<String> {
        let mut warnings = Vec::new();
        for (what, (count, line)) in &self.left_out {
            warnings.push(format!(
                "{name}:{line}: {count} {what} left out; faces alone are drawn"
            ));
        }
        let mut say = |(count, line): (usize, usize), text: &str| {
            if count > 0 {
                warnings.push(format!("{name}:{line}: {count} {text}"));
            }
        };
        say(
            self.crossing,
            "faces cross themselves, from this line on; their inside is a guess: divide them",
        );
        say(
            self.odd_vertices,
            "vertices have words that mean nothing, from this line on; their positions are used",
        );
        if self.slivers > 0 {
            let count = self.slivers;
            warnings.push(format!(
                "{name}: {count} faces of fewer than three corners left out"
            ));
        }
        if self.unpainted > 0 {
            let count = self.unpainted;
            warnings.push(format!(
                "{name}: {count} vertices have no colour in its #MRGB lines"
            ));
        }
        warnings
    }
}

/// Counts one more of a kind, in line `line`.
fn count((number, first): &mut (usize, usize), line: usize) {
    if *number == 0 {
        *first = line;
    }
    *number += 1;
}
