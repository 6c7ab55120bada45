//! Outcomes to colours.
//!
//! In: what every sample finds. Out: its colour in linear light. Surfaces are lit by
//! baked light or by a lamp at the camera (`lamp`). Skies and textures are averaged over the sample's footprint, measured from the
//! samples beside and below that leave through the same exit or meet the same object.

mod lamp;
mod layers;

pub use layers::{area, with_layers};

use super::{
    footprint::Footprint,
    intersect::Hit,
    outcome::{Outcome, Seen},
    view::View,
    world::World,
};
use glam::{DVec3, Vec3};
use lamp::Lamp;
pub(super) use lamp::diffuse;
use ndarray::{Array4, ArrayView3, Axis};
use rayon::prelude::*;

/// Colours of samples, axes (row, column, sample, channel).
pub type Colours = Array4<f32>;

/// Whether colours are averaged over footprints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Footprints {
    /// Averaged over what a sample stands for.
    Filtered,
    /// Point samples: the measure against which filtering is held.
    Points,
}

/// The colours of `outcomes`, which are a part of `samples` for each pixel.
pub fn shade(
    world: &World,
    view: &View,
    outcomes: ArrayView3<'_, Outcome>,
    samples: usize,
    footprints: Footprints,
) -> Colours {
    let (height, width, count) = outcomes.dim();
    let shader = Shader {
        world,
        view,
        outcomes,
        spacing: match footprints {
            Footprints::Filtered => 1.0 / (samples as f32).sqrt(),
            Footprints::Points => 0.0,
        },
    };
    let mut colours = Colours::zeros((height, width, count, 3));
    colours
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each_init(
            || Lamp::new(world),
            |lamp, (y, mut row)| {
                if let Some(row) = row.as_slice_mut() {
                    shader.row(y, row, lamp);
                }
            },
        );
    colours
}

struct Shader<'a> {
    world: &'a World,
    view: &'a View,
    outcomes: ArrayView3<'a, Outcome>,
    /// The distance of samples, in pixels; 0 asks for points.
    spacing: f32,
}

/// Row, column and number of a sample.
type Place = (usize, usize, usize);

impl Shader<'_> {
    /// The colours of one row, three for each sample.
    fn row(&self, y: usize, row: &mut [f32], lamp: &mut Lamp<'_>) {
        let count = self.outcomes.dim().2;
        for (i, colour) in row.chunks_exact_mut(3).enumerate() {
            let at = (y, i / count, i % count);
            match self.outcomes[at].seen {
                Seen::Surface(hit) => lamp.add(i, hit, self.texture_footprint(at, &hit)),
                Seen::Sky {
                    exit, direction, ..
                } => colour.copy_from_slice(&self.sky(at, exit, direction)),
                Seen::Nothing => colour.copy_from_slice(&self.nothing()),
            }
        }
        lamp.light(row);
    }

    fn sky(&self, at: Place, exit: u32, direction: Vec3) -> [f32; 3] {
        match &self.world.skies[exit as usize] {
            Some(sky) => sky.filtered(direction, &self.sky_footprint(at, exit, direction)),
            None => [0.0; 3],
        }
    }

    fn nothing(&self) -> [f32; 3] {
        match self.world.skies.last() {
            Some(Some(sky)) => sky.filtered(Vec3::Z, &Footprint::POINT),
            _ => [0.0; 3],
        }
    }

    /// How the sky's direction changes from sample to sample: to the pixels beside and below (or
    /// above, before) that leave through the same exit.
    fn sky_footprint(&self, at: Place, exit: u32, direction: Vec3) -> Footprint {
        if self.spacing == 0.0 {
            return Footprint::POINT;
        }
        let change = |axis: usize| {
            self.neighbour(at, axis, |seen| match seen {
                Seen::Sky {
                    exit: other,
                    direction: d,
                    ..
                } if *other == exit => Some(*d - direction),
                _ => None,
            })
        };
        let pixel = self.view.pixel_angle() as f32;
        let across = match (change(0), change(1)) {
            (Some(right), Some(down)) => [right, down],
            // One side alone tells the size, as if the picture were not sheared here.
            (Some(one), None) | (None, Some(one)) => [one, direction.cross(one)],
            (None, None) => Footprint::round(direction, pixel).across,
        };
        Footprint { across }.scaled(self.spacing)
    }

    /// How texture coordinates change from sample to sample; a point without a texture.
    fn texture_footprint(&self, at: Place, hit: &Hit) -> Footprint {
        let face = &self.world.faces[hit.triangle as usize];
        let textured = self.world.materials[face.material as usize]
            .map_kd
            .is_some();
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

    /// What `pick` makes of the same sample of the next pixel along `axis` (0 right, 1 down), else
    /// what it makes of the one before, which is as far on the other side.
    fn neighbour<T: std::ops::Neg<Output = T>>(
        &self,
        (y, x, k): Place,
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
        let at = |place: Option<Place>| place.and_then(|p| pick(&self.outcomes[p].seen));
        at(next).or_else(|| at(before).map(|change| -change))
    }
}

#[cfg(test)]
mod tests;
