//! The meaning of a manifold file: what it says, not how it is written.
//!
//! In: two manifolds. Out: in what they differ, in words. Comments, names of lets and coordinates, claims
//! of symmetry, the camera region and the usual length of paths change no geodesic and no exit: they are
//! not part of the meaning.

use super::{Carried, EventKind, Manifold};
use geofan_expr::{Digest, Tape};

/// Names of the metric's components in the order of its tape.
const COMPONENTS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];

impl Manifold {
    /// Says in what the spaces that cover this manifold and `other` differ; nothing if one table serves both.
    pub fn differences_of_covers(&self, other: &Self) -> Vec<String> {
        self.cover().differences(&other.cover())
    }

    /// Says in what this manifold and `other` differ, one line each; nothing if they mean the same.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let (own, others) = (self.meaning(), other.meaning());
        let mut found = Vec::new();
        for (name, digest) in &own {
            match others.iter().find(|(other, _)| other == name) {
                Some((_, other)) if other == digest => {}
                Some(_) => found.push(format!("{name} differs")),
                None => found.push(format!("{name} is in one of them only")),
            }
        }
        let missing = others
            .iter()
            .filter(|(name, _)| own.iter().all(|o| o.0 != *name));
        found.extend(missing.map(|(name, _)| format!("{name} is in one of them only")));
        // Parameters that nothing depends on make no difference; others explain it.
        if !found.is_empty() {
            let changed = self.parameters.iter().filter_map(|(name, value)| {
                let (_, other) = other.parameters.iter().find(|(other, _)| other == name)?;
                (other != value).then(|| format!("parameter `{name}` is {value} and {other}"))
            });
            found.splice(0..0, changed.collect::<Vec<_>>());
        }
        found
    }

    /// Hashes the whole meaning.
    pub fn meaning_digest(&self) -> Digest {
        let mut hasher = blake3::Hasher::new();
        for (name, digest) in self.meaning() {
            hasher.update(name.as_bytes());
            hasher.update(&digest);
        }
        *hasher.finalize().as_bytes()
    }

    /// Lists the parts of the meaning: a name for people and a hash each.
    fn meaning(&self) -> Vec<(String, Digest)> {
        let mut parts = Vec::new();
        // The metric, component by component, and the equation of paths in it.
        let metric = digests(self.metric_tape());
        for ([i, j], digest) in COMPONENTS.into_iter().zip(metric) {
            let [i, j] = [i, j].map(|k| ["x", "y", "z"][k]);
            parts.push((format!("component {i}{j} of the metric"), digest));
        }
        let all = Carried {
            frame: true,
            deviation: true,
        };
        parts.push(("the equation of geodesics".into(), together(self.flow(all))));
        if let Some(jacobian) = &self.tapes.jacobian {
            parts.push(("the embedding".into(), together(jacobian)));
        }
        // Where paths end.
        for (k, limits) in self.domain.limits.iter().enumerate() {
            let bits = limits
                .iter()
                .flatten()
                .flat_map(|x| x.to_bits().to_le_bytes());
            let bytes: Vec<u8> = bits.chain([u8::from(self.domain.periodic[k])]).collect();
            let name = format!("the limits of coordinate {}", k + 1);
            parts.push((name, *blake3::hash(&bytes).as_bytes()));
        }
        let mut conditions = 0;
        for (kind, digest) in self.domain.kinds.iter().zip(digests(self.domain.events())) {
            match kind {
                EventKind::Exit(exit) => {
                    let name = &self.exits[*exit].name;
                    parts.push((format!("`when` of exit {} `{name}`", exit + 1), digest));
                }
                EventKind::Inside => {
                    conditions += 1;
                    parts.push((format!("condition {conditions} of `inside`"), digest));
                }
                // Its coordinate's limits.
                EventKind::Limit => {}
            }
        }
        // Where they go on.
        if let Some(gluing) = self.gluing() {
            parts.push(("the gluing of faces".into(), gluing.digest()));
        }
        // Where skies are looked up.
        for exit in &self.exits {
            if let Some(direction) = &exit.direction {
                let name = format!("`direction` of exit `{}`", exit.name);
                parts.push((name, together(direction)));
            }
        }
        parts
    }
}

/// Hashes each output of a tape.
pub(super) fn digests(tape: &Tape) -> Vec<Digest> {
    tape.digests(|bytes| *blake3::hash(bytes).as_bytes())
}

/// Hashes all outputs of a tape together.
fn together(tape: &Tape) -> Digest {
    *blake3::hash(&digests(tape).concat()).as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::SourceText;

    const TEXT: &str = r#"
name = "test"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + a*exp(-r2)" }
[parameters]
a = 0.5
unused = 1.0
[let]
r2 = "x^2 + y^2 + z^2"
[domain]
x = [-4, 4]
inside = ["9 - y"]
[[exit]]
name = "far"
when = "r2 - 16"
direction = ["vx + x", "vy", "vz"]
[cameras]
length = 5.0
"#;

    fn manifold(text: &str, settings: &[(&str, f64)]) -> Manifold {
        let settings: Vec<_> = settings.iter().map(|(n, v)| (n.to_string(), *v)).collect();
        Manifold::from_source(SourceText::new("test", text), &settings).unwrap()
    }

    #[test]
    fn comments_names_lets_regions_and_lengths_do_not_change_the_meaning() {
        let original = manifold(TEXT, &[]);
        let changes = [
            ("[let]\n", "# a comment\n[let]\nother = \"sin(y)*x\"\n"),
            ("r2", "radius_squared"),
            ("length = 5.0", "length = 7.0"),
            ("name = \"test\"", "name = \"other\""),
            ("a*exp(-r2)", "exp( -r2 ) * a"),
            ("unused = 1.0", "unused = 2.0"),
        ];
        for (from, to) in &changes {
            let changed = manifold(&TEXT.replace(from, to), &[]);
            assert_eq!(original.differences(&changed), [""; 0], "{to}");
            assert_eq!(original.meaning_digest(), changed.meaning_digest());
        }
    }

    #[test]
    fn differences_are_told_by_what_differs() {
        let original = manifold(TEXT, &[]);
        let told = |text: &str, settings: &[(&str, f64)]| {
            original.differences(&manifold(text, settings)).join("; ")
        };
        let found = told(TEXT, &[("a", 0.25)]);
        assert!(
            found.starts_with("parameter `a` is 0.5 and 0.25; component xx of the metric"),
            "{found}"
        );
        for (from, to, word) in [
            ("r2 - 16", "r2 - 15", "`when` of exit 1 `far` differs"),
            ("vx + x", "vx + y", "`direction` of exit `far` differs"),
            ("9 - y", "8 - y", "condition 1 of `inside` differs"),
            ("[-4, 4]", "[-4, 5]", "the limits of coordinate 1 differs"),
            (
                "x = [-4, 4]",
                "x = [-4, 4]\nperiodic = [\"x\"]",
                "the limits of coordinate 1",
            ),
            ("\"far\"", "\"near\"", "`near` is in one of them only"),
            ("y^2", "y^2 + x*y/9", "component yy of the metric differs"),
        ] {
            let found = told(&TEXT.replace(from, to), &[]);
            assert!(found.contains(word), "{to}: {found}");
        }
    }
}
