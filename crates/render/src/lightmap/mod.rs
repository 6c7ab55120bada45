//! Light on surfaces that do not move: the points at which it is known, and its values.
//!
//! In: a world, and light at points of its triangles. Out: a [`Lightmap`], which tells the light at any
//! place of a triangle. Every triangle is divided evenly into facets, and a facet on which light changes
//! much into four, again and again. Light is linear on a facet that is not divided. A small triangle is
//! one facet, and shares its corners with neighbours of the same normal.

mod directed;

pub use directed::{DirectedLight, DirectedLights, LampImage};

use crate::World;
use glam::{DMat3, DVec3};
use std::collections::HashMap;

/// Most parts of a triangle's side before facets are divided.
const MOST_PARTS: usize = 512;

/// A facet is divided where light differs between its corners by more than this share of the most
/// there. Where it is less, linear interpolation looks smooth; with half of it, points go to smooth
/// slopes instead of to the edges of shadows.
pub const CONTRAST: f32 = 0.2;

/// This share of the mean light is added to the most: what is darker than that does not matter.
const DARK: f32 = 0.1;

/// Facets are divided together if they matter at least this share as much as the one that matters most.
const TOGETHER: f64 = 0.25;

/// A point of a surface that light falls on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Chart point.
    pub u: DVec3,
    /// Normal covector, chart components; any length.
    pub normal: DVec3,
    /// The triangle that it is on.
    pub triangle: u32,
}

/// Light on the front (red, green, blue), then on the back.
pub type Light = [f32; 6];

/// A part of a triangle.
#[derive(Debug, Clone, PartialEq)]
struct Facet {
    /// Its triangle, and its area in the metric.
    triangle: u32,
    area: f64,
    /// The points at its corners.
    corners: [u32; 3],
    /// The first of the four facets that it is divided into: those at its corners, then the middle.
    parts: Option<u32>,
}

/// The points at which light is known, and the facets between them.
#[derive(Debug, Clone, PartialEq)]
pub struct FacetLayout {
    /// Parts of the sides of each triangle, and where its facets begin.
    sides: Vec<(u16, u32)>,
    facets: Vec<Facet>,
    /// The points, those of the even layout first.
    pub points: Vec<SurfacePoint>,
    /// The points in the middle between two others.
    middles: HashMap<[u32; 2], u32>,
    /// The facets that have been divided, in order.
    divided: Vec<u32>,
}

impl FacetLayout {
    /// Spreads at most about `budget` points (more if there are more corners) evenly over the triangles of
    /// `world`.
    pub fn new(world: &World, budget: usize) -> Self {
        let triangles = world.accelerator.triangles();
        let areas: Vec<f64> = (0..triangles.len()).map(|i| area(world, i)).collect();
        let whole: f64 = areas.iter().sum();
        // A lattice of n parts a side has n²/2 points; all together have budget.
        let density = 2.0 * budget as f64 / whole.max(f64::MIN_POSITIVE);
        let mut layout = Self {
            sides: Vec::new(),
            facets: Vec::new(),
            points: Vec::new(),
            middles: HashMap::new(),
            divided: Vec::new(),
        };
        // Triangle by triangle: its points, then the facets between them.
        let mut corners: HashMap<[u64; 6], u32> = HashMap::new();
        for (triangle, area) in areas.into_iter().enumerate() {
            let parts = ((area * density).sqrt().round() as usize).clamp(1, MOST_PARTS);
            let numbers = layout.add_points(world, triangle, parts, &mut corners);
            layout
                .sides
                .push((parts as u16, layout.facets.len() as u32));
            layout.add_facets(triangle as u32, parts, &numbers, area);
        }
        layout
    }

    /// Adds the points of a triangle whose sides have `parts`; returns their numbers, row by row.
    fn add_points(
        &mut self,
        world: &World,
        triangle: usize,
        parts: usize,
        corners: &mut HashMap<[u64; 6], u32>,
    ) -> Vec<u32> {
        let mut numbers = Vec::new();
        for (i, j) in (0..=parts).flat_map(|j| (0..=parts - j).map(move |i| (i, j))) {
            let weights = (i as f64 / parts as f64, j as f64 / parts as f64);
            let point = surface_point(world, triangle, weights);
            let next = self.points.len() as u32;
            let number = match [i, j, parts - i - j].contains(&parts) {
                true => *corners.entry(key(&point)).or_insert(next),
                false => next,
            };
            if number == next {
                self.points.push(point);
            }
            numbers.push(number);
        }
        numbers
    }

