//! Places at which a curve meets surfaces where the metric switches, and the turn of frames over edges there.
//!
//! In: a manifold and a curve `s -> (u, du/ds)` with `s`, the share of the way, in [0, 1]. Out: its [`CurveCrossing`]s, in
//! order, or the [`RefusedEdge`] over which nothing can be carried.
//!
//! Across an edge `φ(u) = 0` the metric jumps from `G₁` to `G₂`. Transport over it is the limit of transport over soft
//! edges, as far as that does not depend on their profile: it does not in two cases.
//!
//! - `G₂ = n² G₁`: with `∇_v w = D_v w + df(v) w + df(w) v − G₁(v, w) grad f` for the metric `e^{2f} G₁` the turn is
//!   `ln n (t × ν) / (t·ν)`, with the tangent `t` of the curve and the normal `ν` of the edge, in the standard frame.
//! - Both metrics agree along the edge, as where an embedding is folded: vectors along the edge stay what they are, and
//!   the unit normal becomes the unit normal.

use super::{
    domain_events::crossing,
    refraction::metrics_differ,
    switching::{ASIDE, GRAZING},
};
use crate::manifold::Manifold;
use geofan_expr::{Registers, Tape};
use glam::{DMat3, DQuat, DVec3};

/// The farthest from a surface (share of the way) that its sides are looked at, where a curve stands still.
const FARTHEST: f64 = 1e-9;

/// A corner of the curve at an edge: tangents that differ by so many radians.
const CORNER: f64 = 1e-6;

/// Most surfaces met, in all and one beside the other in one cell: what switches more often is noise.
const MOST: usize = 20_000;
const DEEPEST: usize = 64;

/// Surfaces that a curve meets, and what they do to frames.
#[derive(Debug, Clone, Copy)]
pub(super) struct CurveCrossing {
    /// Shares of the way just before and just behind.
    pub between: [f64; 2],
    /// The turn relative to the standard frames; none where the metric does not jump.
    pub turn: DQuat,
}

/// Tells why nothing can be carried over an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EdgeFault {
    /// The curve touches the edge or runs along it.
    #[error("the curve touches the edge or runs along it")]
    Along,
    /// Edges meet there, or the curve has a corner there.
    #[error("edges meet there, or the curve has a corner on the edge")]
    Corner,
    /// The limit of soft edges depends on their profile.
    #[error(
        "the metrics on both sides are neither multiples of each other nor equal along the edge, so that the turn \
         would depend on the profile of the edge"
    )]
    Profile,
    /// The metric switches too often.
    #[error("the metric switches too often")]
    Often,
}

/// An edge over which nothing can be carried.
#[derive(Debug, Clone, Copy)]
pub(super) struct RefusedEdge {
    /// Share of the way.
    pub s: f64,
    pub fault: EdgeFault,
}

/// A switching function at a place of the curve.
#[derive(Debug, Clone, Copy)]
struct Look {
    value: f64,
    gradient: DVec3,
    /// Derivative by the share of the way.
    rate: f64,
}

impl Look {
    fn is_positive(&self) -> bool {
        self.value > 0.0
    }

    /// Computes the sine of the angle (in the chart) between the surface and a curve of this speed; not a number
    /// where one of them has no direction.
    fn slope(&self, speed: f64) -> f64 {
        self.rate.abs() / (self.gradient.length() * speed)
    }
}

/// A surface met.
#[derive(Debug, Clone, Copy)]
struct Met {
    s: f64,
    function: usize,
    /// Shares of the way: beside it the curve is clear of the surface, up to rounding of `s`, and of `φ`.
    aside: f64,
    clear: f64,
}

/// Metric and standard frame on one side of an edge.
#[derive(Debug, Clone, Copy)]
struct MetricSide {
    metric: DMat3,
    frame: DMat3,
}

impl MetricSide {
    fn at(manifold: &Manifold, u: DVec3) -> Self {
        let (metric, frame) = manifold.metric_and_frame(u);
        Self { metric, frame }
    }

    fn differs(&self, other: &Self) -> bool {
        metrics_differ(self.metric, other.metric)
    }

