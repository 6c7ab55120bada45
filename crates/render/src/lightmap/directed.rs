//! Light at points of surfaces with the directions that it comes from, which gloss asks for.
//!
//! In: the light of each image of a lamp at each point. Out: the same between three points, image by image; and bytes.
//! Little-endian: the number of images at each point (u32), then for each image twice the number of its lamp, and one more
//! on the front (u32), its tangent and its irradiance (three f32 each). No bytes are no light.

use glam::{DMat3, DVec3, Vec3};

/// The light of one image of a lamp at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectedLight {
    /// The number of the lamp.
    pub lamp: u32,
    /// Set if it falls on the side to which the normal points.
    pub front: bool,
    /// The tangent of the light's path at the point, chart components.
    pub v: Vec3,
    /// Irradiance, red, green and blue.
    pub irradiance: [f32; 3],
}

/// The light of all images at all points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DirectedLights {
    /// Where the images of each point end in the list of all.
    ends: Vec<u32>,
    all: Vec<DirectedLight>,
}

/// The light of one image of a lamp between points.
#[derive(Debug, Clone, Copy)]
pub struct LampImage {
    lamp: u32,
    /// The corners that have it, one bit each.
    corners: u8,
    /// Where its light comes from at the first of them, and its weighted sum over all; in the surface's frame.
    first: DVec3,
    towards: DVec3,
    /// Irradiance.
    irradiance: DVec3,
}

impl LampImage {
    /// Returns where its light comes from, in the surface's frame; unit.
    pub fn towards(&self) -> DVec3 {
        self.towards.normalize_or_zero()
    }

    /// Returns the irradiance that it brings.
    pub fn irradiance(&self) -> DVec3 {
        self.irradiance
    }
}

/// Images of a lamp at two points are taken for the same if the cosine between them is at least this: the facets between
/// points are small beside the distance of most lamps.
const ALIKE: f64 = 0.5;

/// Bytes of an image.
const IMAGE: usize = 28;

impl DirectedLights {
    /// Adds a point with these images.
    pub fn push(&mut self, images: Vec<DirectedLight>) {
        self.all.extend(images);
        self.ends.push(self.all.len() as u32);
    }

    /// Tells whether there is no light.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns the number of points.
    pub fn points(&self) -> usize {
        self.ends.len()
    }

    /// Returns the images at a point; none if nothing is known there.
    fn at(&self, point: u32) -> &[DirectedLight] {
        let point = point as usize;
        let start = point.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.all[start as usize..self.ends[point] as usize]
    }

    /// Puts the images between three points with their weights into `images`: those that fall on the asked side of a surface
    /// with the `inverse` of its frame, which moves by `pace` (chart components) for each unit of arc length.
    pub fn between(
        &self,
        (corners, weights): ([u32; 3], [f32; 3]),
        front: bool,
        (inverse, pace): (DMat3, DVec3),
        images: &mut Vec<LampImage>,
    ) {
        images.clear();
        for (k, (corner, weight)) in corners.into_iter().zip(weights).enumerate() {
            for light in self.at(corner).iter().filter(|light| light.front == front) {
                // Lines of sight run against the light.
                let towards = -(inverse * (light.v.as_dvec3() + pace)).normalize_or_zero();
                let weight = f64::from(weight);
                let irradiance = DVec3::from_array(light.irradiance.map(f64::from)) * weight;
                let image = image_of(images, (light.lamp, k), towards);
                image.corners |= 1 << k;
                image.towards += towards * weight;
                image.irradiance += irradiance;
            }
        }
    }

    /// Writes it down.
    pub fn to_bytes(&self) -> Vec<u8> {
        if self.is_empty() {
            return Vec::new();
        }
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        let counts = self.ends.iter().zip(starts).map(|(end, start)| end - start);
        let mut bytes: Vec<u8> = counts.flat_map(u32::to_le_bytes).collect();
        for light in &self.all {
            bytes.extend((2 * light.lamp + u32::from(light.front)).to_le_bytes());
            let numbers = light.v.to_array().into_iter().chain(light.irradiance);
            bytes.extend(numbers.flat_map(f32::to_le_bytes));
        }
        bytes
    }

