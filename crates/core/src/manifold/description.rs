//! What a manifold file says, in words for people, and in what two of them differ.
//!
//! In: a [`Manifold`]. Out: lines without units or decoration, for `geofan info` and notebooks.
//!
//! In: two manifolds. Out: in what they differ, in words: in their meaning, not in how they are written. Comments,
//! names of lets and coordinates, claims of symmetry, the camera region and the usual length of paths change no
//! geodesic and no exit: they are not part of the meaning.

use super::{Carried, EventKind, Form, GluedFace, Manifold};
use geofan_expr::{Digest, Tape};

impl Form {
    /// Names what the file gives.
    pub fn name(self) -> &'static str {
        match self {
            Self::Embedding => "embedding",
            Self::Metric => "metric",
            Self::Normal | Self::Static => "spacetime",
        }
    }
}

impl Manifold {
    /// Lists what light meets besides the metric.
    pub fn medium_names(&self) -> Vec<&'static str> {
        let all = [
            (self.blows(), "a wind"),
            (self.has_drift(), "a drift of time"),
            (self.has_lapse(), "a lapse of clocks"),
        ];
        all.into_iter().filter(|m| m.0).map(|m| m.1).collect()
    }

    /// Lists the coordinates that nothing depends on.
    pub fn translations(&self) -> Vec<&str> {
        let names = self.coordinates.iter().map(String::as_str);
        let claims = names.zip(self.symmetry.translation);
        claims.filter(|c| c.1).map(|c| c.0).collect()
    }

    /// Describes coordinate limits and conditions.
    pub fn domain_lines(&self) -> Vec<String> {
        let domain = &self.domain;
        let mut lines = Vec::new();
        for (k, name) in self.coordinates.iter().enumerate() {
            if let Some([low, high]) = domain.limits[k] {
                let glued = if domain.periodic[k] { ", glued" } else { "" };
                lines.push(format!("{name} in [{low}, {high}]{glued}"));
            }
        }
        let conditions = domain.kinds.iter().filter(|k| **k == EventKind::Inside);
        match conditions.count() {
            0 => {}
            1 => lines.push("1 condition".into()),
            n => lines.push(format!("{n} conditions")),
        }
        lines
    }

    /// Describes the gluing; `None` where nothing is glued.
    pub fn gluing_line(&self) -> Option<String> {
        let faces = self.gluing()?.faces();
        let count = |of: fn(&GluedFace) -> bool| faces.iter().filter(|face| of(face)).count();
        let parts = [
            (count(|face| !face.is_mirror() && !face.reverses()), "glued"),
            (
                count(|face| !face.is_mirror() && face.reverses()),
                "glued with a reversal",
            ),
            (count(GluedFace::is_mirror), "mirrors"),
            (count(GluedFace::is_portal), "with an opening"),
        ];
        let parts = parts.iter().filter(|part| part.0 > 0);
        let parts: Vec<_> = parts.map(|(n, what)| format!("{n} {what}")).collect();
        Some(format!("{} faces: {}", faces.len(), parts.join(", ")))
    }

    /// Describes the sampled fields.
    pub fn field_lines(&self) -> Vec<String> {
        self.fields.iter().map(|field| field.line()).collect()
    }

    /// Describes the claims of symmetry.
    pub fn symmetry_line(&self) -> String {
        let mut claims = Vec::new();
        if self.symmetry.rotation {
            claims.push("rotations about the origin".to_string());
        }
        if let Some(axis) = self.symmetry.axis {
            let name = &self.coordinates[axis];
            claims.push(format!("rotations about the {name} axis"));
        }
        let translations = self.translations();
        if !translations.is_empty() {
            claims.push(format!("translations along {}", translations.join(", ")));
        }
        if self.symmetry.group.is_some() {
            claims.push("left translations of a group".into());
        }
        match claims.is_empty() {
            true => "none claimed".into(),
            false => format!(
                "{} (verified around cameras, by a bake along paths)",
                claims.join("; ")
            ),
        }
    }

    /// Describes the camera region.
    pub fn cameras_line(&self) -> String {
        match &self.cameras {
            None => "no region given".into(),
            Some(_) if self.symmetry.group.is_some() => "any point, by the group".into(),
            Some(region) if region.dimension() == 0 => {
                let u = region.at(&[]);
                format!("one point: {}, {}, {}", u.x, u.y, u.z)
            }
            Some(region) => {
                let intervals = region.names.iter().zip(&region.intervals);
                let interval = |(name, [low, high]): (&String, &[f64; 2])| {
                    format!("{name} in [{low}, {high}]")
                };
                intervals.map(interval).collect::<Vec<_>>().join(", ")
            }
        }
    }
}

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
            parts.push((name, hash(&bytes)));
        }
        let mut conditions = 0;
        for (kind, digest) in self.domain.kinds.iter().zip(&self.domain.meanings) {
            match kind {
                EventKind::Exit(exit) => {
                    let name = &self.exits[*exit].name;
                    parts.push((format!("`when` of exit {} `{name}`", exit + 1), *digest));
                }
                EventKind::Inside => {
                    conditions += 1;
                    parts.push((format!("condition {conditions} of `inside`"), *digest));
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
    tape.digests(hash)
}

// Inlined at each of the many places that ask for a hash, it would be a hundredth of a page's viewer.
#[inline(never)]
fn hash(bytes: &[u8]) -> Digest {
    *blake3::hash(bytes).as_bytes()
}

/// Hashes all outputs of a tape together.
fn together(tape: &Tape) -> Digest {
    hash(&digests(tape).concat())
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
