//! The numerical checks that a gluing must pass before it is used.
//!
//! In: the faces of a manifold file as read. Out: the [`Gluing`] with what only numbers tell (sizes, partners, the
//! form of its maps), or a complaint about a face and a place: a map that is no isometry, a face that comes to lie
//! on no other, edges round which the maps do not close (Poincaré's condition), a point that a map fixes.

use super::{
    DeckTransformation, GUARD, Gluing, Spheres,
    domain_points::{is_regular, points_inside},
};
use crate::{
    diagnostic::Diagnostic,
    error::Result,
    geodesic::crossing,
    manifold::{
        Manifold,
        probe::{WORST_DISCREPANCY, is_positive, point},
    },
    random::Stream,
};
use glam::{DMat3, DVec3};

/// Lines from points of the domain on which faces are looked for, and places on each: faces are met where a line
/// leaves the domain.
const LINES: usize = 600;
const PLACES: usize = 80;

/// Places between two points among which the one is looked for where the metric is largest.
const SIGHTS: u32 = 24;

/// Points beyond several faces that are brought back in every order, and how far out they lie at most.
const EDGE_TESTS: usize = 400;
pub(super) const FARTHEST_OUT: f64 = 1.8;

/// Halvings by which a place is looked for where the metric is infinite, and how much larger it is taken to be there.
const POLE_STEPS: usize = 40;
const POLE: f64 = 1e6;

/// How far apart two images of one point may be, as a share of the domain's size, and their differentials.
pub(super) const WORST_IMAGE: f64 = 1e-7;

/// Completes and checks the gluing of `manifold`.
pub(super) fn checked(manifold: &Manifold, gluing: &Gluing) -> Result<Gluing> {
    let mut gluing = gluing.clone();
    let points = points_inside(manifold, &mut gluing)?;
    gluing.measure(&points);
    let openings = checks(manifold, &gluing, &points).portal_points();
    gluing.measure_openings(&openings);
    gluing.recognise(manifold, &points);
    let checks = checks(manifold, &gluing, &points);
    let borders = checks.face_points();
    checks.isometries(&[&borders[..], &openings].concat())?;
    let mut partners = checks.partners(&borders)?;
    checks.find_missed_partners(&mut partners);
    checks.edges(&borders)?;
    checks.fixed_points()?;
    checks.edge_cones(&borders)?;
    for (face, partner) in gluing.faces.iter_mut().zip(partners) {
        face.partner = partner;
    }
    gluing.outline = outline(&borders);
    Ok(gluing)
}

/// Chooses those of the points of faces that are farthest out along the chart's axes and between them, and takes the
/// middle of those of each face.
fn outline(borders: &[(usize, DVec3)]) -> Vec<DVec3> {
    let steps = [-1.0, 0.0, 1.0];
    let directions = (0..27).map(|code| [code % 3, code / 3 % 3, code / 9].map(|k| steps[k]));
    let farthest = |d: DVec3| {
        let places = borders.iter().map(|(_, u)| *u);
        places.max_by(|a, b| a.dot(d).total_cmp(&b.dot(d)))
    };
    let mut found: Vec<DVec3> = Vec::new();
    for u in directions.filter_map(|d| farthest(DVec3::from_array(d))) {
        if !found.contains(&u) {
            found.push(u);
        }
    }
    let faces = borders.iter().map(|(k, _)| k + 1).max().unwrap_or(0);
    found.extend((0..faces).filter_map(|k| {
        let own = borders.iter().filter(|(face, _)| *face == k);
        let (sum, count) = own.fold((DVec3::ZERO, 0.0), |(sum, n), (_, u)| (sum + *u, n + 1.0));
        (count > 0.0).then(|| sum / count)
    }));
    found
}

fn checks<'a>(manifold: &'a Manifold, gluing: &'a Gluing, points: &'a [DVec3]) -> GluingChecks<'a> {
    GluingChecks {
        manifold,
        gluing,
        points,
    }
}