    /// Reads what [`Self::to_bytes`] wrote of so many points; `None` if the bytes are not that.
    pub fn from_bytes(bytes: &[u8], points: usize) -> Option<Self> {
        if bytes.is_empty() {
            return Some(Self::default());
        }
        let (counts, rest) = bytes.split_at_checked(points.checked_mul(4)?)?;
        let mut read = Self::default();
        let mut end = 0_u32;
        for count in counts.as_chunks::<4>().0 {
            end = end.checked_add(u32::from_le_bytes(*count))?;
            read.ends.push(end);
        }
        let (images, []) = rest.as_chunks::<IMAGE>() else {
            return None;
        };
        read.all = images.iter().map(image_from).collect();
        (read.all.len() == end as usize).then_some(read)
    }
}

/// Reads an image.
fn image_from(bytes: &[u8; IMAGE]) -> DirectedLight {
    let word = |k: usize| -> [u8; 4] { std::array::from_fn(|i| bytes[4 * k + i]) };
    let number = |k: usize| f32::from_le_bytes(word(k));
    let told = u32::from_le_bytes(word(0));
    DirectedLight {
        lamp: told / 2,
        front: told % 2 == 1,
        v: Vec3::new(number(1), number(2), number(3)),
        irradiance: [number(4), number(5), number(6)],
    }
}

/// Returns the image of a lamp at a corner in a direction: the most like it of those that other corners have, else a new one.
fn image_of(
    images: &mut Vec<LampImage>,
    (lamp, corner): (u32, usize),
    towards: DVec3,
) -> &mut LampImage {
    let like = |image: &LampImage| image.first.dot(towards);
    let fits = |image: &LampImage| {
        image.lamp == lamp && image.corners & (1 << corner) == 0 && like(image) >= ALIKE
    };
    let known = (0..images.len()).filter(|i| fits(&images[*i]));
    let best = known.max_by(|i, j| like(&images[*i]).total_cmp(&like(&images[*j])));
    let at = best.unwrap_or_else(|| {
        images.push(LampImage {
            lamp,
            corners: 0,
            first: towards,
            towards: DVec3::ZERO,
            irradiance: DVec3::ZERO,
        });
        images.len() - 1
    });
    &mut images[at]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(lamp: u32, v: [f32; 3], red: f32) -> DirectedLight {
        DirectedLight {
            lamp,
            front: red > 1.0,
            v: Vec3::from_array(v).normalize(),
            irradiance: [red, 1.0, 0.5],
        }
    }

    fn lights() -> DirectedLights {
        let mut lights = DirectedLights::default();
        lights.push(vec![
            light(0, [0.0, 0.1, -1.0], 2.0),
            light(0, [1.0, 0.0, -0.3], 4.0),
        ]);
        lights.push(vec![
            light(0, [1.0, 0.1, -0.3], 6.0),
            light(0, [0.0, -0.1, -1.0], 8.0),
        ]);
        lights.push(vec![
            light(3, [0.0, 0.0, -1.0], 1.5),
            light(3, [0.0, 0.0, 1.0], 0.5),
        ]);
        lights
    }

    #[test]
    fn images_of_a_lamp_are_told_apart_by_where_they_are() {
        let mut images = Vec::new();
        let places = ([0, 1, 2], [0.25, 0.25, 0.5]);
        let rest = (DMat3::IDENTITY, DVec3::ZERO);
        lights().between(places, true, rest, &mut images);
        let found: Vec<f64> = images.iter().map(|image| image.irradiance().x).collect();
        assert_eq!(found, [0.25 * 10.0, 0.25 * 10.0, 0.75]);
        assert!((images[0].towards() - DVec3::Z).length() < 1e-6);
        lights().between(places, false, rest, &mut images);
        assert_eq!(images.len(), 1);
        assert!((images[0].towards() + DVec3::Z).length() < 1e-6);
    }

    #[test]
    fn light_comes_back_from_its_bytes_and_others_are_refused() {
        let bytes = lights().to_bytes();
        assert_eq!(DirectedLights::from_bytes(&bytes, 3), Some(lights()));
        assert_eq!(
            DirectedLights::from_bytes(&[], 3),
            Some(DirectedLights::default())
        );
        for (length, points) in [
            (bytes.len() - 1, 3),
            (bytes.len() - 28, 3),
            (bytes.len(), 2),
            (3, 3),
        ] {
            assert_eq!(DirectedLights::from_bytes(&bytes[..length], points), None);
        }
    }
}
