//! Outcomes to the layers of an EXR file.
//!
//! In: what every sample sees. Out: arc lengths, chart points, normals, numbers of objects, exits and copies
//! of the first sample of every pixel, the area to which a unit solid angle has spread, and frequencies.

use crate::{
    frame::{Outcomes, offsets},
    intersect::{Hit, Seen},
    picture::Picture,
    redshift::redshifts,
    starts::starts,
    tiles::SamplePlace,
    view::View,
    world::World,
};
use geofan_core::parallel::*;
use geofan_core::{
    geodesic::{Ray, Settings, ends, signed_area},
    manifold::{Carried, Gluing},
    random::Stream,
};
use glam::{DVec2, DVec3};
use ndarray::{Array2, ArrayView3, Axis};

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
    let picture = match copies(world, seen, tolerance) {
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
/// an exact path back to the camera. `None` if nothing is glued.
fn copies(world: &World, outcomes: ArrayView3<'_, Seen>, tolerance: f64) -> Option<Array2<u32>> {
    let gluing = world.manifold.gluing()?;
    let cover = world.lamplight.cover();
    let (height, width, _) = outcomes.dim();
    let settings = Settings {
        tolerance,
        carried: Carried::default(),
        events: false,
    };
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
                Ray::without_spread(world.point(hit), -hit.v.as_dvec3(), hit.s.into())
            });
            let ends = ends(&cover, settings, back);
            for ((x, _), end) in hits.iter().zip(ends) {
                let place = end.and_then(|(step, s)| gluing.copy_of(step.position(s)));
                row[*x] = place.map_or(0, |place| copy_number(place, gluing));
            }
        });
    Some(copies)
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
