//! Paths from one camera that a single parameter tells apart, at the knots of a frame.
//!
//! In: a fan whose directions have one parameter (a rotation takes out the other) and knots. Out: for
//! the interval around a direction, made when it is first asked for, the stored plane's points and
//! tangents at all knots and at the path's end as polynomials in the parameter ([`Strip`]): a few dozen
//! sums in place of a patch's rows and Chebyshev sums along the arc. Intervals are halved until the
//! polynomials have converged, which grades them toward photon spheres; patches are halved too, so no
//! interval straddles two.

use super::{
    curve::Ending,
    endings::{EndingFinder, Event},
    strands::{ROWS, Strand},
};
use crate::{
    bundle::{Fan, chebyshev, product},
    expr::vectorised,
    fan::Located,
};
use glam::{DMat3, DVec3};
use std::{
    cell::{Cell, RefCell},
    sync::{Arc, LazyLock, OnceLock},
};

/// Paths along an interval. On the wormhole gallery's near half frames with 6 take a tenth longer (more
/// intervals), with 10 some hundredths (longer sums).
const NODES: usize = 8;

/// What the last two coefficients may be, as an angle at the camera: a small part of any promise, and
/// the next ones are smaller still.
const TOLERANCE: f64 = 1e-5;

/// Intervals are not tried before they have been halved this often, because none so wide converges, and
/// not halved more often, because few paths of a frame are left in one. Chosen, not measured.
const DEPTHS: [u32; 2] = [3, 11];

/// x, y and the tangent's two components: what differs from zero in the stored plane.
const PLANE: usize = 4;

/// Numbers summed at once.
const BLOCK: usize = 16;

/// All paths from one camera.
pub(super) struct Pencil<'f, 't> {
    fan: &'f Fan<'t>,
    knots: Arc<[f64]>,
    faces: Vec<OnceLock<Node>>,
}

/// An interval of the parameter.
enum Node {
    Strip(Box<Strip>),
    Halves(Box<[OnceLock<Node>; 2]>),
    /// Dearer to know than the few paths in it.
    Bare,
}

/// The paths of one interval.
pub(super) struct Strip {
    /// Coefficients, axes (degree, [`PLANE`], knot), each row filled up to whole blocks.
    table: Vec<f32>,
    row: usize,
    end: Option<End>,
}

/// How all paths of an interval end.
enum End {
    Nowhere,
    /// By the same event: its arc length, and the stored plane's point and tangent there.
    Event(usize, Vec<[f64; 1 + PLANE]>),
}

/// A path in its strip.
pub(super) struct Rung<'p> {
    strip: &'p Strip,
    weights: [f64; NODES],
    /// Takes the stored plane to the true one.
    rotation: DMat3,
}

impl<'f, 't> Pencil<'f, 't> {
    /// `None` if directions have two parameters.
    pub(super) fn new(fan: &'f Fan<'t>, knots: &Arc<[f64]>) -> Option<Self> {
        let space = fan.space();
        space.planar().then(|| Self {
            fan,
            knots: knots.clone(),
            faces: (0..space.faces()).map(|_| OnceLock::new()).collect(),
        })
    }

