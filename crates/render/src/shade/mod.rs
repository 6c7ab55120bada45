//! Outcomes to colours, and to the layers of an EXR file.
//!
//! In: what every sample sees. Out: its colour in linear light. Surfaces are lit by baked light or
//! by a lamp at the camera (`gloss`). Skies and textures are averaged over the sample's footprint, measured from the
//! samples beside and below (or before, above) that leave through the same exit or meet the same object. Skies are
//! coloured sixteen samples of a row at a time, from the exits and directions of the row and of those above and below.
//!
//! Layers are arc lengths, chart points, normals, numbers of objects, exits and copies of the first sample of every pixel,
//! the area to which a unit solid angle has spread, and frequencies.

pub mod gloss;

use gloss::Lamp;
pub use gloss::{Reflectances, diffuse, emission, is_glossy, is_glossy_triangle, specular};

use super::{
    filter::{Across, Footprint},
    frame::{Outcomes, offsets},
    intersect::{Hit, Seen},
    lanes::{LANES, Mask, SingleVectors, first, mask, single_lane, single_vector},
    picture::Picture,
    redshift::redshifts,
    starts::{RayStart, starts},
    tiles::SamplePlace,
    view::View,
    world::World,
};
use geofan_core::{
    geodesic::{Ray, Settings, ends, signed_area},
    manifold::Gluing,
    parallel::*,
    random::Stream,
};
use geofan_expr::vectorised;
use glam::{DVec2, DVec3, Vec3};
use ndarray::{Array2, Array4, ArrayView2, ArrayView3, Axis};

/// Colours of samples, axes (row, column, sample, channel).
pub type Colours = Array4<f32>;

/// The way in which colours of skies and textures are sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Footprints {
    /// Averaged over what a sample stands for.
    Filtered,
    /// Point samples: the measure against which filtering is held.
    Points,
}

/// Computes the colours of `outcomes`, which are a part of `samples` for each pixel. Bodies that glow stay dark: their light is
/// a matter of frequencies alone ([`super::redshift`]).
pub fn shade(
    world: &World,
    view: &View,
    outcomes: ArrayView3<'_, Seen>,
    samples: usize,
    footprints: Footprints,
) -> Colours {
    let (height, width, count) = outcomes.dim();
    let shader = Shader {
        world,
        outcomes,
        spacing: match footprints {
            Footprints::Filtered => 1.0 / (samples as f32).sqrt(),
            Footprints::Points => 0.0,
        },
        pixel: view.pixel_angle() as f32,
    };
    let mut colours = Colours::zeros((height, width, count, 3));
    colours
        .axis_chunks_iter_mut(Axis(0), BAND)
        .into_par_iter()
        .enumerate()
        .for_each_init(
            || Lamp::new(world),
            |lamp, (band, mut rows)| {
                if let Some(rows) = rows.as_slice_mut() {
                    shader.band(band * BAND, rows, lamp);
                }
            },
        );
    colours
}

/// Rows that are coloured one after another, so that what is seen is sorted once for a row and
/// those above and below it.
const BAND: usize = 12;

/// Everything that the samples of a picture have in common.
struct Shader<'a> {
    world: &'a World,
    outcomes: ArrayView3<'a, Seen>,
    /// The distance of samples, in pixels; 0 asks for points.
    spacing: f32,
    /// The angle of one pixel.
    pixel: f32,
}

