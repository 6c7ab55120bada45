//! The "stars" sky: a few thousand stars, brighter constellations among them, and a milky way.
//!
//! In: direction and footprint (radians). Out: linear radiance.
//!
//! The brightest stars are those of well-known constellations at their real places: declination is
//! latitude, right ascension longitude, so seen from the centre they are not mirrored. The rest
//! are scattered by a hash and are the same on every machine. A star is a disc with a soft edge
//! that widens with the footprint, across and along it, and keeps its light.
//!
//! Look-up goes through the cells of a cube around the eye: each lists the stars that reach into it, and its
//! corners hold the diffuse glow.

use super::catalogue::{self, Star};
use crate::{
    filter::{Across, FILTER_DEVIATION, LaneTaps, add},
    lanes::{
        LANES, Mask, SingleLanes, SingleVectors, floor, largest, less, limited, more, set_lane,
        single, single_lane, single_vector,
    },
};
use glam::Vec3;
use std::f32::consts::PI;

/// Radius of the widest disc; a wider one would reach into cells that do not list it.
const REACH: f32 = 0.012;

/// The radius of the disc (1 − r²/R²)² that is as wide as the pixel filter, in pixels.
const DISC_RADII: f32 = 2.828_427 * FILTER_DEVIATION;

/// The longest footprint whose discs are not cut short.
const LONGEST: f32 = REACH / DISC_RADII;

/// Footprints no longer than this, radians, see one value of what changes slowly over a sky: as far as
/// from one of the places where that is known to the next.
const EVEN: f32 = 0.03;

/// The stars and the glow between them, sorted for look-up.
#[derive(Debug, Clone)]
pub struct StarField {
    /// Where each cell's stars begin in `stars`; one entry more than cells.
    first: Vec<u32>,
    stars: Vec<Star>,
    /// Glow at the corners of the cells, `CELLS + 1` along each edge of each face.
    glow: Vec<Vec3>,
    /// The stars' light spread evenly over the sphere.
    even: Vec3,
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
        let glow = corner_directions().map(catalogue::glow);
        let total: Vec3 = stars.iter().map(|s| s.light).sum();
        Self {
            first,
            stars: cells.concat(),
            glow: glow.collect(),
            even: total / (4.0 * PI),
        }
    }

    /// Returns linear light from the unit vector `d`, averaged over about `footprint` radians.
    pub(super) fn radiance(&self, d: Vec3, footprint: f32) -> Vec3 {
        let [cell, x, y] = cube_place(d);
        let cell = cell as usize;
        let corners = self.corners(lowest_corner(cell));
        let stars = self.stars_near(cell).iter();
        let round = Oval::of(Vec3::ZERO, footprint);
        let sharp: Vec3 = stars.map(|star| star.light * round.sees(star, d)).sum();
        between(&corners, x, y) + sharp.lerp(self.even, melt(footprint))
    }

    /// Returns linear light from the unit vectors `d`, averaged over what samples stand for that change
    /// `across`, in the lanes that are `wanted`. The glow between stars is looked up once for each, if all
    /// footprints are short.
    #[inline(always)]
    pub(super) fn lights(
        &self,
        d: &SingleVectors,
        across: &Across,
        wanted: &Mask,
    ) -> SingleVectors {
        let taps = LaneTaps::of(across, LONGEST);
        let ovals = Ovals::of(&taps);
        let short = taps.longest(wanted) <= EVEN;
        let mut mean = taps.mean(
            d,
            wanted,
            #[inline(always)]
            |places, within| {
                let mut light = self.sharp(places, (&ovals, &taps.width), within);
                if !short {
                    add(&mut light, &self.glow(places), within);
                }
                light
            },
        );
        if short {
            add(&mut mean, &self.glow(d), wanted);
        }
        mean
    }

    /// Computes [`StarField::radiance`] without the glow in the lanes that are `wanted`, over ovals so
    /// wide. Lanes in one cell see its stars together.
    #[inline(always)]
    fn sharp(
        &self,
        d: &SingleVectors,
        (ovals, widths): (&Ovals, &SingleLanes),
        wanted: &Mask,
    ) -> SingleVectors {
        let [cells, ..] = cube_places(d);
        let mut stars = SingleVectors::default();
        // What is not asked for, sees no stars, or has its light, is in no cell.
        let mut rest = single(
            #[inline(always)]
            |l| {
                let sees = wanted[l] & (melt(widths[l]) < 1.0);
                if sees { cells[l] } else { -1.0 }
            },
        );
        loop {
            let cell = largest(&rest);
            if cell < 0.0 {
                break;
            }
            let here = single(
                #[inline(always)]
                |l| if rest[l] == cell { 1.0 } else { 0.0 },
            );
            for star in self.stars_near(cell as usize) {
                star.shine(d, ovals, &here, &mut stars);
            }
            let old = rest;
            rest = single(
                #[inline(always)]
                |l| if old[l] == cell { -1.0 } else { old[l] },
            );
        }
        single_vector(
            #[inline(always)]
            |l| single_lane(&stars, l).lerp(self.even, melt(widths[l])),
        )
    }

    /// Computes the glow in all lanes.
    #[inline(always)]
    fn glow(&self, d: &SingleVectors) -> SingleVectors {
        let [cells, x, y] = cube_places(d);
        let mut corners = [SingleVectors::default(); 4];
        for l in 0..LANES {
            let around = self.corners(lowest_corner(cells[l] as usize));
            for (corners, glow) in corners.iter_mut().zip(around) {
                set_lane(corners, l, glow);
            }
        }
        single_vector(
            #[inline(always)]
            |l| {
                let [a, b, c, d] = &corners;
                let around = [
                    single_lane(a, l),
                    single_lane(b, l),
                    single_lane(c, l),
                    single_lane(d, l),
                ];
                between(&around, x[l], y[l])
            },
        )
    }

    /// Returns the stars that reach into a cell.
    fn stars_near(&self, cell: usize) -> &[Star] {
        &self.stars[self.first[cell] as usize..self.first[cell + 1] as usize]
    }

    /// Returns the glow at the corners of a cell, of which the lowest has number `low`.
    fn corners(&self, low: usize) -> [Vec3; 4] {
        let side = CELLS + 1;
        let glow = &self.glow[low..low + side + 2];
        [glow[0], glow[1], glow[side], glow[side + 1]]
    }
}

