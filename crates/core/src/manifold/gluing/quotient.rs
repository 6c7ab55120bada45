//! Dirichlet's domain of a discrete group of matrices.
//!
//! In: generators in a linear model of the space, and a centre. Out: the faces of the domain of all points that are
//! nearer to the centre than to any of its images, each with its matrix.
//!
//! Nearness is measured by an invariant form of the model where there is one: a diagonal form of signs that the
//! generators keep and that is constant on the space, as for spheres and hyperboloids; and in products of these with
//! lines, by that of one factor and the distance along the other. Faces are then linear in the
//! model. Otherwise it is measured in the chart by the metric at the centre, which is the distance in flat
//! space; the domain then is one of representatives all the same, each the nearest of its orbit.

use super::{Key, LinearModel, deck::product, invariant_form::InvariantForm};
use crate::{manifold::metric_of, random::fibonacci_direction};
use glam::{DMat3, DVec3};
use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashMap},
};

/// The most elements of the group that are made, in the order of how far they move the centre.
const MOST_ELEMENTS: usize = 3000;

/// The most generators: a dozen glue a dodecahedron.
const MOST_GENERATORS: usize = 64;

/// By how much a generator may change the metric, as a share of it: faces are checked to more digits.
const OFF: f64 = 1e-6;

/// Places about the centre at which generators and forms are looked at, in units of its smallest displacement if that is below 1.
const PLACES: [DVec3; 4] = [
    DVec3::ZERO,
    DVec3::new(0.02, -0.01, 0.03),
    DVec3::new(-0.03, 0.02, 0.01),
    DVec3::new(0.01, 0.04, -0.02),
];

/// The nearest elements, among which faces are looked for.
const CANDIDATES: usize = 600;

/// Directions from the centre in which faces are looked for.
const DIRECTIONS: usize = 1500;

/// Relative difference up to which matrices are the same.
pub(super) const SAME: f64 = 1e-7;

/// Distance in the chart up to which a domain without end is followed, as a multiple of the smallest
/// displacement of the centre.
const REACH: f64 = 50.0;

/// Doublings of a step within which lines are looked at that no face known so far ends.
const DOUBLINGS: u32 = 10;

/// Halvings of a step by which places on lines are found: to ten digits.
const HALVINGS: usize = 32;

/// A face of the domain.
pub(in crate::manifold) struct QuotientFace {
    /// The element that brings back what leaves here, by rows.
    pub matrix: Vec<f64>,
    /// The face as a linear function in the model, where there is an invariant form.
    pub row: Option<Vec<f64>>,
    /// The metric by which it is measured otherwise.
    pub metric: [f64; 6],
}

/// How near points are to the centre.
struct Nearness<'m> {
    model: &'m LinearModel,
    centre: DVec3,
    /// The centre in the model.
    start: Vec<f64>,
    /// The metric (xx, yy, zz, xy, xz, yz) at a point of the chart.
    metric: &'m dyn Fn(DVec3) -> [f64; 6],
    /// That at the centre.
    at_centre: DMat3,
    /// What the group keeps, if that is known.
    form: Option<InvariantForm>,
    /// Units of the model's coordinates, powers of two in which they are about 1 where generators take the centre.
    units: Vec<f64>,
}

