//! Which event of the domain comes first: on a stretch of any curve, and on whole curves.
//!
//! In: the events' values at the ends of a stretch, or a curve s -> (u, v). Out: the [`End`] and its
//! arc length. An event counts where its value becomes positive; one that is positive already, because
//! the ray starts beyond it, counts as soon as its value rises.

use super::{End, crossing};
use crate::manifold::Domain;
use glam::DVec3;

/// Number of intervals in which a whole path is searched for events: paths of tables bend over about a hundredth of
/// their length at the least.
const LOOKS: u32 = 256;

/// Returns whether an event with these values at two places is met between them.
#[inline(always)]
pub(super) fn is_met(before: f64, now: f64) -> bool {
    (now > 0.0) & (now > before)
}

/// The first event between the arc lengths `from` and `to`; `ends` gives the values of an event at
/// both, `value` that of an event at an arc length between.
pub(super) fn first_between(
    domain: &Domain,
    [from, to]: [f64; 2],
    ends: impl Fn(usize) -> [f64; 2],
    mut value: impl FnMut(usize, f64) -> f64,
) -> Option<(End, f64)> {
    let mut first: Option<(f64, usize)> = None;
    for k in 0..domain.kinds.len() {
        let [before, now] = ends(k);
        if !is_met(before, now) {
            continue;
        }
        let s = match before > 0.0 {
            true => from,
            false => crossing(from, to, |s| value(k, s)),
        };
        if first.is_none_or(|(earlier, _)| s < earlier) {
            first = Some((s, k));
        }
    }
    first.map(|(s, k)| (End::of_event(domain, domain.kinds[k]), s))
}

/// The first event on a curve s -> (u, v), chart components, for s from 0 to `length`.
pub fn first_event(
    domain: &Domain,
    length: f64,
    curve: impl Fn(f64) -> (DVec3, DVec3),
) -> Option<(End, f64)> {
    if !domain.ends_rays() {
        return None;
    }
    let values = |s: f64| {
        let (u, v) = curve(s);
        domain.events().at(&[u.x, u.y, u.z, v.x, v.y, v.z])
    };
    let place = |i: u32| length * f64::from(i) / f64::from(LOOKS);
    let mut before = values(0.0);
    (0..LOOKS).find_map(|i| {
        let stretch = [place(i), place(i + 1)];
        let now = values(stretch[1]);
        let ends = |k: usize| [before[k], now[k]];
        let first = first_between(domain, stretch, ends, |k, s| values(s)[k]);
        before = now;
        first
    })
}