    /// Adds the facets between the points with these `numbers`: row by row, those that stand on their
    /// side and between them those that stand on their tip.
    fn add_facets(&mut self, triangle: u32, parts: usize, numbers: &[u32], area: f64) {
        // Row j begins after rows of parts + 1, parts, … points.
        let row = |j: usize| j * (parts + 1) - j * j.saturating_sub(1) / 2;
        let number = |i: usize, j: usize| numbers[row(j) + i];
        let area = area / (parts * parts) as f64;
        let mut add = |corners: [u32; 3]| {
            self.facets.push(Facet {
                triangle,
                area,
                corners,
                parts: None,
            });
        };
        for (i, j) in (0..parts).flat_map(|j| (0..parts - j).map(move |i| (i, j))) {
            add([number(i, j), number(i + 1, j), number(i, j + 1)]);
            if i + j + 2 <= parts {
                add([number(i + 1, j + 1), number(i + 1, j), number(i, j + 1)]);
            }
        }
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Returns the facets that have been divided, in order.
    pub fn divided(&self) -> &[u32] {
        &self.divided
    }

    /// Tells of each point whether it is on one of the triangles that are `chosen`.
    pub fn points_on(&self, chosen: impl Fn(u32) -> bool) -> Vec<bool> {
        let mut on = vec![false; self.points.len()];
        for facet in self.facets.iter().filter(|facet| chosen(facet.triangle)) {
            for corner in facet.corners {
                on[corner as usize] = true;
            }
        }
        on
    }

    /// Divides a facet into four; `None` if there is no such facet or it is divided already.
    pub fn divide(&mut self, facet: u32) -> Option<()> {
        let first = self.facets.len() as u32;
        let of = self.facets.get_mut(facet as usize)?;
        if of.parts.is_some() {
            return None;
        }
        of.parts = Some(first);
        let (triangle, area, [a, b, c]) = (of.triangle, 0.25 * of.area, of.corners);
        let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|ends| self.middle(triangle, ends));
        let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        self.facets.extend(parts.map(|corners| Facet {
            triangle,
            area,
            corners,
            parts: None,
        }));
        self.divided.push(facet);
        Some(())
    }

    /// Returns the number of the point between two others.
    fn middle(&mut self, triangle: u32, [a, b]: [u32; 2]) -> u32 {
        let next = self.points.len() as u32;
        let number = *self.middles.entry([a.min(b), a.max(b)]).or_insert(next);
        if number == next {
            let [p, q] = [a, b].map(|i| self.points[i as usize]);
            self.points.push(SurfacePoint {
                u: 0.5 * (p.u + q.u),
                normal: 0.5 * (p.normal + q.normal),
                triangle,
            });
        }
        number
    }

    /// Divides the facets on which `light` changes most for their area, as long as there are at most
    /// `most` points; tells whether there were any.
    pub fn refine(&mut self, light: &[Light], most: usize) -> bool {
        let sum = |l: &Light| l.iter().sum::<f32>();
        let mean = light.iter().map(sum).sum::<f32>() / light.len().max(1) as f32;
        let matter = |(i, facet): (usize, &Facet)| {
            let contrast = self.contrast(facet, light, DARK * mean);
            let divisible = facet.parts.is_none() && contrast > CONTRAST;
            divisible.then(|| (f64::from(contrast) * facet.area, i as u32))
        };
        let mut uneven: Vec<(f64, u32)> =
            self.facets.iter().enumerate().filter_map(matter).collect();
        // By falling importance, and then by number.
        uneven.sort_by(|(a, i), (b, j)| b.total_cmp(a).then(i.cmp(j)));
        let least = uneven.first().map_or(0.0, |(first, _)| first * TOGETHER);
        let before = self.divided.len();
        for (_, facet) in uneven
            .into_iter()
            .take_while(|(matters, _)| *matters >= least)
        {
            if self.points.len() + 3 > most {
                break;
            }
            self.divide(facet);
        }
        self.divided.len() > before
    }