impl Nearness<'_> {
    /// Returns a number that grows with the distance of the point `x` of the model from the centre.
    fn of(&self, x: &[f64]) -> f64 {
        match &self.form {
            Some(form) => form.of(x),
            None => {
                let off = self.dropped(x) - self.centre;
                off.dot(self.at_centre * off)
            }
        }
    }

    /// Tells whether the point `x` of the model is one of the space: a chart's line may leave it beyond an ideal boundary.
    fn is_in_space(&self, x: &[f64]) -> bool {
        let on_sheet = |form: &InvariantForm| form.is_on_sheet(x);
        x.iter().all(|x| x.is_finite()) && self.form.as_ref().is_none_or(on_sheet)
    }

    /// Measures by how much `matrix` changes lengths near the centre, as a share of them: a group of maps that do has no
    /// end, and its domain, if any, would be refused. Points that the chart does not have are passed over.
    fn stretch(&self, matrix: &[f64], places: &[DVec3]) -> f64 {
        let stretches = places.iter().map(|u| self.stretch_at(matrix, *u));
        stretches.filter(|x| x.is_finite()).fold(0.0, f64::max)
    }

    /// Measures this at the point `u` of the chart.
    fn stretch_at(&self, matrix: &[f64], u: DVec3) -> f64 {
        let n = self.model.dimension;
        let lift = self.model.lift.at(&u.to_array());
        let drop = self.model.drop.at(&times(matrix, &lift[..n]));
        let column = |k: usize| {
            let along = times(matrix, &lift[(k + 1) * n..(k + 2) * n]);
            let terms = along.iter().zip(drop[3..].chunks_exact(3));
            terms.fold(DVec3::ZERO, |sum, (x, row)| {
                sum + DVec3::from_slice(row) * *x
            })
        };
        let map = DMat3::from_cols(column(0), column(1), column(2));
        let image = DVec3::from_slice(&drop[..3]);
        let [here, there] = [u, image].map(|u| metric_of(&(self.metric)(u)));
        largest(map.transpose() * there * map - here) / largest(here)
    }

    fn dropped(&self, x: &[f64]) -> DVec3 {
        DVec3::from_slice(&self.model.drop.at(x)[..3])
    }

    fn lifted(&self, u: DVec3) -> Vec<f64> {
        lifted(self.model, u)
    }

    /// Returns how far in the chart `matrix` takes the centre.
    fn displacement(&self, matrix: &[f64]) -> f64 {
        (self.dropped(&times(matrix, &self.start)) - self.centre).length()
    }

    /// Writes a matrix in these units, so that its entries can be compared with one another.
    fn in_units(&self, matrix: &[f64]) -> Vec<f64> {
        let n = self.units.len();
        let unit = |at: usize| self.units[at % n] / self.units[at / n];
        let entries = matrix.iter().enumerate();
        entries.map(|(at, x)| x * unit(at)).collect()
    }
}

/// Returns the point of the model at a point of the chart.
fn lifted(model: &LinearModel, u: DVec3) -> Vec<f64> {
    let mut lifted = model.lift.at(&u.to_array());
    lifted.truncate(model.dimension);
    lifted
}

