//! Outcomes to colours.
//!
//! In: what every sample sees. Out: its colour in linear light. Surfaces are lit by baked light or
//! by a lamp at the camera (`lamp`). Skies (`skies`) and textures are averaged over the sample's
//! footprint, measured from the samples beside and below that leave through the same exit or meet
//! the same object.

pub mod gloss;
mod lamp;
mod layers;
mod skies;

pub use gloss::{Reflectances, is_glossy, is_glossy_triangle};
pub use layers::with_layers;

use super::{
    filter::Footprint,
    intersect::{Hit, Seen},
    tiles::SamplePlace,
    view::View,
    world::World,
};
use geofan_core::parallel::*;
use glam::{DVec3, Vec3};
use lamp::Lamp;
pub use lamp::{diffuse, emission};
use ndarray::{Array4, ArrayView3, Axis};
use skies::SkyRow;

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
        let here = self.world.point(hit);
        let change = |axis: usize| -> Vec3 {
            let way: Option<DVec3> = self.neighbour(at, axis, |seen| match seen {
                Seen::Surface(other)
                    if self.world.faces[other.triangle as usize].object == face.object =>
                {
                    Some(self.world.point(other) - here)
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

#[cfg(test)]
mod tests;
