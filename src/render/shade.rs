//! Outcomes to colours and layers.
//!
//! In: what every sample finds. Out: a [`Picture`] in linear light, with the layers of DESIGN §5 if
//! wanted. Surfaces are lit by the world's baked light as matt ones (radiance `Kd E / π`); without it
//! by a lamp at the camera: the cosine between the ray and the normal is
//! taken in the metric at the hit, `|n·v| / |Sᵀn|` for a covector `n` and unit tangent `v`. Skies are
//! filtered by the ray's footprint, measured from the neighbouring samples of the same exit.

use super::{
    intersect::Hit,
    outcome::{Outcome, Seen},
    picture::Picture,
    view::View,
    world::World,
};
use crate::{
    geodesic::{Ray, Settings, ends, signed_area},
    manifold::Carried,
};
use glam::DVec3;
use ndarray::{Array2, Array3, ArrayView3, Axis};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// The share of light that reaches surfaces from all sides.
const AMBIENT: f32 = 0.2;

/// Widest footprint that a sky is filtered over, radians: beyond it the neighbours are no guide.
const WIDEST_FOOTPRINT: f64 = 0.5;

/// Outcomes with axes (row, column, sample) as a picture.
pub fn shade(world: &World, view: &View, outcomes: ArrayView3<'_, Outcome>) -> Picture {
    let (height, width, samples) = outcomes.dim();
    let mut rgb = Array3::<f32>::zeros((height, width, 3));
    rgb.outer_iter_mut()
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            for x in 0..width {
                let mut sum = [0.0_f32; 3];
                for k in 0..samples {
                    let colour = colour(world, view, &outcomes, (y, x, k));
                    sum.iter_mut().zip(colour).for_each(|(s, c)| *s += c);
                }
                for c in 0..3 {
                    row[[x, c]] = sum[c] / samples as f32;
                }
            }
        });
    Picture::new(rgb)
}

fn colour(
    world: &World,
    view: &View,
    outcomes: &ArrayView3<'_, Outcome>,
    at: (usize, usize, usize),
) -> [f32; 3] {
    match outcomes[at].seen {
        Seen::Surface(hit) => surface(world, &hit),
        Seen::Sky {
            exit, direction, ..
        } => match &world.skies[exit] {
            Some(sky) => sky.radiance(direction, footprint(view, outcomes, at, exit, direction)),
            None => [0.0; 3],
        },
        Seen::Nothing => match world.skies.last() {
            Some(Some(sky)) => sky.radiance(DVec3::Z, 0.0),
            _ => [0.0; 3],
        },
    }
}

/// The angle of sky that a sample stands for: the larger distance to the same sample of the pixels
/// beside and below (or above, before) that leave through the same exit.
fn footprint(
    view: &View,
    outcomes: &ArrayView3<'_, Outcome>,
    (y, x, k): (usize, usize, usize),
    exit: usize,
    direction: DVec3,
) -> f32 {
    let (height, width, samples) = outcomes.dim();
    let distance = |y: usize, x: usize| match outcomes[(y, x, k)].seen {
        Seen::Sky {
            exit: other,
            direction: d,
            ..
        } if other == exit => Some((d - direction).length()),
        _ => None,
    };
    let either = |forward: Option<f64>, back: Option<f64>| forward.or(back);
    let across = either(
        (x + 1 < width).then(|| distance(y, x + 1)).flatten(),
        x.checked_sub(1).and_then(|x| distance(y, x)),
    );
    let down = either(
        (y + 1 < height).then(|| distance(y + 1, x)).flatten(),
        y.checked_sub(1).and_then(|y| distance(y, x)),
    );
    let widest = across.into_iter().chain(down).fold(0.0, f64::max);
    let angle = if widest > 0.0 {
        widest
    } else {
        view.pixel_angle()
    };
    (angle.min(WIDEST_FOOTPRINT) / (samples as f64).sqrt()) as f32
}

/// The normal of a hit in the standard frame there, unit, towards the camera; the cosine; and whether
/// the camera is on the side to which the mesh's normal points.
fn normal(world: &World, hit: &Hit) -> (DVec3, f64, bool) {
    let face = &world.faces[hit.triangle as usize];
    let (b, c) = hit.barycentric;
    let covector = face.normals[0] * (1.0 - b - c) + face.normals[1] * b + face.normals[2] * c;
    let frame = world.manifold.standard_frame(hit.u);
    let n = (frame.transpose() * covector).normalize_or_zero();
    let v = (frame.inverse() * hit.v).normalize_or_zero();
    let cosine = -n.dot(v);
    let front = cosine >= 0.0;
    (if front { n } else { -n }, cosine.abs(), front)
}

