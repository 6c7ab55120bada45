//! Whether vectors can be carried along a curve: what is looked at before that is done.
//!
//! In: a curve `t -> (u, u̇)` of the chart and an interval of its parameter. Out: its length, or why nothing is carried
//! along it: it leaves the domain, or it jumps. Between the places that are looked at it may still do either.

use super::check_point;
use crate::{Error, Result, manifold::Manifold};
use glam::DVec3;

/// The number of pieces at whose ends a curve is looked at.
const PIECES: usize = 256;

/// The least number of them on one of many curves that are joined.
const LEAST: usize = 4;

/// Halvings by which a jump is told from a kink or a steep part, and the share of the length that is none.
const HALVINGS: usize = 40;
const JUMP: f64 = 1e-6;

/// Refuses a curve that leaves the domain; returns its length by chords. It is one of `joined` curves, which are looked at
/// in about as many places as one alone.
///
/// # Errors
/// [`Error::Input`] about `subject`, with the parameter of a place that is outside of the domain.
pub fn check_inside(
    manifold: &Manifold,
    subject: &str,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    way: [f64; 2],
    joined: usize,
) -> Result<f64> {
    let pieces = (PIECES / joined.max(1)).max(LEAST);
    let mut length = 0.0;
    let mut last: Option<DVec3> = None;
    for i in 0..=pieces {
        let t = place(way, i, pieces);
        let u = curve(t).0;
        check_point(manifold, &format!("{subject} at t = {t}"), u)?;
        if let Some(last) = last {
            length += (manifold.standard_frame(u).inverse() * (u - last)).length();
        }
        last = Some(u);
    }
    Ok(length)
}

/// Refuses a curve that jumps: that goes farther than its velocity takes it, however short the way. `length` is the
/// curve's.
///
/// # Errors
/// [`Error::Input`] about `subject`, with the parameter where it jumps.
pub fn check_jumps(
    manifold: &Manifold,
    subject: &str,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    way: [f64; 2],
    length: f64,
) -> Result<()> {
    let unexplained = |way| unexplained(manifold, &curve, way);
    for i in 0..PIECES {
        let [mut a, mut b] = [i, i + 1].map(|i| place(way, i, PIECES));
        let mut gap = unexplained([a, b]);
        for _ in 0..HALVINGS {
            if gap <= JUMP * length {
                break;
            }
            let middle = 0.5 * (a + b);
            let halves = [[a, middle], [middle, b]].map(unexplained);
            (a, b, gap) = match halves[0] > halves[1] {
                true => (a, middle, halves[0]),
                false => (middle, b, halves[1]),
            };
        }
        if gap > JUMP * length {
            let message = format!("it jumps at t = {a}, and nothing is carried across a jump");
            return Err(Error::input(subject, message));
        }
    }
    Ok(())
}

/// Returns the way from one point to the other's nearest image by whole periods.
pub fn to_nearest_image(manifold: &Manifold, from: DVec3, to: DVec3) -> DVec3 {
    let mut way = to - from;
    for k in 0..3 {
        if let Some(period) = manifold.domain.period(k) {
            way[k] -= period * (way[k] / period).round();
        }
    }
    way
}

/// Returns the parameter of the `i`-th of the places at which a curve is looked at.
fn place([from, to]: [f64; 2], i: usize, pieces: usize) -> f64 {
    from + (to - from) * i as f64 / pieces as f64
}

/// Returns how far the curve gets in the chart other than by its velocity (Gauss's rule of three points, none at an end,
/// where a velocity may be infinite).
fn unexplained(
    manifold: &Manifold,
    curve: &impl Fn(f64) -> (DVec3, DVec3),
    [a, b]: [f64; 2],
) -> f64 {
    let [from, to] = [a, b].map(|t| curve(t).0);
    let off = 0.5 * 0.6_f64.sqrt();
    let nodes = [(0.5 - off, 5.0), (0.5, 8.0), (0.5 + off, 5.0)];
    let velocities = nodes.map(|(share, weight)| curve(a + (b - a) * share).1 * weight);
    let by_velocity = velocities.into_iter().sum::<DVec3>() * ((b - a) / 18.0);
    let gap = (to_nearest_image(manifold, from, to) - by_velocity).length();
    if gap.is_finite() { gap } else { f64::INFINITY }
}