/// Returns units of the model's coordinates: those of `start` and of the places to which the `steps` take it.
fn units(start: &[f64], steps: &[Vec<f64>]) -> Vec<f64> {
    let mut largest: Vec<f64> = start.iter().map(|x| x.abs()).collect();
    for step in steps {
        for (most, x) in largest.iter_mut().zip(times(step, start)) {
            *most = most.max(x.abs());
        }
    }
    let unit = |most: f64| match most > 0.0 && most.is_finite() {
        true => most.log2().round().exp2(),
        false => 1.0,
    };
    largest.into_iter().map(unit).collect()
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn times(matrix: &[f64], x: &[f64]) -> Vec<f64> {
    matrix
        .chunks_exact(x.len())
        .map(|row| dot(row, x))
        .collect()
}

/// Returns the size of the largest entry; not a number if one is none.
fn largest(matrix: DMat3) -> f64 {
    match matrix.is_nan() {
        true => f64::NAN,
        false => matrix.abs().to_cols_array().into_iter().fold(0.0, f64::max),
    }
}

/// Finds the faces of the domain about `centre` of the group of `generators` (by rows) where the metric is `metric`.
///
/// # Errors
/// The reason why there is none.
pub(in crate::manifold) fn dirichlet(
    model: &LinearModel,
    generators: &[Vec<f64>],
    centre: DVec3,
    metric: &dyn Fn(DVec3) -> [f64; 6],
) -> Result<Vec<QuotientFace>, String> {
    let n = model.dimension;
    if generators.len() > MOST_GENERATORS {
        let count = generators.len();
        return Err(format!(
            "{count} generators are too many; {MOST_GENERATORS} are the most"
        ));
    }
    let mut steps = generators.to_vec();
    for (k, generator) in generators.iter().enumerate() {
        let inverse = inverse(generator, n)
            .ok_or_else(|| format!("the matrix of generator {} is singular", k + 1))?;
        steps.push(inverse);
    }
    let start = lifted(model, centre);
    let mut nearness = Nearness {
        model,
        centre,
        metric,
        at_centre: metric_of(&metric(centre)),
        form: None,
        units: units(&start, &steps),
        start,
    };
    let moves = steps.iter().map(|step| nearness.displacement(step));
    let unit = moves.filter(|far| *far > 0.0).fold(1.0, f64::min);
    let places = PLACES.map(|shift| centre + shift * unit);
    for (k, generator) in generators.iter().enumerate() {
        let stretch = nearness.stretch(generator, &places);
        if stretch > OFF {
            return Err(format!(
                "generator {} is no isometry: it changes lengths near the centre by {stretch:.1e} of them",
                k + 1
            ));
        }
    }
    let form =
        |places: [DVec3; 4]| InvariantForm::find(&places.map(|u| nearness.lifted(u)), &steps);
    let usual = PLACES.map(|shift| centre + shift);
    nearness.form = form(usual).or_else(|| form(places));
    let elements = elements(&nearness, &steps)?;
    if elements.is_empty() {
        return Err("the generators leave every point where it is".into());
    }
    let faces = faces(&nearness, &elements);
    match steps.iter().all(|step| leads_back(&nearness, &faces, step)) {
        true => Ok(faces),
        false => Err(NO_DOMAIN.into()),
    }
}

/// The reason why a group that nothing invariant is known of has no domain here.
const NO_DOMAIN: &str = "by distances in this chart points have no nearest image to `centre`, or several: is their group discrete? \
    If it is, take a model in which it keeps a form, or write faces as [[glue]]";

/// Places about the centre that every element must bring back, as shares of the way to the nearest face.
const SHARES: [f64; 3] = [0.15, 0.4, 0.7];

/// Directions of these places, and the most maps that bring one back.
const WAYS: usize = 12;
const MOST_MAPS: usize = 4000;

/// Tells whether the faces bring the images under `step` of places in the domain back to these: it holds no two points of
/// one orbit.
fn leads_back(nearness: &Nearness<'_>, faces: &[QuotientFace], step: &[f64]) -> bool {
    let near = |x: &[f64]| nearness.of(x);
    let ways = faces
        .iter()
        .map(|face| nearness.displacement(&face.matrix) * 0.5);
    let way = ways
        .filter(|way| way.is_finite())
        .fold(f64::INFINITY, f64::min);
    if !way.is_finite() {
        return true;
    }
    let home = |mut x: Vec<f64>| -> Option<Vec<f64>> {
        for _ in 0..MOST_MAPS {
            let nearer = faces.iter().map(|face| times(&face.matrix, &x));
            let nearest = nearer.min_by(|a, b| near(a).total_cmp(&near(b)))?;
            if !(near(&nearest) < near(&x)) {
                return Some(x);
            }
            x = nearest;
        }
        None
    };
    let places = SHARES
        .iter()
        .flat_map(|share| (0..WAYS).map(move |i| (*share, i)));
    let mut places =
        places.map(|(share, i)| nearness.centre + fibonacci_direction(i, WAYS) * (share * way));
    places.all(|u| {
        let x = nearness.lifted(u);
        let is_inside = faces
            .iter()
            .all(|face| near(&times(&face.matrix, &x)) > near(&x));
        let comes_back =
            |x: Vec<f64>| (nearness.dropped(&x) - u).length() <= 1e-6 * (way + u.length());
        !is_inside || home(times(step, &x)).is_some_and(comes_back)
    })
}

/// Makes products of `steps`, those first that move the centre least, without the identity.
fn elements(nearness: &Nearness<'_>, steps: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, String> {
    let n = nearness.model.dimension;
    let identity: Vec<f64> = (0..n * n)
        .map(|k| f64::from(u8::from(k / n == k % n)))
        .collect();
    let rest = nearness.of(&nearness.start);
    // A place that the chart lacks, such as the antipode, is another one; where every step leads there, the unit is the chart's.
    let moves = |element: &[f64]| nearness.displacement(element);
    let far = steps.iter().map(|step| moves(step));
    let far = far.filter(|far| far.is_finite()).fold(0.0, f64::max);
    let unit = if far > 0.0 { far } else { 1.0 };
    let mut known = Known::default();
    known.add(rest, identity.clone());
    let mut all = vec![identity];
    let mut queue = BinaryHeap::from([Reverse((Key(rest), 0))]);
    let mut found = Vec::new();
    while let Some(Reverse((Key(value), index))) = queue.pop() {
        if index > 0 {
            if moves(&all[index]) <= 1e-6 * unit.max(nearness.centre.length()) {
                return Err("an element of the group does not move the centre".into());
            }
            found.push((value, index));
        }
        if found.len() >= MOST_ELEMENTS {
            break;
        }
        for step in steps {
            let next = product(step, &all[index], n);
            let value = nearness.of(&times(&next, &nearness.start));
            if value.is_finite() && known.add(value, nearness.in_units(&next)) {
                queue.push(Reverse((Key(value), all.len())));
                all.push(next);
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Ok(found.into_iter().map(|(_, k)| all[k].clone()).collect())
}

/// Matrices known already, by how far they move the centre.
#[derive(Default)]
struct Known(HashMap<i64, Vec<Vec<f64>>>);

impl Known {
    /// Adds a matrix in the model's units; `false` if it is known.
    fn add(&mut self, value: f64, matrix: Vec<f64>) -> bool {
        let scale = matrix.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
        let bin = (value.abs().ln_1p() * 1e4).round() as i64;
        let same = |other: &Vec<f64>| {
            other
                .iter()
                .zip(&matrix)
                .all(|(a, b)| (a - b).abs() <= SAME * scale)
        };
        let near = (bin - 1..=bin + 1).filter_map(|bin| self.0.get(&bin));
        if near.flatten().any(same) {
            return false;
        }
        self.0.entry(bin).or_default().push(matrix);
        true
    }
}

/// Computes the inverse of a matrix (by rows) by elimination; `None` for a singular one.
fn inverse(matrix: &[f64], n: usize) -> Option<Vec<f64>> {
    let mut rows: Vec<Vec<f64>> = (0..n)
        .map(|i| {
            let unit = (0..n).map(|j| f64::from(u8::from(i == j)));
            matrix[i * n..(i + 1) * n]
                .iter()
                .copied()
                .chain(unit)
                .collect()
        })
        .collect();
    for k in 0..n {
        let pivot = (k..n).max_by(|a, b| rows[*a][k].abs().total_cmp(&rows[*b][k].abs()))?;
        rows.swap(k, pivot);
        let scale = rows[k][k];
        if !(scale.abs() > 1e-12) {
            return None;
        }
        rows[k].iter_mut().for_each(|x| *x /= scale);
        let pivot = rows[k].clone();
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            if i != k {
                row.iter_mut()
                    .zip(&pivot)
                    .for_each(|(x, p)| *x -= factor * p);
            }
        }
    }
    Some(rows.into_iter().flat_map(|row| row[n..].to_vec()).collect())
}

/// Finds the elements that bound the domain. With each comes its inverse.
fn faces(nearness: &Nearness<'_>, elements: &[Vec<f64>]) -> Vec<QuotientFace> {
    let candidates = FaceCandidates::new(nearness, &elements[..elements.len().min(CANDIDATES)]);
    let mut chosen = candidates.with_inverses(candidates.seen_from_centre());
    chosen.sort_unstable();
    let face = |k: usize| QuotientFace {
        matrix: candidates.elements[k].clone(),
        row: candidates.rows[k].clone(),
        metric: (nearness.metric)(nearness.centre),
    };
    chosen.into_iter().map(face).collect()
}

/// The elements among which those that bound the domain are found, by their numbers.
struct FaceCandidates<'a> {
    nearness: &'a Nearness<'a>,
    elements: &'a [Vec<f64>],
    /// The face of each as a linear function in the model, where there is an invariant form.
    rows: Vec<Option<Vec<f64>>>,
    /// How near the centre's nearest image is to it.
    scale: f64,
}

impl<'a> FaceCandidates<'a> {
    fn new(nearness: &'a Nearness<'a>, elements: &'a [Vec<f64>]) -> Self {
        let row = |matrix: &Vec<f64>| nearness.form.as_ref().map(|form| form.growth(matrix));
        let nearest = elements.first();
        Self {
            nearness,
            elements,
            rows: elements.iter().map(row).collect(),
            scale: nearest.map_or(0.0, |matrix| {
                nearness.of(&times(matrix, &nearness.start)).abs()
            }),
        }
    }

    /// Returns the number with which values at `x` are compared.
    fn own_value(&self, x: &[f64]) -> f64 {
        match self.nearness.form {
            Some(_) => 0.0,
            None => self.nearness.of(x),
        }
    }

    /// Returns a number that is negative where element `k` brings `x`, whose own value is `own`, nearer to the centre.
    fn value(&self, k: usize, x: &[f64], own: f64) -> f64 {
        match &self.rows[k] {
            Some(row) => dot(row, x),
            None => self.nearness.of(&times(&self.elements[k], x)) - own,
        }
    }

    /// Returns whether none of the elements `known` brings `x` nearer to the centre.
    fn is_inside(&self, x: &[f64], known: &[usize]) -> bool {
        let own = self.own_value(x);
        x.iter().all(|x| x.is_finite()) && known.iter().all(|k| self.value(*k, x, own) >= 0.0)
    }

    /// Finds the element, none of `known`, that brings `x` nearest to the centre; `None` if all take it away.
    fn nearest(&self, x: &[f64], known: &[usize]) -> Option<usize> {
        let own = self.own_value(x);
        let least = -1e-9 * self.nearness.of(x).abs().max(1e-9 * self.scale);
        (0..self.elements.len())
            .filter(|k| !known.contains(k))
            .map(|k| (self.value(k, x, own), k))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .and_then(|(value, k)| (value < least).then_some(k))
    }

    /// Finds the elements of the faces that are first in some direction from the centre.
    fn seen_from_centre(&self) -> Vec<usize> {
        let nearness = self.nearness;
        if self.elements.is_empty() {
            return Vec::new();
        }
        let moved = self
            .elements
            .iter()
            .map(|element| nearness.displacement(element));
        // Where all take the centre to places that the chart lacks, its own unit will do.
        let step = 0.05 * moved.into_iter().find(|far| far.is_finite()).unwrap_or(1.0);
        let (mut known, mut seen) = (vec![0], Vec::new());
        for i in 0..DIRECTIONS {
            let d = fibonacci_direction(i, DIRECTIONS);
            let line = |t: f64| nearness.lifted(nearness.centre + d * t);
            let face = self.first_face(line, step, &mut known);
            seen.extend(face.filter(|k| !seen.contains(k)));
        }
        seen
    }

    /// Finds the element whose face is the first on a line from the centre, and adds those looked at on the way to
    /// `known`. `None` if none of them ends the line before the space ends, or where steps of length `step` along it are tried.
    fn first_face(
        &self,
        line: impl Fn(f64) -> Vec<f64>,
        step: f64,
        known: &mut Vec<usize>,
    ) -> Option<usize> {
        let [mut low, mut high] = self.ended(&line, step, known)?;
        loop {
            [low, high] = narrowed(|t| self.is_inside(&line(t), known), [low, high]);
            // A face that none of them is cuts it off before.
            let Some(k) = self.nearest(&line(low), known) else {
                break;
            };
            known.push(k);
            (low, high) = (0.0, low);
        }
        let x = line(high);
        let own = self.own_value(&x);
        let value = |k: usize| self.value(k, &x, own);
        known
            .iter()
            .copied()
            .min_by(|a, b| value(*a).total_cmp(&value(*b)))
    }

    /// Finds an interval of a line in which the faces known so far end it, or else others; `None` where the space ends before.
    fn ended(
        &self,
        line: impl Fn(f64) -> Vec<f64>,
        step: f64,
        known: &mut Vec<usize>,
    ) -> Option<[f64; 2]> {
        let mut places = (1..=(20.0 * REACH) as usize).map(|j| step * j as f64);
        let is_in_space = |t: f64| self.nearness.is_in_space(&line(t));
        let stop = places.find(|t| !is_in_space(*t) || !self.is_inside(&line(*t), known));
        let last = match stop {
            Some(t) if is_in_space(t) => t,
            Some(t) => narrowed(is_in_space, [t - step, t])[0],
            None => f64::INFINITY,
        };
        match stop {
            Some(t) if !self.is_inside(&line(last), known) => Some([t - step, last]),
            _ => Some([0.0, self.ended_by_others(&line, (step, last), known)?]),
        }
    }

    /// Finds a place on a line, farther and farther out up to `last`, that an element which is none of `known` brings nearer to
    /// the centre, and adds that element to them.
    fn ended_by_others(
        &self,
        line: impl Fn(f64) -> Vec<f64>,
        (step, last): (f64, f64),
        known: &mut Vec<usize>,
    ) -> Option<f64> {
        let places = (1..=DOUBLINGS).map(|j| step * f64::from(1 << j));
        let places = places.take_while(|t| *t < last && self.nearness.is_in_space(&line(*t)));
        let end = Some(last).filter(|last| last.is_finite());
        let ended = |t: f64| Some((t, self.nearest(&line(t), known)?));
        let (t, k) = places.chain(end).find_map(ended)?;
        known.push(k);
        Some(t)
    }

    /// Adds the inverses of `chosen`, whose faces bound the domain as well.
    fn with_inverses(&self, mut chosen: Vec<usize>) -> Vec<usize> {
        for k in chosen.clone() {
            let Some(back) = inverse(&self.elements[k], self.nearness.model.dimension) else {
                continue;
            };
            let back = self.nearness.in_units(&back);
            let same = |other: &Vec<f64>| {
                let pairs = self.nearness.in_units(other).into_iter().zip(&back);
                pairs.fold(0.0, |most: f64, (a, b)| most.max((a - *b).abs())) <= 1e-6
            };
            if let Some(j) = self.elements.iter().position(same)
                && !chosen.contains(&j)
            {
                chosen.push(j);
            }
        }
        chosen
    }
}

/// Narrows an interval at whose beginning something `holds`, and not at its end, to two places close together.
fn narrowed(holds: impl Fn(f64) -> bool, [mut low, mut high]: [f64; 2]) -> [f64; 2] {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        match holds(middle) {
            true => low = middle,
            false => high = middle,
        }
    }
    [low, high]
}
