//! How the paths of a strip end.
//!
//! In: the events at its nodes. Out: arc length and sky of all as polynomials, or where skies do not turn
//! with paths the state by which they are looked up; and from that the ending of one path.

use super::{FamilyPath, NODES, PLANE, TOLERANCE, transformed};
use crate::{
    curve::Ending,
    endings::{Event, EventLocator},
    strands::{PathView, Source},
};
use geofan_bundle::{PathCoefficients, TablePath};
use glam::DVec3;

/// How all paths of an interval end.
pub(super) enum End {
    Nowhere,
    /// Through the same exit, whose sky turns with them: arc length and the sky's direction.
    Exit(usize, [[f64; 4]; NODES]),
    /// By the same event: its arc length, and the stored plane's point and tangent there.
    Event(usize, [[f64; 1 + PLANE]; NODES]),
}

/// The first event on a path that is known at the knots.
pub(super) fn event(
    path: &TablePath<'_>,
    knots: &[f64],
    rows: &[f64],
    endings: &mut EventLocator<'_>,
) -> Option<Event> {
    let strand = PathView {
        knots,
        direction: DVec3::ZERO,
        rows,
        boxes: &[],
        known: knots.len(),
        ending: None,
        source: (&PathCoefficients::default(), &Source::Knots),
    };
    endings.sharp_event(strand, |s, rows| path.sample_into(s, rows))
}

impl End {
    /// From the events at the nodes, by skies if those turn with paths and can be looked up; `None` if paths
    /// end in different ways.
    pub(super) fn of(
        events: &[Option<Event>],
        skies: Option<&mut EventLocator<'_>>,
    ) -> Option<Self> {
        let kinds = || events.iter().map(|event| event.as_ref().map(|e| e.kind));
        let first = kinds().next()?;
        if kinds().any(|kind| kind != first) {
            return None;
        }
        let Some(kind) = first else {
            return Some(Self::Nowhere);
        };
        let events = events.iter().flatten();
        match skies {
            Some(skies) => Self::by_skies(&events.map(|e| skies.by(e)).collect::<Vec<_>>()),
            None => Self::by_states(kind, events),
        }
    }

    /// From the ends at the nodes.
    fn by_skies(ends: &[Ending]) -> Option<Self> {
        let Some(exit) = ends[0].exit() else {
            return Some(Self::Nowhere);
        };
        let columns = ends.iter().filter_map(|end| match *end {
            Ending::Exit { s, sky, .. } => Some([s, sky.x, sky.y, sky.z]),
            Ending::Nowhere => None,
        });
        let (rows, tails) = expanded(columns);
        let good =
            tails[0] <= TOLERANCE * rows[0][0] && tails[1..].iter().all(|tail| *tail <= TOLERANCE);
        good.then_some(Self::Exit(exit, rows))
    }

    /// From the events at the nodes, all of one kind.
    fn by_states<'e>(kind: usize, events: impl Iterator<Item = &'e Event>) -> Option<Self> {
        let columns = events.map(|e| [e.s, e.u.x, e.u.y, e.v.x, e.v.y]);
        let (rows, tails) = expanded(columns);
        let [s, _, _, vx, vy] = rows[0];
        let speed = vx.hypot(vy);
        let good = tails[0] <= TOLERANCE * s
            && tails[1].max(tails[2]) <= TOLERANCE * s * speed
            && tails[3].max(tails[4]) <= TOLERANCE * speed;
        good.then_some(Self::Event(kind, rows))
    }
}

impl FamilyPath<'_, '_> {
    /// How the path ends; `None` if that has to be looked for.
    pub(crate) fn ending(&self, endings: &mut EventLocator<'_>) -> Option<Ending> {
        Some(match self.strip.end.as_ref()? {
            End::Nowhere => Ending::Nowhere,
            End::Exit(exit, coefficients) => {
                let [s, x, y, z] = self.sum(coefficients);
                Ending::Exit {
                    exit: *exit,
                    s,
                    sky: (self.rotation * DVec3::new(x, y, z)).normalize_or_zero(),
                }
            }
            End::Event(kind, coefficients) => {
                let [s, x, y, vx, vy] = self.sum(coefficients);
                endings.by(&Event {
                    kind: *kind,
                    s,
                    u: self.rotation * DVec3::new(x, y, 0.0),
                    v: self.rotation * DVec3::new(vx, vy, 0.0),
                })
            }
        })
    }
}

/// Coefficients of columns from their values at the nodes, and the largest of the last two of each.
fn expanded<const C: usize>(
    values: impl Iterator<Item = [f64; C]>,
) -> ([[f64; C]; NODES], [f64; C]) {
    let values: Vec<f64> = values.flatten().collect();
    let mut rows = [[0.0; C]; NODES];
    let coefficients = transformed(&values);
    for (to, from) in rows.iter_mut().zip(coefficients.as_chunks::<C>().0) {
        *to = *from;
    }
    let tails = std::array::from_fn(|c| rows[NODES - 1][c].abs().max(rows[NODES - 2][c].abs()));
    (rows, tails)
}