impl Shader<'_> {
    /// Computes the colours of the rows from `first` on, three numbers for each sample.
    fn band(&self, first: usize, rows: &mut [f32], lamp: &mut Lamp<'_>) {
        let (height, width, count) = self.outcomes.dim();
        let sky_row = |y: Option<usize>| {
            let row = y.filter(|y| *y < height);
            let row = row.map(|y| self.outcomes.index_axis(Axis(0), y));
            SkyRow::new(self.world, width, count, row)
        };
        let (mut above, mut here) = (sky_row(first.checked_sub(1)), sky_row(Some(first)));
        for (y, row) in (first..).zip(rows.chunks_exact_mut((3 * width * count).max(1))) {
            let below = sky_row(Some(y + 1));
            self.light_skies([&above, &here, &below], row);
            for &i in here.surfaces() {
                let at = (y, i / count, i % count);
                if let Seen::Surface(hit) = self.outcomes[at]
                    && !self.world.glows(hit.triangle)
                {
                    lamp.add(i, hit, self.texture_footprint(at, &hit));
                }
            }
            lamp.light(row);
            (above, here) = (here, below);
        }
    }

    /// Returns the change of texture coordinates from sample to sample; a point without a texture.
    fn texture_footprint(&self, at: SamplePlace, hit: &Hit) -> Footprint {
        let face = &self.world.faces[hit.triangle as usize];
        let textured = self.world.materials[face.material as usize].is_textured();
        if !textured || self.spacing == 0.0 {
            return Footprint::POINT;
        }
        let here = self.world.point_on_triangle(hit);
        let change = |axis: usize| -> Vec3 {
            let way: Option<DVec3> = self.neighbour(at, axis, |seen| match seen {
                Seen::Surface(other)
                    if self.world.faces[other.triangle as usize].object == face.object =>
                {
                    Some(self.world.point_on_triangle(other) - here)
                }
                _ => None,
            });
            way.map_or(Vec3::ZERO, |way| {
                let [du, dv] = self.world.texture_change(hit.triangle, way);
                Vec3::new(du, dv, 0.0)
            })
        };
        let across = [change(0), change(1)];
        Footprint { across }.scaled(self.spacing)
    }

    /// Applies `pick` to the same sample of the next pixel along `axis` (0 right, 1 down), else to that
    /// of the pixel before, which is as far on the other side: its negative.
    fn neighbour<T: std::ops::Neg<Output = T>>(
        &self,
        (y, x, k): SamplePlace,
        axis: usize,
        pick: impl Fn(&Seen) -> Option<T>,
    ) -> Option<T> {
        let (height, width, _) = self.outcomes.dim();
        let (next, before) = match axis {
            0 => (
                (x + 1 < width).then_some((y, x + 1, k)),
                x.checked_sub(1).map(|x| (y, x, k)),
            ),
            _ => (
                (y + 1 < height).then_some((y + 1, x, k)),
                y.checked_sub(1).map(|y| (y, x, k)),
            ),
        };
        let at = |place: Option<SamplePlace>| place.and_then(|p| pick(&self.outcomes[p]));
        at(next).or_else(|| at(before).map(|change| -change))
    }
}

/// In place of an exit where no sky is seen.
const NONE: u32 = u32::MAX;

/// The skies that a row of samples sees, number by number so that vectors of neighbours can be loaded. There
/// is a pixel that sees nothing before the first, and enough after the last.
struct SkyRow {
    /// Samples of one pixel.
    count: usize,
    exits: Vec<u32>,
    directions: [Vec<f32>; 3],
    surfaces: Vec<usize>,
}

impl SkyRow {
    /// Sorts a row (column, sample), or the nothing around the picture.
    fn new(world: &World, width: usize, count: usize, row: Option<ArrayView2<'_, Seen>>) -> Self {
        let length = (width + 2) * count + LANES;
        let mut exits = vec![NONE; length];
        let [mut x, mut y, mut z] = std::array::from_fn(|_| vec![0.0; length]);
        let mut surfaces = Vec::new();
        for (i, seen) in row.iter().flatten().enumerate() {
            let (exit, direction) = match *seen {
                Seen::Surface(_) => {
                    surfaces.push(i);
                    continue;
                }
                Seen::Sky {
                    exit, direction, ..
                } => (exit, direction),
                // The same light everywhere: that of the last sky at its top.
                Seen::Nothing | Seen::Length | Seen::Singular => {
                    (world.skies.len() as u32 - 1, Vec3::Z)
                }
            };
            exits[count + i] = exit;
            [x[count + i], y[count + i], z[count + i]] = direction.to_array();
        }
        Self {
            count,
            exits,
            directions: [x, y, z],
            surfaces,
        }
    }

    /// Returns the samples that see a surface.
    fn surfaces(&self) -> &[usize] {
        &self.surfaces
    }

