//! Where a curve of any kind meets its first event: interpolated paths end by this.
//!
//! In: a curve s -> (u, v). Out: the [`End`] and its arc length. As for integrated rays, an event
//! that is positive at the start counts only once its value rises.

use super::{End, crossing};
use crate::manifold::Domain;
use glam::DVec3;

/// How often a whole path is looked at for events: paths of tables bend over about a hundredth of
/// their length at the least.
const LOOKS: u32 = 256;

/// The first event on a curve s -> (u, v), chart components, for s from 0 to `length`.
pub fn first_event(
    domain: &Domain,
    length: f64,
    curve: impl Fn(f64) -> (DVec3, DVec3),
) -> Option<(End, f64)> {
    if domain.kinds.is_empty() {
        return None;
    }
    let values = |s: f64| {
        let (u, v) = curve(s);
        domain.events().at(&[u.x, u.y, u.z, v.x, v.y, v.z])
    };
    let place = |i: u32| length * f64::from(i) / f64::from(LOOKS);
    let mut before = values(0.0);
    for i in 0..LOOKS {
        let (from, to) = (place(i), place(i + 1));
        let now = values(to);
        let hits = (0..now.len()).filter(|&k| now[k] > before[k].max(0.0));
        let places = hits.map(|k| match before[k] > 0.0 {
            true => (from, k),
            false => (crossing(from, to, |s| values(s)[k]), k),
        });
        if let Some((s, k)) = places.min_by(|a, b| a.0.total_cmp(&b.0)) {
            return Some((End::of_event(domain, domain.kinds[k]), s));
        }
        before = now;
    }
    None
}