/// Returns how far the stars have melted into their mean, 0 to 1: past the reach, over one doubling of
/// the footprint.
#[inline(always)]
fn melt(footprint: f32) -> f32 {
    limited(footprint * (1.0 / REACH) - 1.0, 0.0, 1.0)
}

impl Star {
    /// Adds its light in the lanes that are `here` (1; 0 elsewhere), if any of those is in the disc.
    #[inline(always)]
    fn shine(
        &self,
        d: &SingleVectors,
        ovals: &Ovals,
        here: &SingleLanes,
        light: &mut SingleVectors,
    ) {
        let inside = single(
            #[inline(always)]
            |l| here[l] * ovals.lane(l).depth(self, single_lane(d, l))[0],
        );
        if largest(&inside) > 0.0 {
            let old = *light;
            *light = single_vector(
                #[inline(always)]
                |l| {
                    single_lane(&old, l)
                        + self.light * (here[l] * ovals.lane(l).sees(self, single_lane(d, l)))
                },
            );
        }
    }
}

/// The widening of discs by a footprint.
struct Oval {
    /// The direction in which it is longest: a unit vector, or zero if it is round.
    along: Vec3,
    /// Squares of what it adds to a disc's radius along that and across: deviations across a disc are its
    /// radius over √8, and variances add.
    squares: [f32; 2],
}

impl Oval {
    /// Makes that of a footprint as long as `along`, at least as long as it is wide.
    #[inline(always)]
    fn of(along: Vec3, width: f32) -> Self {
        let length = along.length();
        let [long, short] = [DISC_RADII * more(length, width), DISC_RADII * width];
        Self {
            along: along / more(length, f32::MIN_POSITIVE),
            squares: [long * long, short * short],
        }
    }

    /// Returns a depth that is positive where `d` is inside the star's widened disc, and its value in the
    /// middle: the square of the product of the radii. No radius exceeds the reach.
    #[inline(always)]
    fn depth(&self, star: &Star, d: Vec3) -> [f32; 2] {
        let own = star.radius * star.radius;
        let long = less(own + self.squares[0], REACH * REACH);
        let short = less(own + self.squares[1], REACH * REACH);
        let off = star.direction - d;
        let along = off.dot(self.along);
        let along = along * along;
        let across = off.length_squared() - along;
        let area = long * short;
        [area - along * short - across * long, area]
    }

    /// Returns the part of a star's light that is seen from `d` in each unit of solid angle: that of the disc
    /// (1 − r²/R²)², which holds πR²/3, stretched.
    #[inline(always)]
    fn sees(&self, star: &Star, d: Vec3) -> f32 {
        let [inside, area] = self.depth(star, d);
        let depth = more(inside, 0.0) / area;
        depth * depth * 3.0 / (PI * area.sqrt())
    }
}

/// [`Oval`] in sixteen lanes.
#[derive(Default)]
struct Ovals {
    along: SingleVectors,
    squares: [SingleLanes; 2],
}

impl Ovals {
    /// Makes that of each of the footprints that stand for a sample.
    #[inline(always)]
    fn of(taps: &LaneTaps) -> Self {
        let mut to = Self::default();
        for l in 0..LANES {
            let oval = Oval::of(single_lane(&taps.step, l), taps.width[l]);
            set_lane(&mut to.along, l, oval.along);
            to.squares[0][l] = oval.squares[0];
            to.squares[1][l] = oval.squares[1];
        }
        to
    }

    #[inline(always)]
    fn lane(&self, l: usize) -> Oval {
        Oval {
            along: single_lane(&self.along, l),
            squares: [self.squares[0][l], self.squares[1][l]],
        }
    }
}

