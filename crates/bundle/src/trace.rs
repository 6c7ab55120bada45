//! One path from the table, ended where its ray leaves.
//!
//! In: a [`Table`], a camera position, a direction, a length. Out: a [`Traced`]: equally spaced
//! samples up to the end of the path, which is found on the interpolated path. A ray of which the
//! table gives up a part before its end is integrated exactly. In a glued space the table has paths of the cover;
//! samples are brought back into the domain.

use crate::{Fan, Table, TablePath};
use geofan_core::{
    error::Result,
    geodesic::{End, Ray, Sample, Settings, first_event, paths, samples},
    manifold::{Carried, Development, Manifold},
};
use glam::{DMat3, DVec3};

/// A path read from a table.
#[derive(Debug, Clone)]
pub struct Traced {
    /// From arc length 0 to the end, both included; without area.
    pub samples: Vec<Sample>,
    /// The reason of its end.
    pub end: End,
    /// The arc length at which it ended.
    pub length: f64,
    /// Steps integrated; none if the table has the whole path.
    pub steps: usize,
    /// Set if the path was integrated, because its patch is flagged.
    pub exact: bool,
}

/// The path from `u` in the direction `d` (standard frame, unit) over at most `length`, as `count`
/// samples; `tolerance` is that of the exact tracer if it is needed.
///
/// # Errors
/// `u` is not in the camera region, or the patches there are damaged.
pub fn trace(
    table: &Table,
    u: DVec3,
    d: DVec3,
    length: f64,
    count: usize,
    tolerance: f64,
) -> Result<Traced> {
    Ok(trace_in(&table.fan(u)?, d, length, count, tolerance))
}

/// Does the same in a fan at hand.
pub fn trace_in(fan: &Fan, d: DVec3, length: f64, count: usize, tolerance: f64) -> Traced {
    let (manifold, u) = (&*fan.space().manifold().glued(), fan.place.u);
    let path = fan.path(d);
    let event = match manifold.gluing() {
        None => path.first_event(length),
        // Which way a path goes on at a portal or a mirror, the cover does not know.
        Some(gluing) if gluing.has_portals() || gluing.has_mirrors() => {
            return exactly(manifold, u, d, length, count, tolerance);
        }
        Some(_) => first_event(&manifold.domain, length, |s| {
            let (u, v) = path.at(s).unwrap_or((DVec3::NAN, DVec3::NAN));
            let state = manifold.brought_in(u, v);
            state.map_or((u, v), |(u, v, _)| (u, v))
        }),
    };
    // A flagged part is only reached where nothing ends the ray before it.
    if event.is_none() && path.flagged_from() < length {
        return exactly(manifold, u, d, length, count, tolerance);
    }
    let (end, length) = event.unwrap_or((End::Length, length));
    let last = count.max(2) - 1;
    let places = (0..=last).map(|i| length * (i as f64 / last as f64));
    Traced {
        samples: samples_of(manifold, &path, places),
        end,
        length,
        steps: 0,
        exact: false,
    }
}

/// Places on a path of a glued space at which its crossings are looked for, on the way to each sample.
const LOOKS: usize = 64;

fn samples_of(
    manifold: &Manifold,
    path: &TablePath<'_>,
    places: impl Iterator<Item = f64>,
) -> Vec<Sample> {
    let mut way = manifold.gluing().and_then(Development::new);
    let mut before = 0.0;
    let mut samples = Vec::new();
    for s in places {
        if let Some(way) = &mut way {
            for k in 1..=LOOKS {
                let at = before + (s - before) * k as f64 / LOOKS as f64;
                path.at(at).and_then(|(u, _)| way.advance(u));
            }
        }
        before = s;
        let word = way.as_ref().map_or(&[][..], |way| way.crossed());
        samples.extend(at(manifold, path, s, word));
    }
    samples
}

/// Makes a sample, brought back through the faces of `word`.
fn at(manifold: &Manifold, path: &TablePath<'_>, s: f64, word: &[usize]) -> Option<Sample> {
    let (cover, v) = path.at(s)?;
    let cover = manifold.domain.wrap(cover);
    let (u, v) = manifold.carried_through(word, (cover, v))?;
    let local = manifold.local_frame(u);
    let turned = |q| {
        let axes = local.frame * DMat3::from_quat(q);
        match manifold.gluing().filter(|_| !word.is_empty()) {
            None => axes,
            Some(gluing) => gluing.carried(
                word,
                cover,
                manifold.standard_frame(cover) * DMat3::from_quat(q),
            ),
        }
    };
    Some(Sample {
        s,
        u,
        v: local.restored(manifold.metric(u), v),
        frame: path.rotation(s).map(turned),
        area: None,
        crossings: word.len() as u32,
        reversed: manifold
            .gluing()
            .is_some_and(|gluing| gluing.reverses(word)),
    })
}

fn exactly(
    manifold: &Manifold,
    u: DVec3,
    d: DVec3,
    length: f64,
    count: usize,
    tolerance: f64,
) -> Traced {
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: true,
            deviation: false,
        },
        events: true,
    };
    let ray = Ray::new(manifold, u, d, length);
    let path = paths(manifold, settings, [ray]).remove(0);
    let mut samples = samples(manifold, &ray, &path, count);
    samples.iter_mut().for_each(|sample| sample.area = None);
    Traced {
        samples,
        end: path.end,
        length: path.length,
        steps: path.tried,
        exact: true,
    }
}