    /// Computes the vector of unit length that is perpendicular to the surfaces of the covector `gradient`.
    fn normal(&self, gradient: DVec3) -> DVec3 {
        let raised = self.metric.inverse() * gradient;
        raised / gradient.dot(raised).sqrt()
    }
}

/// Computes the turn of frames over an edge with the normal covector `gradient` along the tangent `v`, relative to
/// the standard frames of both sides; `None` where it depends on the profile of the edge.
fn turn_over(near: &MetricSide, far: &MetricSide, gradient: DVec3, v: DVec3) -> Option<DQuat> {
    let ratio = near.metric.inverse() * far.metric;
    let scale = (ratio.x_axis.x + ratio.y_axis.y + ratio.z_axis.z) / 3.0;
    if !metrics_differ(near.metric * scale, far.metric) {
        let normal = near.frame.transpose() * gradient;
        let tangent = near.frame.inverse() * v;
        let slope = tangent.cross(normal) / tangent.dot(normal);
        return Some(DQuat::from_scaled_axis(slope * (0.5 * scale.ln())));
    }
    let unit = gradient.normalize();
    let along = DMat3::IDENTITY - DMat3::from_cols(unit * unit.x, unit * unit.y, unit * unit.z);
    let [a, b] = [near, far].map(|side| along * side.metric * along);
    if metrics_differ(a, b) {
        return None;
    }
    let [before, behind] = [near, far].map(|side| side.normal(gradient));
    // The component along the normal is that of the momentum: G n = ∇φ / |∇φ|.
    let lowered = near.metric * before;
    let change = behind - before;
    let carried = DMat3::IDENTITY
        + DMat3::from_cols(change * lowered.x, change * lowered.y, change * lowered.z);
    let rotation = far.frame.inverse() * carried * near.frame;
    Some(DQuat::from_mat3(&rotation).normalize())
}

/// Finds the surfaces that `curve` meets, looked at in `places` cells. `offset` is the largest parameter of the
/// curve over the width of its interval, whose rounding counts like that of points.
pub(super) fn crossings(
    manifold: &Manifold,
    curve: impl Fn(f64) -> (DVec3, DVec3),
    places: usize,
    offset: f64,
) -> Result<Vec<CurveCrossing>, RefusedEdge> {
    let Some(tape) = manifold.switching_functions() else {
        return Ok(Vec::new());
    };
    let mut surfaces = CurveSurfaces {
        manifold,
        tape,
        registers: tape.registers(),
        curve,
        offset,
        met: Vec::new(),
    };
    surfaces.look_everywhere(places)?;
    surfaces.resolved()
}

/// The switching functions along a curve.
struct CurveSurfaces<'m, C> {
    manifold: &'m Manifold,
    tape: &'m Tape,
    registers: Registers<f64, 1>,
    curve: C,
    offset: f64,
    met: Vec<Met>,
}