    /// Measures how much light changes on a facet: between its corners, and the middles of its sides where a
    /// neighbour is divided. The result is a share of the most there and `dark` together.
    fn contrast(&self, facet: &Facet, light: &[Light], dark: f32) -> f32 {
        let [a, b, c] = facet.corners;
        let sides = [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
        let middles = sides.iter().filter_map(|side| self.middles.get(side));
        let places = facet.corners.iter().chain(middles);
        let mut range = [[f32::INFINITY, 0.0_f32]; 2];
        for place in places {
            let (front, back) = light[*place as usize].split_at(3);
            for ([least, most], side) in range.iter_mut().zip([front, back]) {
                let sum: f32 = side.iter().sum();
                (*least, *most) = (least.min(sum), most.max(sum));
            }
        }
        let contrast = |[least, most]: [f32; 2]| (most - least) / (most + dark);
        contrast(range[0]).max(contrast(range[1]))
    }

    /// Returns the three points around the place with weights (b, c) of `triangle`, and their weights.
    pub fn around(&self, triangle: u32, [b, c]: [f32; 2]) -> ([u32; 3], [f32; 3]) {
        let (parts, first) = self.sides[triangle as usize];
        let n = usize::from(parts);
        let scaled = |x: f32| (f64::from(x) * n as f64).clamp(0.0, n as f64);
        let (x, y) = (scaled(b), scaled(c));
        let j = (y as usize).min(n - 1);
        let i = (x as usize).min(n - 1 - j);
        let (dx, dy) = (x - i as f64, y - j as f64);
        let on_its_side = dx + dy <= 1.0 || i + j + 2 > n;
        // Row j begins after rows of 2 n − 1, 2 n − 3, … facets.
        let number = first as usize + j * (2 * n - j) + 2 * i + usize::from(!on_its_side);
        let weights = match on_its_side {
            true => [1.0 - dx - dy, dx, dy],
            false => [dx + dy - 1.0, 1.0 - dy, 1.0 - dx],
        };
        self.within(&self.facets[number], weights)
    }

    /// Returns the points around the place with the given weights of a facet, down to a part that is not
    /// divided.
    fn within<'a>(&'a self, mut facet: &'a Facet, mut weights: [f64; 3]) -> ([u32; 3], [f32; 3]) {
        while let Some(first) = facet.parts {
            let at_corner = (0..3).find(|k| weights[*k] > 0.5);
            facet = &self.facets[first as usize + at_corner.unwrap_or(3)];
            weights = match at_corner {
                None => weights.map(|w| 1.0 - 2.0 * w),
                Some(k) => {
                    let mut doubled = weights.map(|w| 2.0 * w);
                    doubled[k] -= 1.0;
                    doubled
                }
            };
        }
        (facet.corners, weights.map(|w| w as f32))
    }
}

/// Returns the area of a triangle in the metric at its middle.
fn area(world: &World, triangle: usize) -> f64 {
    let [a, b, c] = world.accelerator.triangles()[triangle];
    let into = world.manifold.standard_frame((a + b + c) / 3.0).inverse();
    let area = 0.5 * (into * (b - a)).cross(into * (c - a)).length();
    if area.is_finite() { area } else { 0.0 }
}

/// Returns the point of a triangle where its second and third corners have these weights.
fn surface_point(world: &World, triangle: usize, (b, c): (f64, f64)) -> SurfacePoint {
    let [p, q, r] = world.accelerator.triangles()[triangle];
    let mix = |[p, q, r]: [DVec3; 3]| p * (1.0 - b - c) + q * b + r * c;
    SurfacePoint {
        u: mix([p, q, r]),
        normal: mix(world.normals(triangle)),
        triangle: triangle as u32,
    }
}

/// Returns the bits of a point and its normal: equal for corners that are shared.
fn key(point: &SurfacePoint) -> [u64; 6] {
    let [a, b, c] = point.u.to_array().map(f64::to_bits);
    let [d, e, f] = point.normal.to_array().map(f64::to_bits);
    [a, b, c, d, e, f]
}

/// Irradiance on the triangles of a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Lightmap {
    layout: FacetLayout,
    /// Irradiance on the front (red, green, blue), then on the back, one for each point.
    pub values: Vec<Light>,
    /// The same by the directions that it comes from, at points of glossy surfaces; else none.
    directed: DirectedLights,
}

impl Lightmap {
    /// Puts `values`, one for each point of `layout`, on it; `None` if they do not fit.
    pub fn new(layout: FacetLayout, values: Vec<Light>) -> Option<Self> {
        (values.len() == layout.len()).then_some(Self {
            layout,
            values,
            directed: DirectedLights::default(),
        })
    }

    /// Adds the directions that light comes from, of every point or none; `None` if they do not fit.
    pub fn with_directions(self, directed: DirectedLights) -> Option<Self> {
        // Points without light are not kept in files either.
        if directed.is_empty() {
            return Some(Self {
                directed: DirectedLights::default(),
                ..self
            });
        }
        (directed.points() == self.layout.len()).then_some(Self { directed, ..self })
    }

    /// Returns the directions that light comes from.
    pub fn directed(&self) -> &DirectedLights {
        &self.directed
    }

    /// Puts the images of lamps that light the place with weights `barycentric` of `triangle`, on the front or the back, into
    /// `images`; see [`DirectedLights::between`].
    pub fn images(
        &self,
        (triangle, barycentric): (u32, [f32; 2]),
        front: bool,
        frame: (DMat3, DVec3),
        images: &mut Vec<LampImage>,
    ) {
        match self.directed.is_empty() {
            true => images.clear(),
            false => {
                let around = self.layout.around(triangle, barycentric);
                self.directed.between(around, front, frame, images);
            }
        }
    }

