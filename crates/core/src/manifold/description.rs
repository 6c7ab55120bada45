//! A manifold in words, for people.
//!
//! In: a [`Manifold`]. Out: lines without units or decoration, for `geofan info` and notebooks.

use super::{EventKind, Form, GluedFace, Manifold};

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
            false => format!("{} (verified)", claims.join("; ")),
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