/// The diffuse reflectance of what was hit: `Kd`, times its texture.
pub(super) fn diffuse(world: &World, hit: &Hit) -> [f32; 3] {
    let face = &world.faces[hit.triangle as usize];
    let material = &world.materials[face.material as usize];
    let (b, c) = (hit.barycentric.0 as f32, hit.barycentric.1 as f32);
    let uv = |k: usize| face.uvs[0][k] * (1.0 - b - c) + face.uvs[1][k] * b + face.uvs[2][k] * c;
    match &material.map_kd {
        Some(texture) => {
            let colour = texture.sample(f64::from(uv(0)), f64::from(uv(1)));
            std::array::from_fn(|k| colour[k] * material.kd[k])
        }
        None => material.kd,
    }
}

fn surface(world: &World, hit: &Hit) -> [f32; 3] {
    let face = &world.faces[hit.triangle as usize];
    let material = &world.materials[face.material as usize];
    let (_, cosine, front) = normal(world, hit);
    let diffuse = diffuse(world, hit);
    if let Some(light) = &world.light {
        let light = light.at(hit.triangle, hit.barycentric, front);
        return std::array::from_fn(|k| diffuse[k] * light[k] * FRAC_1_PI + material.ke[k]);
    }
    // The lamp is at the eye: the mirror direction makes twice the angle of incidence with it.
    let mirrored = (2.0 * cosine * cosine - 1.0).max(0.0) as f32;
    let gloss = mirrored.powf(material.ns.max(1.0));
    let light = AMBIENT + (1.0 - AMBIENT) * cosine as f32;
    std::array::from_fn(|k| diffuse[k] * light + 0.3 * material.ks[k] * gloss + material.ke[k])
}

/// Adds the layers of DESIGN §5 except `area`, from the first sample of every pixel: `Z` (arc
/// length), `P` (chart point), `N` (unit normal in the standard frame), `id` (object from 1, 0 for
/// none), `exit` (from 1, 0 for none), `flagged`.
pub fn with_layers(picture: Picture, world: &World, outcomes: ArrayView3<'_, Outcome>) -> Picture {
    let (height, width, _) = outcomes.dim();
    let float = |value: &dyn Fn(&Outcome) -> f64| {
        Array2::from_shape_fn((height, width), |(y, x)| value(&outcomes[(y, x, 0)]) as f32)
    };
    let index = |value: &dyn Fn(&Outcome) -> usize| {
        Array2::from_shape_fn((height, width), |(y, x)| value(&outcomes[(y, x, 0)]) as u32)
    };
    let vector = |outcome: &Outcome, of: &dyn Fn(&Hit) -> DVec3, k: usize| match &outcome.seen {
        Seen::Surface(hit) => of(hit)[k],
        _ => 0.0,
    };
    let arc = |o: &Outcome| match o.seen {
        Seen::Surface(hit) => hit.s,
        Seen::Sky { s, .. } => s,
        Seen::Nothing => f64::INFINITY,
    };
    let object = |o: &Outcome| match o.seen {
        Seen::Surface(hit) => world.faces[hit.triangle as usize].object as usize + 1,
        _ => 0,
    };
    let exit = |o: &Outcome| match o.seen {
        Seen::Sky { exit, .. } => exit + 1,
        _ => 0,
    };
    let mut picture = picture.with_float("Z", float(&arc));
    for (k, axis) in ["X", "Y", "Z"].iter().enumerate() {
        let point = float(&|o| vector(o, &|hit| hit.u, k));
        let normal = float(&|o| vector(o, &|hit| normal(world, hit).0, k));
        picture = picture
            .with_float(format!("P.{axis}"), point)
            .with_float(format!("N.{axis}"), normal);
    }
    picture
        .with_index("id", index(&object))
        .with_index("exit", index(&exit))
        .with_index("flagged", index(&|o| usize::from(o.flagged)))
}

/// Area by which a unit solid angle has spread where the first sample of each pixel ends: an exact
/// path with deviation for each; NaN where nothing is seen.
pub fn area(
    world: &World,
    view: &View,
    outcomes: ArrayView3<'_, Outcome>,
    tolerance: f64,
) -> Array2<f32> {
    let (height, width, samples) = outcomes.dim();
    let offset = super::frame::offsets(samples)[0];
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: false,
            deviation: true,
        },
        events: false,
    };
    let manifold = &world.manifold;
    let mut areas = Array2::from_elem((height, width), f32::NAN);
    areas
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            let rays = (0..width).map(|x| {
                let s = match outcomes[(y, x, 0)].seen {
                    Seen::Surface(hit) => hit.s,
                    Seen::Sky { s, .. } => s,
                    Seen::Nothing => 0.0,
                };
                let d = view.direction(x as f64 + offset.x, y as f64 + offset.y);
                Ray::new(manifold, view.u, d, s)
            });
            for (slot, end) in row.iter_mut().zip(ends(manifold, settings, rays)) {
                if let Some((step, s)) = end
                    && let Some(columns) = step.deviation(s)
                {
                    let inverse = manifold.standard_frame(step.position(s)).inverse();
                    *slot = signed_area(inverse, step.tangent(s), columns).abs() as f32;
                }
            }
        });
    areas
}