    /// Returns sixteen samples from `start` on, counted from the pixel before the first.
    #[inline(always)]
    fn sixteen(&self, start: usize) -> Sixteen {
        let mut exits = [NONE; LANES];
        exits.copy_from_slice(&self.exits[start..start + LANES]);
        let mut directions = [[0.0; LANES]; 3];
        for c in 0..3 {
            directions[c].copy_from_slice(&self.directions[c][start..start + LANES]);
        }
        (exits, directions)
    }
}

/// The exits and directions of sixteen samples.
type Sixteen = ([u32; LANES], SingleVectors);

impl Shader<'_> {
    /// Colours the samples of the middle one of three rows that see a sky.
    fn light_skies(&self, rows: [&SkyRow; 3], row: &mut [f32]) {
        vectorised(
            #[inline(always)]
            || {
                for (i, row) in row.chunks_mut(3 * LANES).enumerate() {
                    self.light_sixteen(rows, i * LANES, row);
                }
            },
        );
    }

    /// Colours sixteen of them from `start` on.
    #[inline(always)]
    fn light_sixteen(&self, [above, middle, below]: [&SkyRow; 3], start: usize, row: &mut [f32]) {
        // The samples, and those around them.
        let count = middle.count;
        let here = middle.sixteen(start + count);
        let beside = [middle.sixteen(start + 2 * count), middle.sixteen(start)];
        let under = [below.sixteen(start + count), above.sixteen(start + count)];
        let (mut rest, directions) = here;
        rest[row.len() / 3..].fill(NONE);
        let mut pending = mask(
            #[inline(always)]
            |l| rest[l] != NONE,
        );
        if first(&pending).is_none() {
            return;
        }
        // Sky by sky.
        let across = self.across(&here, &beside, &under);
        while let Some(l) = first(&pending) {
            let exit = rest[l];
            let wanted = mask(
                #[inline(always)]
                |l| rest[l] == exit,
            );
            if let Some(sky) = &self.world.skies[exit as usize] {
                put(row, &wanted, &sky.lights(&directions, &across, &wanted));
            }
            pending = mask(
                #[inline(always)]
                |l| pending[l] & !wanted[l],
            );
        }
    }

    /// Returns the change of the sky's direction from sample to sample, where those `beside` and `under` are
    /// the next and the one before.
    #[inline(always)]
    fn across(&self, here: &Sixteen, beside: &[Sixteen; 2], under: &[Sixteen; 2]) -> Across {
        let (to_right, right) = changes(here, beside);
        let (downward, down) = changes(here, under);
        let one = single_vector(
            #[inline(always)]
            |l| {
                let round = single_lane(&here.1, l).any_orthonormal_vector() * self.pixel;
                let either = if downward[l] {
                    single_lane(&down, l)
                } else {
                    round
                };
                let one = if to_right[l] {
                    single_lane(&right, l)
                } else {
                    either
                };
                one * self.spacing
            },
        );
        let two = single_vector(
            #[inline(always)]
            |l| {
                // One side alone tells the size, as if the picture were not sheared here.
                let other = single_lane(&here.1, l).cross(single_lane(&one, l));
                let down = single_lane(&down, l) * self.spacing;
                if to_right[l] & downward[l] {
                    down
                } else {
                    other
                }
            },
        );
        [one, two]
    }
}

/// Returns the changes from each lane to the next or, turned round, to the one before, in the lanes where
/// either leaves through the same exit.
#[inline(always)]
fn changes(here: &Sixteen, [next, before]: &[Sixteen; 2]) -> (Mask, SingleVectors) {
    let mut known = [false; LANES];
    let mut changes = SingleVectors::default();
    for l in 0..LANES {
        known[l] = (next.0[l] == here.0[l]) | (before.0[l] == here.0[l]);
    }
    for c in 0..3 {
        let (next_c, here_c, before_c) = (&next.1[c], &here.1[c], &before.1[c]);
        for l in 0..LANES {
            let (ahead, behind) = (next_c[l] - here_c[l], here_c[l] - before_c[l]);
            changes[c][l] = if next.0[l] == here.0[l] {
                ahead
            } else {
                behind
            };
        }
    }
    (known, changes)
}