    /// Puts known values on a layout after dividing it; `None` if they do not fit.
    pub fn from_values(
        mut layout: FacetLayout,
        divided: &[u32],
        values: Vec<Light>,
    ) -> Option<Self> {
        for facet in divided {
            layout.divide(*facet)?;
        }
        Self::new(layout, values)
    }

    /// Returns the facets of the layout that have been divided, in order.
    pub fn divided(&self) -> &[u32] {
        self.layout.divided()
    }

    /// Returns the irradiance at the place with weights `barycentric` of `triangle`, on the front or the
    /// back.
    pub fn at(&self, triangle: u32, barycentric: [f32; 2], front: bool) -> [f32; 3] {
        let side = if front { 0 } else { 3 };
        let (corners, weights) = self.layout.around(triangle, barycentric);
        let lights = corners.map(|number| &self.values[number as usize]);
        let part = |k: usize| {
            (0..3)
                .map(|i| lights[i][side + k] * weights[i])
                .sum::<f32>()
        };
        [part(0), part(1), part(2)].map(|x| x.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A triangle with corners (0, 0), (1, 0), (0, 1), divided into `parts` a side.
    fn triangle(parts: usize) -> FacetLayout {
        let mut layout = FacetLayout {
            sides: vec![(parts as u16, 0)],
            facets: Vec::new(),
            points: Vec::new(),
            middles: HashMap::new(),
            divided: Vec::new(),
        };
        let places = (0..=parts).flat_map(|j| (0..=parts - j).map(move |i| (i, j)));
        layout.points.extend(places.map(|(i, j)| SurfacePoint {
            u: DVec3::new(i as f64, j as f64, 0.0) / parts as f64,
            normal: DVec3::Z,
            triangle: 0,
        }));
        let numbers: Vec<u32> = (0..layout.points.len() as u32).collect();
        layout.add_facets(0, parts, &numbers, 0.5);
        layout
    }

    fn place(layout: &FacetLayout, [b, c]: [f32; 2]) -> DVec3 {
        let (corners, weights) = layout.around(0, [b, c]);
        let points = corners.map(|i| layout.points[i as usize].u);
        (0..3).map(|k| points[k] * f64::from(weights[k])).sum()
    }

    #[test]
    fn every_place_is_the_mean_of_the_points_around_it_however_facets_are_divided() {
        let mut layout = triangle(3);
        for facet in [0, 4, 8, 9, 12, 20] {
            layout.divide(facet).unwrap();
        }
        assert_eq!(layout.divide(4), None, "divided already");
        assert_eq!(layout.divide(1000), None);
        let area: f64 = layout
            .facets
            .iter()
            .filter(|f| f.parts.is_none())
            .map(|f| f.area)
            .sum();
        assert!((area - 0.5).abs() < 1e-15);
        for k in 0..1000 {
            let (b, c) = (k as f32 * 0.618 % 1.0, k as f32 * 0.414 % 1.0);
            let [b, c] = if b + c > 1.0 {
                [1.0 - b, 1.0 - c]
            } else {
                [b, c]
            };
            let found = place(&layout, [b, c]);
            let known = DVec3::new(f64::from(b), f64::from(c), 0.0);
            assert!((found - known).length() < 1e-6, "{found} {known}");
        }
    }

    #[test]
    fn points_gather_at_the_edge_of_a_shadow() {
        let mut layout = triangle(8);
        let most = layout.len() + 300;
        let light = |p: &SurfacePoint| match p.u.x + 0.3 * p.u.y < 0.47 {
            true => [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
            false => [0.0; 6],
        };
        let lit =
            |layout: &FacetLayout| -> Vec<Light> { layout.points.iter().map(light).collect() };
        while layout.refine(&lit(&layout), most) {}
        assert!(layout.len() <= most && layout.len() > most - 3);
        let values = lit(&layout);
        let wrong = (0..1000).filter(|k| {
            let (x, y) = (0.3 + 0.2 * (*k as f32 / 1000.0), *k as f32 * 0.618 % 0.5);
            let (corners, weights) = layout.around(0, [x, y]);
            let found: f32 = (0..3)
                .map(|i| values[corners[i] as usize][0] * weights[i])
                .sum();
            let known = if x + 0.3 * y < 0.47 { 1.0 } else { 0.0 };
            (found - known).abs() > 0.01
        });
        // The edge is as wide as a facet: a hundredth of the side instead of an eighth.
        assert!(wrong.count() < 100);
    }
}
