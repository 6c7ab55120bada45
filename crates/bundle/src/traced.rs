//! One path from the table, ended where its ray leaves, or looked up again where the table ends.
//!
//! In: a [`Table`], a camera position, a direction, a length. Out: a [`Traced`]: equally spaced
//! samples up to the end of the path, which is found on the interpolated path. A ray of which the
//! table gives up a part before its end is integrated exactly. In a glued space the table has paths of the cover;
//! samples are brought back into the domain.
//!
//! Beyond the table's length a path of a glued space goes on with the fan of where it has come to, if the table's
//! cameras are there ([`Table::restarted`]): of a space whose domain is in the region of cameras, a short table has
//! paths of any length. A part's points are as far off as the table promises, as seen from where the part begins;
//! its first direction is off by what the tangent at the end of the part before is. Along a path these add up.

use crate::{Fan, LookupError, Table, TablePath};
use geofan_core::{
    error::Result,
    geodesic::{End, Ray, Sample, Settings, first_event, paths_beside_poles},
    manifold::{Development, Manifold},
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
    /// How often it was looked up again where the table ends.
    pub restarts: usize,
    /// Set if the path was integrated, because its patch is flagged.
    pub exact: bool,
    /// Set if it was turned, then, to pass a pole of the chart ([`paths_beside_poles`]).
    pub turned: bool,
}

/// The path from `u` in the direction `d` (standard frame, unit) over at most `length`, as `count`
/// samples; `tolerance` is that of the exact tracer if it is needed.
///
/// In a glued space it may be longer than the table's paths: it is looked up again where these end.
///
/// # Errors
/// `u`, or a point where the path is looked up again, is not in the camera region, or the patches there are damaged.
pub fn trace(
    table: &Table,
    u: DVec3,
    d: DVec3,
    length: f64,
    count: usize,
    tolerance: f64,
) -> Result<Traced> {
    let fan = table.fan(u)?;
    if length <= table.length || !table.restarts() {
        return Ok(trace_in(&fan, d, length, count, tolerance));
    }
    let manifold = &*table.space.manifold().glued();
    let exactly = || exactly(manifold, u, d, length, count, tolerance);
    Ok(trace_on(fan, d, length, count)?.unwrap_or_else(exactly))
}

/// Does the same in a fan at hand, within the table's length.
pub fn trace_in(fan: &Fan, d: DVec3, length: f64, count: usize, tolerance: f64) -> Traced {
    let manifold = &*fan.space().manifold().glued();
    let path = fan.path(d);
    match known_end(manifold, &path, length) {
        None => exactly(manifold, fan.place.u, d, length, count, tolerance),
        Some((end, length)) => Traced {
            samples: samples_of(manifold, &path, places(length, count)),
            end,
            length,
            steps: 0,
            restarts: 0,
            exact: false,
            turned: false,
        },
    }
}

/// Finds how a path ends and where, at `length` at the latest; `None` where its table does not know that.
fn known_end(manifold: &Manifold, path: &TablePath<'_>, length: f64) -> Option<(End, f64)> {
    let event = match manifold.gluing() {
        None => path.first_event(length),
        // Which way a path goes on at a portal or a mirror, the cover does not know.
        Some(gluing) if !gluing.follows_cover() => return None,
        Some(_) => first_event(&manifold.domain, length, |s| {
            let (u, v) = path.at(s).unwrap_or((DVec3::NAN, DVec3::NAN));
            let state = manifold.brought_in(u, v);
            state.map_or((u, v), |(u, v, _)| (u, v))
        }),
    };
    // A flagged part is only reached where nothing ends the ray before it.
    match event {
        None if path.flagged_from() < length => None,
        found => Some(found.unwrap_or((End::Length, length))),
    }
}

/// Spaces `count` places evenly from 0 to `length`.
fn places(length: f64, count: usize) -> impl Iterator<Item = f64> {
    let last = count.max(2) - 1;
    (0..=last).map(move |i| length * (i as f64 / last as f64))
}

/// A part of a path, from one look-up to the next.
struct TracedPart {
    fan: Fan,
    direction: DVec3,
    /// Where it begins on the whole path, and the sample there.
    from: f64,
    start: Option<Sample>,
}

