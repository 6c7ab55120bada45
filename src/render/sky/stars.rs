//! The "stars" sky: a few thousand stars, brighter constellations among them, and a milky way.
//!
//! In: direction and footprint (radians). Out: linear radiance.
//!
//! The brightest stars are those of well-known constellations at their real places: declination is
//! latitude, right ascension longitude, so seen from the centre they are not mirrored. The rest
//! are scattered by a hash and are the same on every machine. A star is a disc with a soft edge
//! that widens with the footprint and keeps its light.
//!
//! Look-up goes through the cells of a cube: each lists the stars that reach into it, and its
//! corners hold the diffuse glow.

use super::catalogue::{self, Star};
use crate::render::footprint::FILTER_DEVIATION;
use glam::Vec3;
use std::f32::consts::PI;

/// Cells along an edge of the cube; one is at most 31 mrad wide.
const CELLS: usize = 64;
/// The widest disc; a wider one would reach into cells that do not list it.
const REACH: f32 = 0.012;

/// The radius of the disc (1 − r²/R²)² that is as wide as the pixel filter, in pixels.
const DISC_RADII: f32 = 2.828_427 * FILTER_DEVIATION;

/// The stars and the glow between them, sorted for look-up.
#[derive(Debug, Clone)]
pub struct StarField {
    /// Where each cell's stars begin in `stars`; one entry more than cells.
    first: Vec<u32>,
    stars: Vec<Star>,
    /// Glow at the corners of the cells, `CELLS + 1` along each edge of each face.
    glow: Vec<Vec3>,
    /// Glow and stars together, spread evenly, cell by cell corner.
    mean: Vec<Vec3>,
}

impl StarField {
    /// Scatters the stars.
    pub(super) fn new() -> Self {
        let stars = catalogue::stars();
        let mut cells = vec![Vec::new(); 6 * CELLS * CELLS];
        for star in &stars {
            for cell in cells_within(star.direction, REACH) {
                cells[cell].push(*star);
            }
        }
        let mut first = vec![0];
        first.extend(cells.iter().scan(0, |sum, cell| {
            *sum += cell.len() as u32;
            Some(*sum)
        }));
        let corners: Vec<Vec3> = corner_directions().collect();
        let glow: Vec<Vec3> = corners.iter().map(|d| catalogue::glow(*d)).collect();
        let total: Vec3 = stars.iter().map(|s| s.light).sum();
        let even = total / (4.0 * PI);
        Self {
            first,
            stars: cells.concat(),
            mean: glow.iter().map(|g| *g + even).collect(),
            glow,
        }
    }

    /// Linear light from the unit vector `d`, averaged over about `footprint` radians.
    pub(super) fn radiance(&self, d: Vec3, footprint: f32) -> Vec3 {
        let place = CubePlace::of(d);
        // Past the reach the stars melt into their mean, over one doubling of the footprint.
        let melt = (footprint / REACH - 1.0).clamp(0.0, 1.0);
        if melt == 1.0 {
            return place.between(&self.mean);
        }
        // The disc's deviation across is its radius over √8; variances add.
        let spread = DISC_RADII * footprint;
        let cell = place.cell();
        let range = self.first[cell] as usize..self.first[cell + 1] as usize;
        let mut sharp = place.between(&self.glow);
        for star in &self.stars[range] {
            let squared = (star.radius * star.radius + spread * spread).min(REACH * REACH);
            let inside = squared - star.direction.distance_squared(d);
            if inside > 0.0 {
                // The disc (1 − r²/R²)² holds πR²/3.
                let depth = inside / squared;
                sharp += star.light * (depth * depth * 3.0 / (PI * squared));
            }
        }
        if melt == 0.0 {
            return sharp;
        }
        sharp.lerp(place.between(&self.mean), melt)
    }
}

/// A place on the cube's surface: face, and cells from its lower edges.
struct CubePlace {
    face: usize,
    x: f32,
    y: f32,
}

impl CubePlace {
    fn of(d: Vec3) -> Self {
        let axis = d.abs().max_position();
        let face = 2 * axis + usize::from(d[axis] < 0.0);
        let scale = 0.5 * CELLS as f32;
        let coordinate = |i: usize| (d[i % 3] / d[axis].abs() + 1.0) * scale;
        Self {
            face,
            x: coordinate(axis + 1),
            y: coordinate(axis + 2),
        }
    }

    fn column_row(&self) -> (usize, usize) {
        (
            (self.x as usize).min(CELLS - 1),
            (self.y as usize).min(CELLS - 1),
        )
    }