/// Complains about face `k`.
pub(super) fn complain(
    manifold: &Manifold,
    gluing: &Gluing,
    k: usize,
    message: String,
) -> Diagnostic {
    let span = gluing.faces[k].span.clone();
    Diagnostic::new(
        &manifold.source,
        span,
        format!("{}: {message}", Gluing::name(k)),
    )
}

impl Gluing {
    /// Takes sizes from points of the domain.
    fn measure(&mut self, points: &[DVec3]) {
        let middle = points.iter().sum::<DVec3>() / points.len() as f64;
        let far = points.iter().map(|u| (*u - middle).length());
        self.size = far.fold(f64::MIN_POSITIVE, f64::max);
        for k in 0..self.faces.len() {
            let mut slopes: Vec<f64> = points
                .iter()
                .map(|u| self.gradient(k, *u).length())
                .filter(|slope| *slope > 0.0 && slope.is_finite())
                .collect();
            slopes.sort_by(f64::total_cmp);
            self.faces[k].slope = slopes.get(slopes.len() / 2).copied().unwrap_or(1.0);
        }
        let depth = |u: &DVec3| {
            let values = self.values.at(&u.to_array());
            let faces = self.faces.iter().zip(values);
            let bounding = faces.filter(|(face, _)| !face.is_portal());
            bounding.fold(f64::INFINITY, |least, (face, value)| {
                least.min(value / face.slope)
            })
        };
        let deepest = points.iter().max_by(|a, b| depth(a).total_cmp(&depth(b)));
        self.inside = deepest.copied().unwrap_or(middle);
    }

    /// Recognises the form of faces and maps, and which turn right into left.
    fn recognise(&mut self, manifold: &Manifold, points: &[DVec3]) {
        self.spheres = self.find_spheres(manifold, points);
        let maps = self.faces.iter().filter_map(|face| face.map.as_ref());
        let tapes: Vec<_> = maps.map(|map| map.tape.clone()).collect();
        let recognised = DeckTransformation::recognised(&tapes, points);
        let mut recognised = recognised.into_iter().flatten();
        for map in self.faces.iter_mut().filter_map(|face| face.map.as_mut()) {
            if let Some(deck) = recognised.next() {
                map.deck = deck;
            }
            let (_, d) = super::at_tape(&map.tape, points[0]);
            map.deck = map.deck.clone().reversing(d.determinant() < 0.0);
        }
    }

    /// Finds the planes and spheres that the faces are: by their values, or else by these for the metric's scale, the sixth
    /// root of its determinant. Linear functions of the light cone's model of a conformally flat space are that scale
    /// times linear functions of (u, |u|², 1).
    fn find_spheres(&self, manifold: &Manifold, points: &[DVec3]) -> Option<Spheres> {
        let values = |u: DVec3| self.values.at(&u.to_array());
        let own = Spheres::of(&|u| Some(values(u)), self.faces.len(), points);
        own.or_else(|| {
            let scale = |u: DVec3| metric_scale(manifold, u);
            let unit = scale(self.inside);
            let for_scale = |u: DVec3| {
                let share = is_regular(manifold, u).then(|| unit / scale(u))?;
                Some(values(u).into_iter().map(|value| value * share).collect())
            };
            Spheres::of(&for_scale, self.faces.len(), points)
        })
    }
}

/// Computes the sixth root of the metric's determinant: the scale of a conformally flat one.
fn metric_scale(manifold: &Manifold, u: DVec3) -> f64 {
    let (g, _) = manifold.metric_and_frame(u);
    g.determinant().powf(1.0 / 6.0)
}

/// What the checks look at.
pub(super) struct GluingChecks<'a> {
    pub(super) manifold: &'a Manifold,
    pub(super) gluing: &'a Gluing,
    pub(super) points: &'a [DVec3],
}