/// Interpolates bilinearly between the four corners of a cell: below, then above.
#[inline(always)]
fn between(corners: &[Vec3; 4], x: f32, y: f32) -> Vec3 {
    let below = corners[0].lerp(corners[1], x);
    below.lerp(corners[2].lerp(corners[3], x), y)
}

/// Number of cells along an edge of the cube; one is at most 31 mrad wide.
const CELLS: usize = 64;

/// Returns the number of the cell of the cube in the direction `d`, and the place in it, `x` and `y` from its
/// lower edges in cells. Without branches, so that a loop over directions takes vector instructions.
#[inline(always)]
fn cube_place(d: Vec3) -> [f32; 3] {
    // The face, and the place on it.
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
    // The cell, and the place in it.
    let last = CELLS as f32 - 1.0;
    let (column, row) = (limited(floor(x), 0.0, last), limited(floor(y), 0.0, last));
    let cell = (face * CELLS as f32 + row) * CELLS as f32 + column;
    [cell, x - column, y - row]
}

/// Returns the number of the lowest corner of a cell.
fn lowest_corner(cell: usize) -> usize {
    let (row, column) = (cell / CELLS, cell % CELLS);
    // Every face has one row of corners more than of cells.
    (row + row / CELLS) * (CELLS + 1) + column
}

/// Computes [`cube_place`] in every lane.
#[inline(always)]
fn cube_places(d: &SingleVectors) -> [SingleLanes; 3] {
    let mut places = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let [cell, x, y] = cube_place(single_lane(d, l));
        (places[0][l], places[1][l], places[2][l]) = (cell, x, y);
    }
    places
}

/// Returns the unit vector to a point of a face, `x` and `y` in cells from its lower edges; the inverse of
/// [`cube_place`].
fn cube_direction(face: usize, x: f32, y: f32) -> Vec3 {
    let axis = face / 2;
    let mut d = Vec3::ZERO;
    d[axis] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    d[(axis + 1) % 3] = 2.0 * x / CELLS as f32 - 1.0;
    d[(axis + 2) % 3] = 2.0 * y / CELLS as f32 - 1.0;
    d.normalize()
}

/// Iterates over the directions of all corners, in the order of the glow.
fn corner_directions() -> impl Iterator<Item = Vec3> {
    let side = CELLS + 1;
    (0..6 * side * side).map(move |i| {
        let (x, y) = (i % side, i / side % side);
        cube_direction(i / (side * side), x as f32, y as f32)
    })
}

/// Returns every cell that has a point within `reach` radians of `d`, perhaps a few more.
fn cells_within(d: Vec3, reach: f32) -> Vec<usize> {
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
    use super::*;

    #[test]
    fn a_place_on_the_cube_and_its_direction_are_inverse() {
        for face in 0..6 {
            for (x, y) in [(0.5, 0.5), (10.25, 63.5), (33.0, 1.0)] {
                let [cell, x1, y1] = cube_place(cube_direction(face, x, y));
                let cell = cell as usize;
                assert_eq!(cell / (CELLS * CELLS), face);
                let (row, column) = (cell / CELLS % CELLS, cell % CELLS);
                let (x1, y1) = (column as f32 + x1, row as f32 + y1);
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
                    cells.contains(&(cube_place(edge)[0] as usize)),
                    "{star} {edge}"
                );
            }
        }
    }

    #[test]
    fn no_two_stars_stand_at_a_pole() {
        for count in [60, 5_000] {
            let mut poles = (0..count).filter(|i| catalogue::scattered(*i, count).z.abs() == 1.0);
            assert!(poles.next().is_none(), "{count}");
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

    #[test]
    fn a_long_footprint_keeps_a_stars_light() {
        let field = StarField::new();
        let sirius = catalogue::at(101.29, -16.72);
        let (right, up) = sirius.any_orthonormal_pair();
        let sum = |long: f32| {
            let oval = Oval::of((right * 0.8 + up * 0.6) * long, 1e-3);
            let ovals = Ovals {
                along: oval.along.to_array().map(|x| [x; LANES]),
                squares: oval.squares.map(|x| [x; LANES]),
            };
            let (step, n) = (2.5e-4, 48);
            let mut sum = 0.0;
            for i in -n..=n {
                for first in (-n..=n).step_by(LANES) {
                    let mut d = SingleVectors::default();
                    for l in 0..LANES {
                        let j = (first + l as i32) as f32;
                        let place = sirius + step * (right * i as f32 + up * j);
                        set_lane(&mut d, l, place.normalize());
                    }
                    let wanted = std::array::from_fn(|l| first + l as i32 <= n);
                    let light = field.sharp(&d, (&ovals, &[1e-3; LANES]), &wanted);
                    sum += (0..LANES)
                        .filter(|l| wanted[*l])
                        .map(|l| light[1][l])
                        .sum::<f32>();
                }
            }
            sum
        };
        let round = sum(1e-3);
        for long in [3e-3, 6e-3, LONGEST] {
            assert!((sum(long) / round - 1.0).abs() < 0.05, "{long}");
        }
    }
}