/// Puts the colours of the lanes that are `wanted` in their places of `row`.
#[inline(always)]
fn put(row: &mut [f32], wanted: &Mask, light: &SingleVectors) {
    for (l, colour) in row.chunks_exact_mut(3).enumerate() {
        if wanted[l] {
            colour.copy_from_slice(&single_lane(light, l).to_array());
        }
    }
}

/// Returns the normal of a hit in the standard frame there, unit, towards the camera.
fn normal(world: &World, hit: &Hit) -> DVec3 {
    let frame = world.manifold.standard_frame(world.point(hit));
    let covector = world.covector(hit);
    let n = (frame.transpose() * covector).normalize_or_zero();
    if covector.dot(hit.v.as_dvec3()) > 0.0 {
        -n
    } else {
        n
    }
}

/// Adds the layers of an EXR file, from the first sample of every pixel: those of what is seen, `area` by exact
/// paths of this `tolerance`, `copy` in a glued space, and `g` where frequencies change.
pub fn with_layers(
    picture: Picture,
    world: &World,
    view: &View,
    (outcomes, flagged): (&Outcomes, &[SamplePlace]),
    tolerance: f64,
) -> Picture {
    let seen = outcomes.view();
    let picture = with_seen(picture, world, seen, flagged);
    let picture = picture.with_float("area", area(world, view, seen, tolerance));
    let picture = match copies(world, view, seen, tolerance) {
        Some(copies) => picture.with_index("copy", copies),
        None => picture,
    };
    if !world.has_redshift(view) {
        return picture;
    }
    let offset = offsets(seen.dim().2)[0];
    picture.with_float("g", redshifts(world, view, outcomes, offset))
}

/// Adds `Z` (arc length), `P` (chart point), `N` (unit normal in the standard frame), `id` (object from 1, 0 for
/// none), `exit` (from 1, 0 for none), `flagged` (1 for those samples).
fn with_seen(
    picture: Picture,
    world: &World,
    outcomes: ArrayView3<'_, Seen>,
    flagged: &[SamplePlace],
) -> Picture {
    let (height, width, _) = outcomes.dim();
    let float = |value: &dyn Fn(&Seen) -> f64| {
        Array2::from_shape_fn((height, width), |(y, x)| value(&outcomes[(y, x, 0)]) as f32)
    };
    let index = |value: &dyn Fn(&Seen) -> usize| {
        Array2::from_shape_fn((height, width), |(y, x)| value(&outcomes[(y, x, 0)]) as u32)
    };
    let vector = |seen: &Seen, of: &dyn Fn(&Hit) -> DVec3, k: usize| match seen {
        Seen::Surface(hit) => of(hit)[k],
        _ => 0.0,
    };
    let arc = |o: &Seen| match *o {
        Seen::Surface(hit) => hit.s.into(),
        Seen::Sky { s, .. } => s.into(),
        Seen::Nothing | Seen::Length | Seen::Singular => f64::INFINITY,
    };
    let object = |o: &Seen| match *o {
        Seen::Surface(hit) => world.faces[hit.triangle as usize].object as usize + 1,
        _ => 0,
    };
    let exit = |o: &Seen| match *o {
        Seen::Sky { exit, .. } => exit as usize + 1,
        _ => 0,
    };
    let mut given_up = Array2::zeros((height, width));
    for (y, x, _) in flagged.iter().filter(|(_, _, sample)| *sample == 0) {
        given_up[(*y, *x)] = 1;
    }
    let mut picture = picture.with_float("Z", float(&arc));
    for (k, axis) in ["X", "Y", "Z"].iter().enumerate() {
        let point = float(&|o| vector(o, &|hit| world.point(hit), k));
        let normal = float(&|o| vector(o, &|hit| normal(world, hit), k));
        picture = picture
            .with_float(format!("P.{axis}"), point)
            .with_float(format!("N.{axis}"), normal);
    }
    picture
        .with_index("id", index(&object))
        .with_index("exit", index(&exit))
        .with_index("flagged", given_up)
}

