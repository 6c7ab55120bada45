//! A first pass over an OBJ text that finds what `tobj` accepts silently or reports without a line.
//!
//! In: the text. Out: an error at the first line that makes the mesh meaningless (a number that
//! is not finite, an index that points nowhere), or counts for warnings.

use geofan_core::error::{Error, Result};
use std::collections::BTreeSet;

/// What a pass over the text found.
#[derive(Default)]
pub(super) struct Survey<'a> {
    /// Vertices, texture coordinates and normals so far.
    counts: [usize; 3],
    /// The largest index used of each, and its line.
    largest: [(usize, usize); 3],
    /// Faces of fewer than three corners.
    slivers: usize,
    /// Materials asked for by `usemtl`.
    materials: BTreeSet<&'a str>,
}

const KINDS: [&str; 3] = ["vertices", "texture coordinates", "normals"];

impl<'a> Survey<'a> {
    /// Surveys the text that the user calls `name`.
    pub(super) fn of(name: &str, text: &'a str) -> Result<Self> {
        let mut survey = Self::default();
        for (i, line) in text.lines().enumerate() {
            let checked = survey.line(line, i + 1);
            checked.map_err(|message| Error::input(format!("{name}:{}", i + 1), message))?;
        }
        for (kind, (index, line)) in survey.largest.into_iter().enumerate() {
            if index > survey.counts[kind] {
                let (count, what) = (survey.counts[kind], KINDS[kind]);
                let message = format!("index {index}, but the file has {count} {what}");
                return Err(Error::input(format!("{name}:{line}"), message));
            }
        }
        Ok(survey)
    }

    fn line(&mut self, line: &'a str, number: usize) -> Result<(), String> {
        let line = line.trim_start();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match key {
            "v" => {
                finite(rest, 7)?;
                self.counts[0] += 1;
            }
            "vt" => self.counts[1] += 1,
            "vn" => self.counts[2] += 1,
            "f" => self.face(rest, number)?,
            "usemtl" if !rest.trim().is_empty() => {
                self.materials.insert(rest.trim());
            }
            _ => {}
        }
        Ok(())
    }

    /// Checks that every index of a face can point somewhere.
    fn face(&mut self, corners: &str, line: usize) -> Result<(), String> {
        let mut count = 0;
        for corner in corners.split_whitespace() {
            for (kind, word) in corner.split('/').enumerate() {
                self.index(kind, word, line)?;
            }
            count += 1;
        }
        match count {
            0 => return Err(String::from("a face without corners")),
            1 | 2 => self.slivers += 1,
            _ => {}
        }
        Ok(())
    }

    fn index(&mut self, kind: usize, word: &str, line: usize) -> Result<(), String> {
        let known = *self
            .counts
            .get(kind)
            .ok_or("a corner has more than three indices")?;
        if word.is_empty() {
            return if kind == 0 {
                Err(String::from("a corner has no vertex"))
            } else {
                Ok(())
            };
        }
        let index: i64 = word
            .parse()
            .map_err(|_| format!("`{word}` is not an index"))?;
        let back = usize::try_from(index.unsigned_abs()).unwrap_or(usize::MAX);
        match index {
            0 => Err(String::from("index 0, but indices start at 1")),
            1.. => {
                // Later lines may still define it, so the comparison waits for the end.
                if back > self.largest[kind].0 {
                    self.largest[kind] = (back, line);
                }
                Ok(())
            }
            _ if back > known => {
                let what = KINDS[kind];
                Err(format!(
                    "index {index}, but only {known} {what} come before"
                ))
            }
            _ => Ok(()),
        }
    }

    /// What the user should know although the mesh is usable.
    pub(super) fn warnings(&self, name: &str, defined: &[tobj::Material]) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.slivers > 0 {
            let count = self.slivers;
            warnings.push(format!(
                "{name}: {count} faces of fewer than three corners left out"
            ));
        }
        let missing = |wanted: &&&str| !defined.iter().any(|m| m.name == **wanted);
        for material in self.materials.iter().filter(missing) {
            warnings.push(format!(
                "{name}: material `{material}` is not defined, grey is used"
            ));
        }
        warnings
    }
}

/// Checks that the words are three to `most` finite numbers.
fn finite(words: &str, most: usize) -> Result<(), String> {
    let mut count = 0;
    for word in words.split_whitespace().take(most) {
        match word.parse::<f32>() {
            Ok(x) if x.is_finite() => count += 1,
            // A comment at the end of the line, or vertex colours in some other notation.
            Err(_) if count >= 3 => break,
            _ => return Err(format!("`{word}` is not a finite number")),
        }
    }
    if count < 3 {
        return Err(String::from("a vertex needs three numbers"));
    }
    Ok(())
}