    /// The path of a located ray; `None` where intervals do not pay.
    pub(super) fn rung(
        &self,
        located: &Located,
        endings: &mut EndingFinder<'_>,
    ) -> Option<Rung<'_>> {
        let (face, p) = (located.face, located.direction[0]);
        let (mut node, mut interval) = (&self.faces[face], [-1.0, 1.0]);
        for depth in 0.. {
            let [low, high] = interval;
            let middle = 0.5 * (low + high);
            match node.get_or_init(|| self.node(face, interval, depth, endings)) {
                Node::Bare => break,
                Node::Halves(halves) => {
                    let upper = p >= middle;
                    node = &halves[usize::from(upper)];
                    interval = if upper { [middle, high] } else { [low, middle] };
                }
                Node::Strip(strip) => {
                    let mut weights = [0.0; NODES];
                    chebyshev::values((p - middle) / (0.5 * (high - low)), &mut weights);
                    let rotation = located.isometry.apply(DVec3::ZERO).1;
                    return Some(Rung {
                        strip,
                        weights,
                        rotation,
                    });
                }
            }
        }
        None
    }

    fn node(
        &self,
        face: usize,
        interval: [f64; 2],
        depth: u32,
        endings: &mut EndingFinder<'_>,
    ) -> Node {
        let [least, most] = DEPTHS;
        let strip = match depth >= least {
            true => self.strip(face, interval, endings),
            false => None,
        };
        let ends_alike = self.fan.space().ends_alike();
        match strip {
            Some(strip) if strip.end.is_some() || !ends_alike || depth == most => {
                Node::Strip(Box::new(strip))
            }
            _ if depth < most => Node::Halves(Box::default()),
            _ => Node::Bare,
        }
    }

    /// The paths of an interval; `None` if more would have to be known of them.
    fn strip(
        &self,
        face: usize,
        [low, high]: [f64; 2],
        endings: &mut EndingFinder<'_>,
    ) -> Option<Strip> {
        let n = self.knots.len();
        let mut columns = Vec::with_capacity(NODES * PLANE * n);
        let mut events = Vec::new();
        for x in chebyshev::nodes(NODES) {
            let p = low + 0.5 * (x + 1.0) * (high - low);
            let (rows, event) = self.path(face, p, endings)?;
            for c in [0, 1, 3, 4] {
                columns.extend_from_slice(&rows[c * n..(c + 1) * n]);
            }
            events.push(event);
        }
        let coefficients = transformed(&columns);
        has_converged(&coefficients, &self.knots).then(|| Strip {
            row: n.next_multiple_of(BLOCK),
            table: padded(&coefficients, n),
            end: match self.fan.space().ends_alike() {
                true => End::of(&events),
                false => None,
            },
        })
    }

    /// A path at the knots, and the first event on it; `None` where the table gave up.
    fn path(
        &self,
        face: usize,
        p: f64,
        endings: &mut EndingFinder<'_>,
    ) -> Option<(Vec<f64>, Option<Event>)> {
        let path = self.fan.stored_path(face, [p, 0.0]);
        let mut rows = vec![0.0; ROWS * self.knots.len()];
        let known = path.sample(&self.knots, &mut rows);
        let strand = Strand {
            knots: &self.knots,
            direction: DVec3::ZERO,
            rows: &rows,
            known,
            ending: None,
            source: (&RefCell::default(), &Cell::new(None)),
        };
        let event = endings.sharp_event(strand, |s, rows| path.sample(s, rows));
        (known == self.knots.len()).then_some((rows, event))
    }
}

impl End {
    /// From the events at the nodes; `None` if paths end in different ways.
    fn of(events: &[Option<Event>]) -> Option<Self> {
        let kinds = || events.iter().map(|event| event.as_ref().map(|e| e.kind));
        let first = kinds().next()?;
        if kinds().any(|kind| kind != first) {
            return None;
        }
        let Some(kind) = first else {
            return Some(Self::Nowhere);
        };
        let columns: Vec<f64> = events
            .iter()
            .flatten()
            .flat_map(|e| [e.s, e.u.x, e.u.y, e.v.x, e.v.y])
            .collect();
        let coefficients = transformed(&columns);
        let rows = coefficients.as_chunks::<{ 1 + PLANE }>().0;
        let tail = |c: usize| rows[NODES - 1][c].abs().max(rows[NODES - 2][c].abs());
        let [s, _, _, vx, vy] = rows[0];
        let speed = vx.hypot(vy);
        let good = tail(0) <= TOLERANCE * s
            && tail(1).max(tail(2)) <= TOLERANCE * s * speed
            && tail(3).max(tail(4)) <= TOLERANCE * speed;
        good.then(|| Self::Event(kind, rows.to_vec()))
    }
}