impl<C: Fn(f64) -> (DVec3, DVec3)> CurveSurfaces<'_, C> {
    /// Evaluates all functions.
    fn look(&mut self, s: f64) -> Vec<Look> {
        let (u, v) = (self.curve)(s);
        self.tape.run_at(&mut self.registers, &u.to_array());
        let output = |c: usize| self.registers.output(c)[0];
        let functions = 0..self.tape.outputs() / 4;
        let looks = functions.map(|k| {
            let gradient = DVec3::from_array([1, 2, 3].map(|c| output(4 * k + c)));
            Look {
                value: output(4 * k),
                gradient,
                rate: gradient.dot(v),
            }
        });
        looks.collect()
    }

    /// Returns the share of the way that rounding of points and parameters makes uncertain, as where rays cross surfaces.
    fn aside(&self, s: f64) -> f64 {
        let (u, v) = (self.curve)(s);
        let aside = ASIDE * (1.0 + self.offset + u.length() / v.length());
        aside.min(FARTHEST)
    }

    fn side(&self, s: f64) -> MetricSide {
        MetricSide::at(self.manifold, (self.curve)(s).0)
    }

    /// Finds all surfaces that are met.
    fn look_everywhere(&mut self, places: usize) -> Result<(), RefusedEdge> {
        let mut before = self.look(0.0);
        let mut along_before = self.run_along(0.0, &before)?;
        self.note_end(0.0, &before);
        for i in 1..=places {
            let [low, high] = [i - 1, i].map(|i| i as f64 / places as f64);
            let after = self.look(high);
            let along = self.run_along(high, &after)?;
            let both = along_before.iter().zip(&along);
            let ignored: Vec<bool> = both.map(|(a, b)| *a || *b).collect();
            self.search([(low, &before), (high, &after)], &ignored, DEEPEST)?;
            (before, along_before) = (after, along);
        }
        self.note_end(1.0, &before);
        Ok(())
    }

    /// Tells along which surfaces the curve runs at `s`, where rounding decides on which side it is.
    ///
    /// # Errors
    /// One of them is an edge.
    fn run_along(&self, s: f64, looks: &[Look]) -> Result<Vec<bool>, RefusedEdge> {
        let (u, v) = (self.curve)(s);
        let reach = self.aside(s) * v.length();
        let mut along = vec![false; looks.len()];
        for (along, look) in along.iter_mut().zip(looks) {
            let on = look.value.abs() <= look.gradient.length() * reach;
            if !on || !(look.slope(v.length()) < GRAZING) {
                continue;
            }
            let beside = look.gradient.normalize() * (2.0 * reach);
            let [a, b] = [u - beside, u + beside].map(|u| MetricSide::at(self.manifold, u));
            if a.differs(&b) && !self.manifold.is_beside_axis(u, reach) {
                let fault = EdgeFault::Along;
                return Err(RefusedEdge { s, fault });
            }
            *along = true;
        }
        Ok(along)
    }

    /// Notes the surfaces on which the curve begins or ends: the sign of a function does not tell on which side.
    fn note_end(&mut self, s: f64, looks: &[Look]) {
        let speed = (self.curve)(s).1.length();
        let reach = self.aside(s) * speed;
        for (function, look) in looks.iter().enumerate() {
            let on = look.value.abs() <= look.gradient.length() * reach;
            if on && look.slope(speed) >= GRAZING {
                let met = self.meeting(s, function, look);
                self.met.push(met);
            }
        }
    }

    /// Describes the surface of `look`, met at `s`.
    fn meeting(&self, s: f64, function: usize, look: &Look) -> Met {
        let slope = look.slope((self.curve)(s).1.length());
        let aside = self.aside(s);
        Met {
            s,
            function,
            aside,
            clear: (aside / slope.max(GRAZING)).min(FARTHEST.max(aside)),
        }
    }

    /// Finds the surfaces met between two places, but for those `ignored`. What is found divides the stretch: between
    /// the kinks of functions they are smooth, and thin layers are seen.
    fn search(
        &mut self,
        [(low, before), (high, after)]: [(f64, &[Look]); 2],
        ignored: &[bool],
        depth: usize,
    ) -> Result<(), RefusedEdge> {
        let mut functions = (0..before.len()).filter(|k| !ignored[*k]);
        let found = functions.find_map(|k| {
            let s = self.met_between(k, [low, high], [before[k], after[k]])?;
            Some((s, k))
        });
        let Some((s, function)) = found else {
            return Ok(());
        };
        if depth == 0 || self.met.len() >= MOST {
            let fault = EdgeFault::Often;
            return Err(RefusedEdge { s, fault });
        }
        let look = self.look(s)[function];
        let met = self.meeting(s, function, &look);
        let (u, v) = (self.curve)(s);
        if !self.manifold.is_beside_axis(u, met.aside * v.length()) {
            self.met.push(met);
        }
        let [end, start] = [s - met.clear, s + met.clear];
        if end > low {
            let there = self.look(end);
            self.search([(low, before), (end, &there)], ignored, depth - 1)?;
        }
        if start < high {
            let there = self.look(start);
            self.search([(start, &there), (high, after)], ignored, depth - 1)?;
        }
        Ok(())
    }

    /// Finds a place between two at which function `k` changes its sign: there, or where it comes towards zero and
    /// turns back. `None` if there is none.
    fn met_between(&mut self, k: usize, [low, high]: [f64; 2], ends: [Look; 2]) -> Option<f64> {
        let [before, after] = ends;
        if !(before.value.is_finite() && after.value.is_finite()) {
            return None;
        }
        let sign = if before.is_positive() { -1.0 } else { 1.0 };
        let beyond = match before.is_positive() != after.is_positive() {
            true => high,
            false => {
                let turns = sign * before.rate > 0.0 && sign * after.rate < 0.0;
                let falls = |s: f64| -sign * self.look(s)[k].rate;
                let nearest = turns.then(|| crossing(low, high, falls))?;
                let reached = sign * self.look(nearest)[k].value > 0.0;
                reached.then_some(nearest)?
            }
        };
        Some(crossing(low, beyond, |s| sign * self.look(s)[k].value))
    }

    /// Joins surfaces that are met at one place, and finds what they do to frames.
    fn resolved(mut self) -> Result<Vec<CurveCrossing>, RefusedEdge> {
        let mut met = std::mem::take(&mut self.met);
        met.sort_by(|a, b| a.s.total_cmp(&b.s));
        let apart = |a: &Met, b: &Met| b.s - b.clear <= a.s + a.clear + a.aside;
        let groups = met.chunk_by(apart);
        groups.map(|group| self.resolve(group)).collect()
    }

    fn resolve(&mut self, group: &[Met]) -> Result<CurveCrossing, RefusedEdge> {
        let ends = |beside: fn(&Met) -> f64| {
            let low = group.iter().map(|met| met.s - beside(met));
            let high = group.iter().map(|met| met.s + beside(met));
            [
                low.fold(1.0, f64::min).max(0.0),
                high.fold(0.0, f64::max).min(1.0),
            ]
        };
        let clear = ends(|met| met.clear);
        let [near, far] = clear.map(|s| self.side(s));
        Ok(match near.differs(&far) {
            true => CurveCrossing {
                between: clear,
                turn: self.turn(group, clear, [near, far])?,
            },
            false => CurveCrossing {
                between: ends(|met| met.aside),
                turn: DQuat::IDENTITY,
            },
        })
    }

    /// Computes the turn over the edge met by `group` between two places with these sides.
    fn turn(
        &mut self,
        group: &[Met],
        ends: [f64; 2],
        [near, far]: [MetricSide; 2],
    ) -> Result<DQuat, RefusedEdge> {
        let s = group[0].s;
        let refused = |fault| RefusedEdge { s, fault };
        let v = (self.curve)(s).1;
        let [before, behind] = ends.map(|s| (self.curve)(s).1.normalize());
        let looks = self.look(s);
        let mut functions = group.iter().map(|met| &looks[met.function]);
        if functions
            .clone()
            .all(|look| !(look.slope(v.length()) >= GRAZING))
        {
            return Err(refused(EdgeFault::Along));
        }
        let edge = functions.find(|look| {
            let sides = [(ends[0], &near), (ends[1], &far)];
            look.slope(v.length()) >= GRAZING && self.is_surface(look, ends, sides)
        });
        let Some(edge) = edge.filter(|_| (before - behind).length() < CORNER) else {
            return Err(refused(EdgeFault::Corner));
        };
        let turn = turn_over(&near, &far, edge.gradient, v);
        let turn = turn.filter(|turn| turn.is_finite());
        turn.ok_or(refused(EdgeFault::Profile))
    }

    /// Returns whether the metric jumps at the surface of `look`, and at no other: the function vanishes (a function of
    /// what jumps does not), and beside the curve, along the surface, both sides are as on the curve, unless that ends on
    /// the surface itself.
    fn is_surface(&self, look: &Look, ends: [f64; 2], sides: [(f64, &MetricSide); 2]) -> bool {
        let [a, b] = ends.map(|s| (self.curve)(s).0);
        let width = (b - a).length();
        let (across, up) = look.gradient.normalize().any_orthonormal_pair();
        let beside = [across, -across, up, -up].map(|e| e * (4.0 * width));
        let vanishes = look.value.abs() <= 2.0 * width * look.gradient.length();
        vanishes
            && sides
                .iter()
                .filter(|(s, _)| 0.0 < *s && *s < 1.0)
                .all(|(s, side)| {
                    let u = (self.curve)(*s).0;
                    let mut others = beside.iter().map(|e| MetricSide::at(self.manifold, u + *e));
                    others.all(|other| !side.differs(&other))
                })
    }
}
