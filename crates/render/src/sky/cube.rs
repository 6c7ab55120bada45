//! Cells on the faces of a cube around the eye, for look-up by direction.
//!
//! In: unit vectors. Out: cells and the places in them ([`CubePlace`]), and back; the cells around a direction.

use super::sixteen::{Numbers, Vectors, floor, lane};
use crate::lanes::LANES;
use glam::Vec3;

/// Cells along an edge of the cube; one is at most 31 mrad wide.
pub const CELLS: usize = 64;
/// A place on the cube's surface: face, cell on it, and place in the cell.
#[derive(Clone, Copy)]
pub struct CubePlace {
    face: f32,
    column: f32,
    row: f32,
    /// In the cell, from its lower edges, in cells.
    pub x: f32,
    /// In the cell, from its lower edges, in cells.
    pub y: f32,
}

impl CubePlace {
    /// Without branches, so that a loop over directions takes vector instructions.
    #[inline(always)]
    pub fn of(d: Vec3) -> Self {
        let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs());
        let (is_x, is_y) = ((x >= y) & (x >= z), y >= z);
        let pick = |x: f32, y: f32, z: f32| {
            let other = if is_y { y } else { z };
            if is_x { x } else { other }
        };
        let height = pick(d.x, d.y, d.z);
        let face = pick(0.0, 2.0, 4.0) + if height < 0.0 { 1.0 } else { 0.0 };
        let scale = 0.5 * CELLS as f32;
        let inverse = 1.0 / height.abs();
        let x = (pick(d.y, d.z, d.x) * inverse + 1.0) * scale;
        let y = (pick(d.z, d.x, d.y) * inverse + 1.0) * scale;
        let last = CELLS as f32 - 1.0;
        let (column, row) = (floor(x).max(0.0).min(last), floor(y).max(0.0).min(last));
        let (x, y) = (x - column, y - row);
        Self {
            face,
            column,
            row,
            x,
            y,
        }
    }

    /// The number of its cell.
    #[inline(always)]
    pub fn cell(&self) -> f32 {
        (self.face * CELLS as f32 + self.row) * CELLS as f32 + self.column
    }
}

/// The number of the lowest corner of a cell.
pub fn lowest_corner(cell: usize) -> usize {
    let (row, column) = (cell / CELLS, cell % CELLS);
    // Every face has one row of corners more than of cells.
    (row + row / CELLS) * (CELLS + 1) + column
}

/// [`CubePlace`] in sixteen lanes: numbers of cells, and the places in them.
pub struct Places {
    /// Numbers of cells.
    pub cells: Numbers,
    /// Places in them.
    pub x: Numbers,
    /// Places in them.
    pub y: Numbers,
}

impl Places {
    #[inline(always)]
    pub fn of(d: &Vectors) -> Self {
        let [mut cells, mut x, mut y] = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let place = CubePlace::of(lane(d, l));
            cells[l] = place.cell();
            x[l] = place.x;
            y[l] = place.y;
        }
        Self { cells, x, y }
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
pub fn corner_directions() -> impl Iterator<Item = Vec3> {
    let side = CELLS + 1;
    (0..6 * side * side).map(move |i| {
        let (x, y) = (i % side, i / side % side);
        cube_direction(i / (side * side), x as f32, y as f32)
    })
}

/// Every cell that has a point within `reach` radians of `d`, perhaps a few more.
pub fn cells_within(d: Vec3, reach: f32) -> Vec<usize> {
    // The cells of a face are graph-paper squares in the gnomonic plane; a cap around `d` meets a
    // face only if its direction, pushed by the reach, does.
    let mut cells = Vec::new();
    let is_near = |face: usize, column: usize, row: usize| {
        let at = |x: f32, y: f32| cube_direction(face, column as f32 + x, row as f32 + y);
        let middle = at(0.5, 0.5);
        let corners = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0)];
        let radius = corners
            .map(|p| p.distance(middle))
            .into_iter()
            .fold(0.0, f32::max);
        d.distance(middle) <= 1.001 * (reach + radius)
    };
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
            let near = columns.clone().filter(|c| is_near(face, *c, row));
            cells.extend(near.map(|c| (face * CELLS + row) * CELLS + c));
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::{super::catalogue, *};

    const REACH: f32 = 0.012;

    #[test]
    fn a_place_on_the_cube_and_its_direction_are_inverse() {
        for face in 0..6 {
            for (x, y) in [(0.5, 0.5), (10.25, 63.5), (33.0, 1.0)] {
                let place = CubePlace::of(cube_direction(face, x, y));
                assert_eq!(place.face as usize, face);
                let (x1, y1) = (place.column + place.x, place.row + place.y);
                assert!((x1 - x).abs() < 1e-4 && (y1 - y).abs() < 1e-4);
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
                assert!(
                    cells.contains(&(CubePlace::of(edge).cell() as usize)),
                    "{star} {edge}"
                );
            }
        }
    }
}
