//! Light on surfaces that do not move, computed once.
//!
//! In: a world with lights. Out: [`Baked`]: irradiance on both sides of every triangle, on a lattice
//! of points as fine as the budget allows, linear in between. A small triangle has its three
//! corners, which it shares with its neighbours where they share a normal.

use super::{Lamps, SurfacePoint};
use crate::render::World;
use glam::DVec3;
use rayon::prelude::*;
use std::{
    collections::HashMap,
    sync::atomic::{AtomicUsize, Ordering},
};

/// Points of the lattices of a whole scene. Behind a bump one core lights 15,000 points a second, so
/// this many take two seconds on two; on a floor that fills the picture they are two or three pixels
/// of a thousand apart, and shadows have edges that soft.
pub const POINTS: usize = 40_000;

/// Most parts of a triangle's side.
const MOST_PARTS: usize = 512;

/// Points lit by one thread at a time: enough to fill the integrator's lanes many times over.
const BLOCK: usize = 256;

/// Irradiance on the triangles of a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    layout: Layout,
    /// Irradiance on the front (red, green, blue), then on the back, one for each point.
    pub values: Vec<[f32; 6]>,
}

/// Where the points lie.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Parts of the sides of each triangle.
    parts: Vec<u16>,
    /// Where each triangle's points begin in `order`.
    first: Vec<u32>,
    /// Numbers of the points, row by row of each triangle.
    order: Vec<u32>,
    points: Vec<SurfacePoint>,
}

impl Layout {
    /// At most about `budget` points (more if there are more corners) on the triangles of `world`.
    pub fn new(world: &World, budget: usize) -> Self {
        let triangles = world.accelerator.triangles();
        let areas: Vec<f64> = (0..triangles.len()).map(|i| area(world, i)).collect();
        let whole: f64 = areas.iter().sum();
        // A lattice of n parts a side has n²/2 points; all together have budget.
        let density = 2.0 * budget as f64 / whole.max(f64::MIN_POSITIVE);
        let mut layout = Self {
            parts: Vec::new(),
            first: Vec::new(),
            order: Vec::new(),
            points: Vec::new(),
        };
        let mut corners: HashMap<[u64; 6], u32> = HashMap::new();
        for (triangle, area) in areas.iter().enumerate() {
            let parts = ((area * density).sqrt().round() as usize).clamp(1, MOST_PARTS);
            layout.first.push(layout.order.len() as u32);
            layout.parts.push(parts as u16);
            for j in 0..=parts {
                for i in 0..=parts - j {
                    let weights = (i as f64 / parts as f64, j as f64 / parts as f64);
                    let point = surface_point(world, triangle, weights);
                    let is_corner = [i, j, parts - i - j].contains(&parts);
                    let number = match is_corner {
                        true => *corners
                            .entry(key(&point))
                            .or_insert(layout.points.len() as u32),
                        false => layout.points.len() as u32,
                    };
                    if number as usize == layout.points.len() {
                        layout.points.push(point);
                    }
                    layout.order.push(number);
                }
            }
        }
        layout
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The numbers of the three points around the place with weights (b, c) of `triangle`, and their
    /// weights.
    fn around(&self, triangle: u32, [b, c]: [f32; 2]) -> [(u32, f32); 3] {
        let n = usize::from(self.parts[triangle as usize]);
        let scaled = |x: f32| (f64::from(x) * n as f64).clamp(0.0, n as f64);
        let (x, y) = (scaled(b), scaled(c));
        let j = (y as usize).min(n - 1);
        let i = (x as usize).min(n - 1 - j);
        let (dx, dy) = (x - i as f64, y - j as f64);
        let number = |i: usize, j: usize| {
            // Row j begins after rows of n + 1, n, … points.
            let row = j * (n + 1) - j * j.saturating_sub(1) / 2;
            self.order[self.first[triangle as usize] as usize + row + i]
        };
        if dx + dy <= 1.0 || i + j + 2 > n {
            let rest = 1.0 - dx - dy;
            [
                (number(i, j), rest as f32),
                (number(i + 1, j), dx as f32),
                (number(i, j + 1), dy as f32),
            ]
        } else {
            let rest = dx + dy - 1.0;
            [
                (number(i + 1, j + 1), rest as f32),
                (number(i + 1, j), (1.0 - dy) as f32),
                (number(i, j + 1), (1.0 - dx) as f32),
            ]
        }
    }
}

impl Baked {
    /// Lights the points of `layout`; `done` is told how many more are finished, and how many
    /// there are.
    pub fn new(lamps: &Lamps<'_>, layout: Layout, done: impl Fn(usize, usize) + Sync) -> Self {
        let counted = AtomicUsize::new(0);
        let blocks: Vec<Vec<[f32; 6]>> = layout
            .points
            .par_chunks(BLOCK)
            .map(|points| {
                let mut sums = vec![[0.0_f64; 6]; points.len()];
                let (arrivals, rays) = lamps.arrivals(points);
                counted.fetch_add(rays, Ordering::Relaxed);
                for (index, arrival) in arrivals {
                    let side = if arrival.front { 0 } else { 3 };
                    for k in 0..3 {
                        sums[index][side + k] += arrival.irradiance[k];
                    }
                }
                done(points.len(), layout.len());
                sums.into_iter().map(|s| s.map(|x| x as f32)).collect()
            })
            .collect();
        tracing::debug!("{} geodesics reach the points", counted.into_inner());
        Self {
            values: blocks.concat(),
            layout,
        }
    }

    /// Puts known values on a layout; `None` if they are not as many as its points.
    pub fn from_values(layout: Layout, values: Vec<[f32; 6]>) -> Option<Self> {
        (values.len() == layout.len()).then_some(Self { layout, values })
    }

    /// Irradiance at the place with weights `barycentric` of `triangle`, on the front or the back.
    pub fn at(&self, triangle: u32, barycentric: [f32; 2], front: bool) -> [f32; 3] {
        let side = if front { 0 } else { 3 };
        let around = self.layout.around(triangle, barycentric);
        let part = |k: usize| {
            let of =
                |(number, weight): &(u32, f32)| self.values[*number as usize][side + k] * weight;
            around.iter().map(of).sum::<f32>()
        };
        [part(0), part(1), part(2)].map(|x| x.max(0.0))
    }
}

/// The area of a triangle in the metric at its middle.
fn area(world: &World, triangle: usize) -> f64 {
    let [a, b, c] = world.accelerator.triangles()[triangle];
    let into = world.manifold.standard_frame((a + b + c) / 3.0).inverse();
    let area = 0.5 * (into * (b - a)).cross(into * (c - a)).length();
    if area.is_finite() { area } else { 0.0 }
}

fn surface_point(world: &World, triangle: usize, (b, c): (f64, f64)) -> SurfacePoint {
    let [p, q, r] = world.accelerator.triangles()[triangle];
    let mix = |[p, q, r]: [DVec3; 3]| p * (1.0 - b - c) + q * b + r * c;
    SurfacePoint {
        u: mix([p, q, r]),
        normal: mix(world.faces[triangle].normals),
        triangle: triangle as u32,
    }
}

fn key(point: &SurfacePoint) -> [u64; 6] {
    let [a, b, c] = point.u.to_array().map(f64::to_bits);
    let [d, e, f] = point.normal.to_array().map(f64::to_bits);
    [a, b, c, d, e, f]
}