impl TracedPart {
    /// Makes the samples at these places of the whole path.
    fn samples(&self, manifold: &Manifold, places: impl Iterator<Item = f64>) -> Vec<Sample> {
        let path = self.fan.path(self.direction);
        let places = places.map(|s| (s - self.from).max(0.0));
        let mut samples = samples_of(manifold, &path, places);
        for sample in &mut samples {
            sample.s += self.from;
            let Some(start) = &self.start else { continue };
            let into = manifold.standard_frame(start.u).inverse();
            let carried = sample.frame.zip(start.frame);
            sample.frame = carried.map(|(frame, before)| frame * into * before);
            sample.crossings += start.crossings;
            sample.reversed ^= start.reversed;
        }
        samples
    }
}

/// Traces a path of a glued space farther than its table reaches, by look-ups from where it has come to; `None` where
/// a table gives up on it.
fn trace_on(fan: Fan, direction: DVec3, length: f64, count: usize) -> Result<Option<Traced>> {
    let table = fan.table.clone();
    let (manifold, reach) = (&*table.space.manifold().glued(), table.length);
    let mut parts = vec![TracedPart {
        fan,
        direction,
        from: 0.0,
        start: None,
    }];
    let (end, length) = loop {
        let part = &parts[parts.len() - 1];
        let rest = length - part.from;
        let path = part.fan.path(part.direction);
        let Some((end, s)) = known_end(manifold, &path, rest.min(reach)) else {
            return Ok(None);
        };
        if end != End::Length || rest <= reach {
            break (end, part.from + s);
        }
        let from = part.from + reach;
        let Some(start) = part.samples(manifold, std::iter::once(from)).pop() else {
            return Ok(None);
        };
        let (fan, direction) = table.restarted(start.u, start.v)?;
        parts.push(TracedPart {
            fan,
            direction,
            from,
            start: Some(start),
        });
    };
    let all: Vec<f64> = places(length, count).collect();
    let ends = parts.iter().skip(1).map(|part| part.from);
    let ends: Vec<f64> = ends.chain([f64::INFINITY]).collect();
    let of_part = |(part, until): (&TracedPart, &f64)| {
        let own = all.iter().filter(|s| (part.from..*until).contains(s));
        part.samples(manifold, own.copied())
    };
    Ok(Some(Traced {
        samples: parts.iter().zip(&ends).flat_map(of_part).collect(),
        end,
        length,
        steps: 0,
        restarts: parts.len() - 1,
        exact: false,
        turned: false,
    }))
}

/// Places on a path of a glued space at which its crossings are looked for, on the way to each sample.
const LOOKS: usize = 64;

fn samples_of(
    manifold: &Manifold,
    path: &TablePath<'_>,
    places: impl Iterator<Item = f64>,
) -> Vec<Sample> {
    let mut way = manifold.gluing().map(Development::new);
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
    let settings = Settings::bare(tolerance).with_frame().with_events();
    let ray = Ray::new(manifold, u, d, length);
    let followed = paths_beside_poles(manifold, settings, &[ray]).remove(0);
    let mut samples = followed.samples(manifold, count);
    samples.iter_mut().for_each(|sample| sample.area = None);
    Traced {
        samples,
        end: followed.path.end,
        length: followed.path.length,
        steps: followed.path.tried,
        restarts: 0,
        exact: true,
        turned: followed.ray.v != ray.v,
    }
}

impl Table {
    /// Tells whether paths can be looked up again where the table ends: in glued spaces whose paths the cover knows.
    pub fn restarts(&self) -> bool {
        let gluing = self.space.manifold().gluing_below();
        gluing.is_some_and(|gluing| gluing.follows_cover())
    }

    /// Looks up where the path that has come to the point `u` of the domain with the tangent `v` goes on: in the fan of all
    /// paths from there, in this direction (standard frame, unit).
    ///
    /// # Errors
    /// `u` is not in the camera region, or the patches there are damaged.
    pub fn restarted(&self, u: DVec3, v: DVec3) -> Result<(Fan, DVec3), LookupError> {
        let fan = self.fan(u)?;
        let direction = self.space.manifold().local_frame(u).direction(v);
        Ok((fan, direction.normalize_or_zero()))
    }
}