/// Computes which copy of a glued domain the camera is in as seen from where the first sample of each pixel ends:
/// 0 for none, 1 for the domain itself, else a number that is the same for the same copy in every picture. Each takes
/// an exact path back to where its own began. `None` if nothing is glued.
fn copies(
    world: &World,
    view: &View,
    outcomes: ArrayView3<'_, Seen>,
    tolerance: f64,
) -> Option<Array2<u32>> {
    let gluing = world.manifold.gluing()?;
    let cover = world.lamplight.cover();
    let (height, width, samples) = outcomes.dim();
    let offset = offsets(samples)[0];
    let settings = Settings::bare(tolerance);
    let mut copies = Array2::zeros((height, width));
    copies
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            let hits = (0..width).filter_map(|x| match outcomes[(y, x, 0)] {
                Seen::Surface(hit) => Some((x, hit)),
                _ => None,
            });
            let hits: Vec<(usize, Hit)> = hits.collect();
            let back = hits.iter().map(|(_, hit)| {
                let u = world.point(hit);
                Ray::without_spread(u, -hit.tangent(&world.manifold, u), hit.s.into())
            });
            let ends = ends(&cover, settings, back);
            let points = hits
                .iter()
                .map(|(x, _)| offset + DVec2::new(*x as f64, y as f64));
            let insides = insides_of_starts(world, view, gluing, points);
            for (((x, _), end), inside) in hits.iter().zip(ends).zip(insides) {
                let copy = end.and_then(|(step, s)| gluing.copy_of(step.position(s)));
                row[*x] = copy.map_or(0, |copy| copy_number(copy.point(inside), gluing));
            }
        });
    Some(copies)
}

/// Returns where the point inside of the camera's domain is as seen from the domain in which each ray begins: of a picture that
/// is wider than a point, rays begin beyond glued faces, too.
fn insides_of_starts(
    world: &World,
    view: &View,
    gluing: &Gluing,
    points: impl Iterator<Item = DVec2>,
) -> Vec<DVec3> {
    let inside = |start: Option<RayStart>| {
        let (_, word) = gluing.locate(start?.u)?;
        Some(gluing.way_in(&word)?.point(gluing.inside()))
    };
    let starts = starts(&world.manifold, view, points).into_iter();
    starts
        .map(|start| inside(start).unwrap_or(gluing.inside()))
        .collect()
}

/// Returns the number of the copy of a domain whose point inside has come to `place`.
fn copy_number(place: DVec3, gluing: &Gluing) -> u32 {
    const STEP: f64 = 1e-5;
    let way = place - gluing.inside();
    if way.length() <= STEP * gluing.size() {
        return 1;
    }
    let rounded = (way / (STEP * gluing.size())).round();
    let key = rounded.to_array().map(|x| x as i64 as u64);
    // Whole numbers that single precision has.
    2 + (Stream::new(&key).bits() % ((1 << 24) - 2)) as u32
}

/// Computes the area by which a unit solid angle has spread where the first sample of each pixel ends: an
/// exact path with deviation for each; NaN where nothing is seen.
fn area(world: &World, view: &View, outcomes: ArrayView3<'_, Seen>, tolerance: f64) -> Array2<f32> {
    let (height, width, samples) = outcomes.dim();
    let offset = offsets(samples)[0];
    let settings = Settings::bare(tolerance).with_deviation();
    let manifold = &world.manifold;
    let mut areas = Array2::from_elem((height, width), f32::NAN);
    areas
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            let points = (0..width).map(|x| offset + DVec2::new(x as f64, y as f64));
            let starts = starts(manifold, view, points);
            let rays = starts.into_iter().enumerate().map(|(x, start)| {
                let s = match outcomes[(y, x, 0)] {
                    Seen::Surface(hit) => hit.s.into(),
                    Seen::Sky { s, .. } => s.into(),
                    Seen::Nothing | Seen::Length | Seen::Singular => 0.0,
                };
                match start {
                    Some(start) => Ray::new(manifold, start.u, start.direction, s),
                    None => Ray::new(manifold, view.u, view.look(), 0.0),
                }
            });
            for (slot, end) in row.iter_mut().zip(ends(manifold, settings, rays)) {
                if let Some((step, s)) = end
                    && let Some(columns) = step.deviation(s)
                {
                    let local = manifold.local_frame(step.position(s));
                    *slot = signed_area(&local, step.tangent(s), columns).abs() as f32;
                }
            }
        });
    areas
}

#[cfg(test)]
mod tests;