    fn cell(&self) -> usize {
        let (column, row) = self.column_row();
        (self.face * CELLS + row) * CELLS + column
    }

    /// Bilinear between the four corners of the cell.
    fn between(&self, corners: &[Vec3]) -> Vec3 {
        let (column, row) = self.column_row();
        let (fx, fy) = (self.x - column as f32, self.y - row as f32);
        let low = (self.face * (CELLS + 1) + row) * (CELLS + 1) + column;
        let high = low + CELLS + 1;
        let below = corners[low].lerp(corners[low + 1], fx);
        below.lerp(corners[high].lerp(corners[high + 1], fx), fy)
    }
}

/// Unit vector to a point of a face, `x` and `y` in cells from its lower edges; the inverse of
/// [`CubePlace::of`].
fn cube_direction(face: usize, x: f32, y: f32) -> Vec3 {
    let axis = face / 2;
    let mut d = Vec3::ZERO;
    d[axis] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    d[(axis + 1) % 3] = 2.0 * x / CELLS as f32 - 1.0;
    d[(axis + 2) % 3] = 2.0 * y / CELLS as f32 - 1.0;
    d.normalize()
}

/// Directions of all corners, in the order of the glow.
fn corner_directions() -> impl Iterator<Item = Vec3> {
    let side = CELLS + 1;
    (0..6 * side * side).map(move |i| {
        let (x, y) = (i % side, i / side % side);
        cube_direction(i / (side * side), x as f32, y as f32)
    })
}

/// Every cell that has a point within `reach` radians of `d`, perhaps a few more.
fn cells_within(d: Vec3, reach: f32) -> Vec<usize> {
    // The cells of a face are graph-paper squares in the gnomonic plane; a cap around `d` meets a
    // face only if its direction, pushed by the reach, does.
    let mut cells = Vec::new();
    for face in 0..6 {
        let axis = face / 2;
        let height = if face % 2 == 0 { d[axis] } else { -d[axis] };
        if height < 0.5 {
            continue;
        }
        // In the plane an angle is stretched by at most 1/cos² ≤ 3, plus 10 % where the cap
        // leans out of the face.
        let span = 3.3 * reach * 0.5 * CELLS as f32;
        let range = |i: usize| {
            let middle = (d[i % 3] / height + 1.0) * 0.5 * CELLS as f32;
            let (low, high) = (middle - span, middle + span);
            let inside = high >= 0.0 && low <= CELLS as f32;
            let last = CELLS - 1;
            inside.then(|| (low.max(0.0) as usize).min(last)..=(high as usize).min(last))
        };
        let (Some(columns), Some(rows)) = (range(axis + 1), range(axis + 2)) else {
            continue;
        };
        for row in rows {
            cells.extend(columns.clone().map(|c| (face * CELLS + row) * CELLS + c));
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_on_the_cube_and_its_direction_are_inverse() {
        for face in 0..6 {
            for (x, y) in [(0.5, 0.5), (10.25, 63.5), (33.0, 1.0)] {
                let place = CubePlace::of(cube_direction(face, x, y));
                assert_eq!(place.face, face);
                assert!((place.x - x).abs() < 1e-4 && (place.y - y).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_star_is_listed_wherever_it_reaches() {
        for i in 0..400 {
            let star = catalogue::scattered(i, 400);
            let across = star.any_orthonormal_vector();
            let cells = cells_within(star, REACH);
            for turn in 0..16 {
                let (sin, cos) = (turn as f32 / 16.0 * std::f32::consts::TAU).sin_cos();
                let side = across * cos + star.cross(across) * sin;
                let edge = (star + 0.99 * REACH * side).normalize();
                assert!(cells.contains(&CubePlace::of(edge).cell()), "{star} {edge}");
            }
        }
    }

    #[test]
    fn a_wider_footprint_keeps_a_stars_light() {
        let field = StarField::new();
        // Sirius outshines whatever else is near.
        let sirius = catalogue::at(101.29, -16.72);
        let (right, up) = sirius.any_orthonormal_pair();
        let light = |footprint: f32| {
            let (step, n) = (2.5e-4, 48);
            let mut sum = 0.0;
            for i in -n..=n {
                for j in -n..=n {
                    let d = sirius + step * (right * i as f32 + up * j as f32);
                    let seen = field.radiance(d.normalize(), footprint).y;
                    sum += (seen - catalogue::glow(d.normalize()).y) * step * step;
                }
            }
            sum
        };
        let point = light(0.0);
        for footprint in [1e-3, 3e-3, 8e-3] {
            assert!((light(footprint) / point - 1.0).abs() < 0.15, "{footprint}");
        }
    }
}