impl GluingChecks<'_> {
    pub(super) fn complain(&self, k: usize, message: String) -> Diagnostic {
        complain(self.manifold, self.gluing, k, message)
    }

    /// Checks that every map is an isometry, of one handedness, inside and at `places` of its face.
    fn isometries(&self, places: &[(usize, DVec3)]) -> Result<()> {
        for (k, face) in self.gluing.faces.iter().enumerate() {
            self.has_values(k)?;
            let own = places.iter().filter(|(j, _)| *j == k).map(|(_, u)| *u);
            for u in self.points.iter().copied().chain(own) {
                let Some((image, d)) = face.carry(u) else {
                    continue;
                };
                if !is_regular_or_outside(self.manifold, image) {
                    continue;
                }
                let clocks = self.manifold.lapse_discrepancy(image, u);
                let found = self.manifold.discrepancy_by((image, d), u).max(clocks);
                if found > WORST_DISCREPANCY {
                    let message = format!(
                        "its map is no isometry: at {} and its image {} lengths, velocities or clocks differ by {found:.2e}",
                        point(self.manifold, u),
                        point(self.manifold, image),
                    );
                    let complaint = self.complain(k, message);
                    return Err(complaint
                        .with_hint(
                            "the metric (and wind, drift and lapse) must be the same at a point and at its image",
                        )
                        .into());
                }
            }
        }
        Ok(())
    }

    /// Checks that the map of face `k` has a value somewhere in the domain.
    fn has_values(&self, k: usize) -> Result<()> {
        let image = |u: &DVec3| self.gluing.faces[k].carry(*u).map(|(image, _)| image);
        if self
            .points
            .iter()
            .any(|u| image(u).is_none_or(DVec3::is_finite))
        {
            return Ok(());
        }
        let here = point(self.manifold, self.points[0]);
        let complaint = self.complain(k, format!("its map has no value at {here}"));
        Err(complaint
            .with_hint(
                "a root or a logarithm of a negative number, or a division by zero, has none",
            )
            .into())
    }

    /// Finds points of the bounding faces, each with the face, on lines of the chart from points inside.
    fn face_points(&self) -> Vec<(usize, DVec3)> {
        let mut random = Stream::new(&[0x0067_6c75_6564]);
        let mut found = Vec::new();
        for i in 0..LINES {
            let from = match i % 2 {
                0 => self.gluing.inside,
                _ => self.points[i / 2 % self.points.len()],
            };
            let d = random.direction() * (4.0 * self.gluing.size / PLACES as f64);
            found.extend(self.leaves(from, d));
        }
        found
    }

    /// Finds where the line from `from` along `d` leaves the domain through a face, if it does within [`PLACES`] steps:
    /// not where the space ends before, as at an ideal boundary that the domain reaches.
    fn leaves(&self, from: DVec3, d: DVec3) -> Option<(usize, DVec3)> {
        let faces = &self.gluing.faces;
        let value = |k: usize, t: f64| self.gluing.values.at(&(from + d * t).to_array())[k];
        for i in 1..=PLACES {
            let t = i as f64;
            let values = self.gluing.values.at(&(from + d * t).to_array());
            if values.iter().any(|x| x.is_nan()) {
                return None;
            }
            let left = (0..faces.len()).filter(|k| !faces[*k].is_portal() && values[*k] < 0.0);
            let places = left.map(|k| (crossing(t - 1.0, t, |t| -value(k, t)), k));
            let place = places.min_by(|a, b| a.0.total_cmp(&b.0));
            let u = from + d * place.map_or(t, |(t, _)| t);
            if place.is_some() || !is_regular(self.manifold, u) {
                let (_, face) = place.filter(|_| is_regular(self.manifold, u))?;
                return Some((face, u));
            }
        }
        None
    }

    /// Finds the partners of faces so small that no line has met them: those whose maps undo theirs.
    fn find_missed_partners(&self, partners: &mut [Option<usize>]) {
        let faces = &self.gluing.faces;
        let undone = |k: usize, j: usize, u: DVec3| {
            let (image, d) = faces[k].carry(u)?;
            let (back, e) = faces[j].carry(image)?;
            let same_place = (back - u).length() <= WORST_IMAGE * self.gluing.size;
            Some(same_place && is_identity(e * d))
        };
        for (k, partner) in partners.iter_mut().enumerate() {
            if partner.is_none() && !faces[k].is_portal() {
                let undoes =
                    |j: &usize| self.points.iter().all(|u| undone(k, *j, *u) == Some(true));
                *partner = (0..faces.len()).find(undoes);
            }
        }
    }

    /// Finds the partner of every face, on which each of its points must come to lie, and whose map leads back. It
    /// may come to lie beyond other faces, where the domain is no Dirichlet domain.
    fn partners(&self, borders: &[(usize, DVec3)]) -> Result<Vec<Option<usize>>> {
        let faces = &self.gluing.faces;
        let mut partners: Vec<Option<usize>> = vec![None; faces.len()];
        for &(k, u) in borders {
            let Some((image, d)) = faces[k].carry(u) else {
                continue;
            };
            let values = self.gluing.values.at(&image.to_array());
            let bounding = |j: &usize| !faces[*j].is_portal();
            let depth = |j: usize| values[j] / (faces[j].slope * self.gluing.size);
            let here = |u: DVec3| point(self.manifold, u);
            let back = |j: &usize| {
                let back = faces[*j].carry(image);
                let near = |(v, e): (DVec3, DMat3)| {
                    (v - u).length() <= WORST_IMAGE * self.gluing.size && is_identity(e * d)
                };
                back.is_some_and(near)
            };
            let on = (0..faces.len())
                .filter(bounding)
                .filter(|j| depth(*j).abs() <= 10.0 * WORST_IMAGE);
            let on: Vec<usize> = on.collect();
            self.meets_mirrors(k, u, image)?;
            match on.iter().copied().find(back) {
                Some(j) => partners[k] = partners[k].or(Some(j)),
                None if on.is_empty() => {
                    let message = format!(
                        "its map leads to no face: {} goes to {}",
                        here(u),
                        here(image)
                    );
                    return Err(self.unpaired(k, message));
                }
                None => {
                    let name = Gluing::name(on[0]);
                    let back = match faces[on[0]].carry(image) {
                        Some((back, _)) if (back - u).length() > WORST_IMAGE * self.gluing.size => {
                            format!(", whose map takes it to {}", here(back))
                        }
                        Some(_) => ", whose map turns what is there".into(),
                        None => ", a mirror".into(),
                    };
                    let (from, to) = (here(u), here(image));
                    let message =
                        format!("no map leads back: {from} goes to {to}, which is on {name}{back}");
                    return Err(self.unpaired(k, message));
                }
            }
        }
        Ok(partners)
    }

    /// Checks that the image by face `k` of a point `u` of it is behind no mirror: where a mirror ends at that face, another
    /// must go on.
    fn meets_mirrors(&self, k: usize, u: DVec3, image: DVec3) -> Result<()> {
        let Some(j) = self.gluing.behind_mirror(image) else {
            return Ok(());
        };
        let (from, to) = (point(self.manifold, u), point(self.manifold, image));
        let mirror = Gluing::name(j);
        let message = format!("its map leads behind {mirror}, a mirror: {from} goes to {to}");
        let complaint = self.complain(k, message);
        Err(complaint
            .with_hint("where a mirror ends at a glued face, a mirror must go on at its partner")
            .into())
    }

    fn unpaired(&self, k: usize, message: String) -> crate::error::Error {
        let map = self.gluing.faces[k].map.as_ref();
        let of_group = map.is_some_and(|map| map.is_of_group);
        let hint = match of_group {
            true => {
                "these are the faces of Dirichlet's domain: the generators must be exact, and their group discrete"
            }
            false => {
                "faces come in pairs: each map must bring its face onto another face (or itself), whose map brings it back"
            }
        };
        self.complain(k, message).with_hint(hint).into()
    }

    /// Checks that from points beyond two or more faces every order of maps ends in the same point.
    fn edges(&self, borders: &[(usize, DVec3)]) -> Result<()> {
        let mut random = Stream::new(&[0x6564_6765]);
        let middle = self.gluing.inside;
        if borders.is_empty() {
            return Ok(());
        }
        for i in 0..EDGE_TESTS {
            let (_, border) = borders[i % borders.len()];
            let out = random.between(1.001, FARTHEST_OUT);
            let u = middle + (border - middle) * out;
            let beyond = self.beyond(u);
            if beyond.len() < 2 || !is_regular(self.manifold, u) {
                continue;
            }
            let mut first: Option<(DVec3, DMat3, usize)> = None;
            for k in beyond {
                let Some(end) = self.brought_in(k, u) else {
                    continue;
                };
                let Some((v, d, j)) = first else {
                    first = (!self.is_border(end.0)).then_some((end.0, end.1, k));
                    continue;
                };
                let off = (end.0 - v).length() / self.gluing.size;
                let turned = !is_identity_to(d.inverse() * end.1, 1e-5);
                let differs = (off > 10.0 * WORST_IMAGE || turned) && !self.is_border(end.0);
                if differs && !self.ends_between(border, u) {
                    let message = format!(
                        "its edge with {} does not close: {} comes to {} by way of the one and to {} by way of the other",
                        Gluing::name(j),
                        point(self.manifold, u),
                        point(self.manifold, end.0),
                        point(self.manifold, v),
                    );
                    let complaint = self.complain(k, message);
                    return Err(complaint
                        .with_hint("round every edge the maps must compose to the identity (Poincare's condition)")
                        .into());
                }
            }
        }
        Ok(())
    }

    /// Returns whether space ends infinitely far away between two points of the chart, as at the ideal boundary of
    /// hyperbolic space, behind which formulas may hold again: whether the metric grows without end there.
    fn ends_between(&self, a: DVec3, b: DVec3) -> bool {
        let scale = |t: f64| match metric_scale(self.manifold, a.lerp(b, t)) {
            scale if scale.is_nan() => f64::INFINITY,
            scale => scale,
        };
        let largest = |places: Vec<f64>| {
            let scales = places.into_iter().map(|t| (scale(t), t));
            scales
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .unwrap_or_default()
        };
        let mut step = 1.0 / f64::from(SIGHTS);
        let mut found = largest((1..SIGHTS).map(|i| f64::from(i) * step).collect());
        for _ in 0..POLE_STEPS {
            step *= 0.5;
            found = largest(vec![found.1 - step, found.1, found.1 + step]);
        }
        found.0 > POLE * (scale(0.0) + scale(1.0))
    }

    /// Lists the faces with maps that `u` is beyond.
    pub(super) fn beyond(&self, u: DVec3) -> Vec<usize> {
        let values = self.gluing.values.at(&u.to_array());
        let faces = self.gluing.faces.iter().enumerate();
        let beyond = faces.filter(|(k, face)| {
            !face.is_portal() && !face.is_mirror() && values[*k] < -self.gluing.guard(*k)
        });
        beyond.map(|(k, _)| k).collect()
    }

    /// Brings `u` into the domain, through face `k` first. Returns its image and the differential.
    fn brought_in(&self, k: usize, u: DVec3) -> Option<(DVec3, DMat3)> {
        let (mut image, mut d) = self.gluing.faces[k].carry(u)?;
        let (_, word) = self.gluing.locate(image)?;
        for k in word {
            let (next, e) = self.gluing.faces[k].carry(image)?;
            (image, d) = (next, e * d);
        }
        Some((image, d))
    }

    /// Returns whether `u` is so near a face that it may as well be on its other side.
    fn is_border(&self, u: DVec3) -> bool {
        let values = self.gluing.values.at(&u.to_array());
        let faces = self.gluing.faces.iter().zip(values);
        faces
            .filter(|(face, _)| !face.is_portal())
            .any(|(face, value)| value.abs() <= 100.0 * GUARD * face.slope * self.gluing.size)
    }
}

/// Returns whether the metric at an image can be compared: it may lie outside limits, where the formulas still hold.
fn is_regular_or_outside(manifold: &Manifold, u: DVec3) -> bool {
    let (g, s) = manifold.metric_and_frame(u);
    u.is_finite() && is_positive(g, s)
}

fn is_identity(m: DMat3) -> bool {
    is_identity_to(m, WORST_IMAGE)
}

/// Returns whether a matrix is the identity up to `allowed`.
pub(super) fn is_identity_to(m: DMat3, allowed: f64) -> bool {
    let off = (m - DMat3::IDENTITY).to_cols_array();
    off.iter().all(|x| x.abs() <= allowed)
}