impl Rung<'_> {
    /// Points and tangents at the knots into six rows.
    pub(super) fn fill(&self, rows: &mut [f64]) {
        let n = rows.len() / ROWS;
        vectorised(
            #[inline(always)]
            || {
                for first in (0..n).step_by(BLOCK) {
                    let count = BLOCK.min(n - first);
                    let sums = self.block(first);
                    for c in 0..3 {
                        let (a, b) = (self.rotation.x_axis[c], self.rotation.y_axis[c]);
                        for (row, along, across) in [(c, 0, 1), (3 + c, 2, 3)] {
                            let (x, y) = (&sums[along], &sums[across]);
                            let mut to = [0.0; BLOCK];
                            for l in 0..BLOCK {
                                to[l] = a * f64::from(x[l]) + b * f64::from(y[l]);
                            }
                            rows[row * n + first..][..count].copy_from_slice(&to[..count]);
                        }
                    }
                }
            },
        );
    }

    /// The sums at the knots from `first` on.
    #[inline(always)]
    fn block(&self, first: usize) -> [[f32; BLOCK]; PLANE] {
        let Strip { table, row, .. } = self.strip;
        let mut sums = [[0.0; BLOCK]; PLANE];
        for (lines, weight) in table.chunks_exact(PLANE * row).zip(self.weights) {
            let weight = weight as f32;
            for c in 0..PLANE {
                if let Some(line) = lines[c * row + first..].first_chunk::<BLOCK>() {
                    for l in 0..BLOCK {
                        sums[c][l] += weight * line[l];
                    }
                }
            }
        }
        sums
    }

    /// How the path ends; `None` if that has to be looked for.
    pub(super) fn ending(&self, endings: &mut EndingFinder<'_>) -> Option<Ending> {
        let event = self.event()?;
        Some(event.map_or(Ending::Nowhere, |event| endings.by(&event)))
    }

    /// The event that ends the path: `None` if that has to be looked for, `Some(None)` if there is none.
    fn event(&self) -> Option<Option<Event>> {
        let (kind, coefficients) = match self.strip.end.as_ref()? {
            End::Nowhere => return Some(None),
            End::Event(kind, coefficients) => (*kind, coefficients),
        };
        let mut sums = [0.0; 1 + PLANE];
        for (row, weight) in coefficients.iter().zip(self.weights) {
            for (sum, c) in sums.iter_mut().zip(row) {
                *sum += weight * c;
            }
        }
        let [s, x, y, vx, vy] = sums;
        Some(Some(Event {
            kind,
            s,
            u: self.rotation * DVec3::new(x, y, 0.0),
            v: self.rotation * DVec3::new(vx, vy, 0.0),
        }))
    }
}

/// Columns of coefficients from the columns' values at the nodes, one row for each node.
fn transformed(values: &[f64]) -> Vec<f64> {
    static TRANSFORM: LazyLock<Vec<f64>> =
        LazyLock::new(|| chebyshev::transform(NODES).into_iter().collect());
    product(&TRANSFORM, NODES, values)
}

/// Whether points and tangents at all knots are known within the tolerance.
fn has_converged(coefficients: &[f64], knots: &[f64]) -> bool {
    let n = knots.len();
    let at = |degree: usize, c: usize, k: usize| coefficients[(degree * PLANE + c) * n + k];
    let tail = |c: usize, k: usize| at(NODES - 1, c, k).abs().max(at(NODES - 2, c, k).abs());
    (0..n).all(|k| {
        let speed = at(0, 2, k).hypot(at(0, 3, k));
        let allowed = TOLERANCE * speed;
        // At the camera itself all paths are at one point.
        tail(0, k).max(tail(1, k)) <= allowed * knots[k].max(knots[1])
            && tail(2, k).max(tail(3, k)) <= allowed
    })
}

/// Rows of `n` filled up to whole blocks.
fn padded(coefficients: &[f64], n: usize) -> Vec<f32> {
    let row = n.next_multiple_of(BLOCK);
    let mut table = vec![0.0; coefficients.len() / n * row];
    for (to, from) in table
        .chunks_exact_mut(row)
        .zip(coefficients.chunks_exact(n))
    {
        for (to, from) in to.iter_mut().zip(from) {
            *to = *from as f32;
        }
    }
    table
}
