//! The geodesics that connect two points: a boundary value problem, solved by shooting; and what casts shadows on them.
//!
//! In: guesses of direction and arc length ([`ShootingStart`]). Out: [`Connection`]s, by Newton's
//! method with the deviation matrix: `(J₁, J₂, v) (δ₁, δ₂, δs) = x − u(s)`, where the columns `J` say
//! how the end moves when the direction turns by two small angles `δ`, and the tangent `v` how it moves
//! with the length. A guess that brings its own matrix is first followed without deviation, which costs
//! a fraction; when its next step is small it is followed with deviation, and what casts a shadow on
//! its end is found on the same path.
//!
//! In: geodesics from a lamp to points of surfaces. Out: the end of each, unless a surface casts a
//! shadow on it ([`Shadows`]), and the share of light that surfaces which are not solid let through.
//! Intersection goes along with integration, so a shadow costs no ray of its own, and a ray in shadow
//! is given up where the shadow begins.

use crate::{beam::Guess, light_fan::LightFan};
use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow, perpendiculars, signed_area},
    manifold::{LocalFrame, Manifold},
};
use geofan_render::{
    Cubic, SurfacePoint, World,
    intersect::{Hit, HitSearch, may_meet, region},
    tracer::pieces,
};
use glam::{DMat3, DVec3};

/// A geodesic from a point (a lamp) to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Connection {
    /// Its direction at the start, in the standard frame there; unit.
    pub direction: DVec3,
    /// Its arc length.
    pub s: f64,
    /// Where it ends: the point asked for, or its image whole periods away.
    pub u: DVec3,
    /// Its tangent at the end, chart components; unit.
    pub v: DVec3,
    /// The area by which a unit solid angle at the start has spread at the end; negative after an
    /// odd number of caustics.
    pub area: f64,
    /// The share of light that surfaces on the way let through.
    pub through: f64,
}

/// Says which two points to connect, and where to begin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShootingStart {
    /// The number that its connection will have.
    pub index: usize,
    /// The point to start from with the standard frame there, and the one to reach.
    pub from: DVec3,
    pub local: LocalFrame,
    pub to: DVec3,
    /// Guessed direction in the standard frame at the start, and arc length.
    pub direction: DVec3,
    pub s: f64,
    /// Roughly the two deviations at the end, chart components, if something is known about them.
    pub spread: Option<[DVec3; 2]>,
}

/// Newton's method for one connection.
#[derive(Debug, Clone, Copy)]
struct ShootingState {
    start: ShootingStart,
    /// The best so far: direction, arc length and how far it missed.
    best: (DVec3, f64, f64),
    /// The step from the best that is being tried: two angles and an arc length.
    step: DVec3,
    /// Set if the step is so small that it may be the last.
    near: bool,
    /// Set if the next ray is to be followed without deviation, and the step after it found by the
    /// guessed one.
    bare: bool,
    /// Set if the present step was found so.
    guessed: bool,
}

/// A ray that was tried, by how much its end misses the point, and the Newton step that would put it
/// right.
type Shot = (Connection, f64, DVec3);

/// Most integrations for one connection: most need two, beside caustics three or four. The others
/// look for light beyond a fold, where there is none.
const MOST_STEPS: usize = 8;

/// Largest turn (radians) of one step, and largest change of the arc length as a share of it: from
/// farther away the linear map says nothing.
const LARGEST_TURN: f64 = 0.3;
const LARGEST_STRETCH: f64 = 0.4;

/// A ray has arrived when it misses by this share of the arc length times the square root of the
/// tolerance. The miss is then put right to first order, so that direction and length are as good as
/// the integration (see [`COARSE`]); the area stays that of the tried ray, off by some ten times the
/// miss: a part in a million at a tolerance of 1e-10. A tenth of this would cost another integration
/// for most.
const ARRIVED: f64 = 1e-2;

/// A ray has not arrived either when putting that right would turn it by more than this (radians), or change its arc length by
/// more than this share, unless it misses by less than the other share: beside a caustic many directions come that near, and
/// each would count as a geodesic of its own.
const LARGEST_CORRECTION: f64 = 3e-5;
const EXACT: f64 = 1e-9;

/// Integrations have a tolerance of this many times the miss that is allowed: their error in the area
/// is then no larger than the miss's, and well below the distance at which two solutions are told
/// apart.
const COARSE: f64 = 1.0;

/// A step that turns by less than this (radians), and changes the arc length by less than this share,
/// is expected to be the last: it leaves out about its square, and what shadows its ray shadows the
/// connection.
const NEAR: f64 = 2e-3;

/// Finds the connections of `starts` at a local tolerance, without those that do not arrive, those in
/// shadow, and repetitions for one index. Returns them by ascending index, and for each by arc length;
/// with the number of geodesics that were followed.
pub(crate) fn connect(
    manifold: &Manifold,
    starts: Vec<ShootingStart>,
    tolerance: f64,
    shadows: Shadows<'_>,
) -> (Vec<(usize, Connection)>, usize) {
    let local = tolerance.max(COARSE * allowed(tolerance).min(0.1 * SAME));
    let mut open: Vec<ShootingState> = starts.into_iter().map(ShootingState::new).collect();
    let (mut found, mut followed) = (Vec::new(), 0);
    for _ in 0..MOST_STEPS {
        if open.is_empty() {
            break;
        }
        followed += open.len();
        let (near, far): (Vec<ShootingState>, Vec<ShootingState>) =
            open.into_iter().partition(|s| s.near);
        open = approached(manifold, far, local);
        let (arrived, others) = arrived(manifold, near, [local, allowed(tolerance)], shadows);
        found.extend(arrived);
        open.extend(others);
    }
    (distinct(found), followed)
}

/// Returns by how much an arrived ray may miss, as a share of the arc length.
fn allowed(tolerance: f64) -> f64 {
    ARRIVED * tolerance.sqrt()
}

/// Follows the rays that the states try now.
fn followed(
    manifold: &Manifold,
    settings: Settings,
    states: &[ShootingState],
    shadows: Shadows<'_>,
) -> Vec<FollowedRay> {
    let numbers = states.iter().map(|state| state.start.index).collect();
    let rays = states.iter().map(ShootingState::ray).collect();
    follow_shadowed(manifold, settings, rays, numbers, shadows)
}

/// Takes a step with every state, whatever casts shadows; returns those that have a next step.
fn approached(
    manifold: &Manifold,
    states: Vec<ShootingState>,
    tolerance: f64,
) -> Vec<ShootingState> {
    let (bare, others): (Vec<ShootingState>, Vec<ShootingState>) =
        states.into_iter().partition(|s| s.bare);
    let mut open = Vec::with_capacity(bare.len() + others.len());
    let settings = Settings::bare(tolerance);
    for (states, settings) in [(bare, settings), (others, settings.with_deviation())] {
        let rays = followed(manifold, settings, &states, Shadows::Ignored);
        let next = |(state, ray): (ShootingState, FollowedRay)| {
            let shot = state.shot(&ray);
            state.stepped(shot)
        };
        open.extend(states.into_iter().zip(rays).filter_map(next));
    }
    open
}

/// Takes a step with every state whose ray is not in shadow: returns those that have arrived, missing
/// by at most the share `allowed`, and those others that have a next step.
fn arrived(
    manifold: &Manifold,
    states: Vec<ShootingState>,
    [tolerance, allowed]: [f64; 2],
    shadows: Shadows<'_>,
) -> (Vec<(usize, Connection)>, Vec<ShootingState>) {
    let rays = followed(
        manifold,
        Settings::bare(tolerance).with_deviation().with_events(),
        &states,
        shadows,
    );
    let (mut found, mut others) = (Vec::new(), Vec::new());
    for (state, ray) in states.into_iter().zip(rays) {
        if matches!(ray, FollowedRay::Shadowed) {
            continue;
        }
        match state.shot(&ray) {
            Some((tried, miss, step))
                if miss <= allowed * tried.s
                    && (size(step, tried.s) <= LARGEST_CORRECTION || miss <= EXACT * tried.s) =>
            {
                // Put right to first order, rays that have come to one geodesic from different sides
                // agree.
                let (direction, s) = stepped(tried.direction, tried.s, step);
                let connection = Connection {
                    direction,
                    s,
                    ..tried
                };
                found.push((state.start.index, connection));
            }
            shot => others.extend(state.stepped(shot)),
        }
    }
    (found, others)
}

impl ShootingState {
    fn new(start: ShootingStart) -> Self {
        Self {
            start,
            best: (start.direction, start.s, f64::INFINITY),
            step: DVec3::ZERO,
            near: false,
            bare: start.spread.is_some(),
            guessed: false,
        }
    }

    /// Returns the direction and arc length that the present step leads to.
    fn tried(&self) -> (DVec3, f64) {
        let (d, s, _) = self.best;
        stepped(d, s, self.step)
    }

    fn ray(&self) -> Ray {
        let (d, s) = self.tried();
        Ray::seen_by(&self.start.local, self.start.from, d, s)
    }

    /// Returns what the present step has led to, if its ray has reached its end.
    fn shot(&self, ray: &FollowedRay) -> Option<Shot> {
        let &FollowedRay::Arrived {
            u,
            v,
            spread,
            local,
            through,
        } = ray
        else {
            return None;
        };
        let (direction, s) = self.tried();
        let columns = spread.or(self.start.spread)?;
        // From the end to the point, and the derivatives of the end by two angles and the arc length,
        // in the standard frame.
        let into = local.frame.inverse();
        let miss = into * (self.start.to - u);
        let slope = DMat3::from_cols(into * columns[0], into * columns[1], into * v);
        let tried = Connection {
            direction,
            s,
            u,
            v,
            area: signed_area(&local, v, columns),
            through,
        };
        let step = limited(least_squares(slope, miss, s), s);
        Some((tried, miss.length(), step))
    }

    /// Prepares the next step: from where the present one has led to if that is better than the best,
    /// else half the present one; `None` if there is none.
    fn stepped(mut self, shot: Option<Shot>) -> Option<Self> {
        match shot.filter(|(_, miss, _)| *miss < self.best.2) {
            Some((tried, miss, step)) => {
                self.best = (tried.direction, tried.s, miss);
                self.step = step;
                self.guessed = self.bare;
            }
            // The guess has led astray: once more from the best, with deviation.
            None if self.guessed => {
                let (direction, s, _) = self.best;
                return Some(Self::new(ShootingStart {
                    direction,
                    s,
                    spread: None,
                    ..self.start
                }));
            }
            None => self.step *= 0.5,
        }
        self.bare = false;
        self.near = size(self.step, self.best.1) <= NEAR;
        (self.best.2.is_finite() && self.step.is_finite()).then_some(self)
    }
}

/// Returns the larger of a step's turn (radians) and its change of the arc length `s` as a share of that.
fn size(step: DVec3, s: f64) -> f64 {
    step.truncate().length().max((step.z / s).abs())
}

/// Turns a direction by two angles, and changes an arc length, by `step`.
fn stepped(d: DVec3, s: f64, step: DVec3) -> (DVec3, f64) {
    let [e1, e2] = perpendiculars(d);
    ((d + e1 * step.x + e2 * step.y).normalize(), s + step.z)
}

/// Returns the smallest solution of `slope x = miss`, damped by rounding's share of the arc length so
/// that it stays finite at caustics. The change of the arc length counts by its share of that, as angles do, so
/// that nothing depends on the unit of length.
fn least_squares(slope: DMat3, miss: DVec3, s: f64) -> DVec3 {
    let relative = DMat3::from_cols(slope.x_axis, slope.y_axis, slope.z_axis * s);
    let damping = DMat3::from_diagonal(DVec3::splat(1e-14 * s * s));
    let normal = relative.transpose() * relative + damping;
    normal.inverse() * (relative.transpose() * miss) * DVec3::new(1.0, 1.0, s)
}

/// Shortens a step to the largest turn and stretch.
fn limited(step: DVec3, s: f64) -> DVec3 {
    let turn = step.truncate().length() / LARGEST_TURN;
    let stretch = step.z.abs() / (LARGEST_STRETCH * s);
    step / turn.max(stretch).max(1.0)
}

/// Two solutions for one point are the same if they differ by less than this, in direction and as a
/// share of the arc length. They agree to the tolerance except beside a caustic, where two that are
/// closer than this have merged for all purposes.
const SAME: f64 = 1e-5;

/// Sorts connections and leaves out repetitions.
fn distinct(mut found: Vec<(usize, Connection)>) -> Vec<(usize, Connection)> {
    // The sort is stable and by the key alone, so the order does not depend on when each arrived.
    found.sort_by(|(i, a), (j, b)| i.cmp(j).then(a.s.total_cmp(&b.s)));
    let mut kept: Vec<(usize, Connection)> = Vec::with_capacity(found.len());
    for (index, new) in found {
        let same = |(other, old): &&(usize, Connection)| {
            *other == index
                && (old.direction - new.direction).length() < SAME
                && (old.s - new.s).abs() < SAME * new.s
        };
        let of_index = kept.iter().rev().take_while(|(other, _)| *other == index);
        if of_index.clone().find(same).is_none() {
            kept.push((index, new));
        }
    }
    kept
}

impl LightFan<'_> {
    /// Finds all geodesics from the lamp to each of `points` (chart), up to the fan's length; by the
    /// number of the point, and for each by ascending arc length; with the number of geodesics that
    /// were followed to find them.
    pub fn connections(
        &self,
        points: &[DVec3],
        tolerance: f64,
    ) -> (Vec<(usize, Connection)>, usize) {
        self.connected(points.iter().copied(), tolerance, Shadows::Ignored)
    }

    /// Finds those that `shadows` leaves; see [`LightFan::connections`].
    pub(super) fn connected(
        &self,
        points: impl Iterator<Item = DVec3>,
        tolerance: f64,
        shadows: Shadows<'_>,
    ) -> (Vec<(usize, Connection)>, usize) {
        let start = |(index, to, guess): (usize, DVec3, Guess)| ShootingStart {
            index,
            from: self.u,
            local: self.local,
            to,
            direction: guess.direction,
            s: guess.clear,
            spread: Some(guess.spread),
        };
        let starts = self.guesses(points).into_iter().map(start).collect();
        let (mut found, followed) = connect(self.manifold, starts, tolerance, shadows);
        found.retain(|(_, c)| c.s <= self.length);
        (found, followed)
    }
}

/// Says what casts shadows.
#[derive(Clone, Copy)]
pub(crate) enum Shadows<'a> {
    /// Nothing.
    Ignored,
    /// The surfaces of the world, up to the surface point with the geodesic's number.
    Cast(&'a World, &'a [SurfacePoint]),
}

/// Says how far a geodesic has come.
#[expect(
    clippy::large_enum_variant,
    reason = "lives for a moment, most are ends"
)]
enum FollowedRay {
    /// To its end.
    Arrived {
        /// Chart point, and unit tangent there.
        u: DVec3,
        v: DVec3,
        /// The two deviations, if they were carried.
        spread: Option<[DVec3; 2]>,
        /// The standard frame there.
        local: LocalFrame,
        /// The share of the light that surfaces on the way have let through.
        through: f64,
    },
    /// Not so far: the space ended before.
    Ended,
    /// To a surface that casts a shadow on its end.
    Shadowed,
}

/// Share of the arc length by which a ray may stop short of its point and still have reached it: the
/// curve that is intersected departs from the exact one by a tenth of that. Farther from the
/// surface, shadows begin to come off what casts them.
const SHORT: f64 = 5e-4;

/// Light of which less than this share is let through is none.
const FAINT: f64 = 1e-3;

/// Distance beyond a surface that lets light through from which the next is looked for, as a share of the arc
/// length: arc lengths of hits are in single precision.
const BEYOND: f64 = 1e-6;

/// The triangle of the point itself may be met as much earlier, where light grazes it.
const GRAZING: f64 = 0.1;

/// Follows `rays` until a surface casts a shadow on them; `numbers` are those of their surface points.
fn follow_shadowed(
    manifold: &Manifold,
    settings: Settings,
    rays: Vec<Ray>,
    numbers: Vec<usize>,
    shadows: Shadows<'_>,
) -> Vec<FollowedRay> {
    let state = |(ray, number): (&Ray, usize)| RayState {
        length: ray.length,
        number,
        met: false,
        shadowed: false,
        through: 1.0,
        end: None,
        search: match shadows {
            Shadows::Ignored => None,
            Shadows::Cast(world, _) => Some(HitSearch::new(world)),
        },
    };
    let states = rays.iter().zip(numbers).map(state).collect();
    let mut sink = ShadowSink { states, shadows };
    follow(manifold, settings, rays, &mut sink);
    with_frames(manifold, &sink.states)
}

/// Adds the standard frames at the ends, all computed together.
fn with_frames(manifold: &Manifold, states: &[RayState<'_>]) -> Vec<FollowedRay> {
    let ends = |f: &RayState<'_>| f.end.map(|(u, ..)| u);
    let ends: Vec<DVec3> = states.iter().filter_map(ends).collect();
    let mut locals = manifold.local_frames(&ends).into_iter();
    let followed = |f: &RayState<'_>| match (f.shadowed, f.end) {
        (true, _) => FollowedRay::Shadowed,
        (false, None) => FollowedRay::Ended,
        (false, Some((u, v, spread))) => {
            let local = locals.next().expect("as many locals as ends");
            FollowedRay::Arrived {
                u,
                v,
                spread,
                local,
                through: f.through,
            }
        }
    };
    states.iter().map(followed).collect()
}

/// A ray being followed.
struct RayState<'w> {
    length: f64,
    number: usize,
    /// Set once the surface of its point has been met.
    met: bool,
    /// Set once another surface has been met before.
    shadowed: bool,
    /// The share of light that has been let through so far.
    through: f64,
    /// Point, tangent and deviations at its end.
    end: Option<(DVec3, DVec3, Option<[DVec3; 2]>)>,
    /// What it meets, if anything casts shadows.
    search: Option<HitSearch<'w>>,
}

/// Intersects the integrator's steps with what casts shadows.
struct ShadowSink<'a> {
    states: Vec<RayState<'a>>,
    shadows: Shadows<'a>,
}

impl Sink for ShadowSink<'_> {
    fn wants(&self, ray: usize, _: f64) -> bool {
        matches!(self.shadows, Shadows::Cast(..)) && !self.states[ray].met
    }

    fn region(&self) -> Option<(DVec3, DVec3)> {
        match self.shadows {
            Shadows::Ignored => None,
            Shadows::Cast(world, _) => region(world),
        }
    }

    fn wants_carried(&self) -> bool {
        false
    }

    fn step(&mut self, ray: usize, step: &Step) {
        let state = &mut self.states[ray];
        if let Shadows::Cast(world, points) = self.shadows
            && !state.met
        {
            match state.meets(world, points, step) {
                Some(true) => state.met = true,
                Some(false) => {
                    state.shadowed = true;
                    return;
                }
                None => {}
            }
        }
        if step.end >= state.length {
            let s = state.length;
            state.end = Some((step.position(s), step.tangent(s), step.deviation(s)));
        }
    }

    fn wants_more(&self, ray: usize) -> bool {
        !self.states[ray].shadowed
    }

    fn end(&mut self, _: usize, _: End, _: f64, _: usize) {}
}

impl RayState<'_> {
    /// Tells whether the step meets the surface of the ray's point, or one before it that stops light;
    /// `None` if it meets neither.
    fn meets(&mut self, world: &World, points: &[SurfacePoint], step: &Step) -> Option<bool> {
        if !may_meet(world, step.bounds()) {
            return None;
        }
        for piece in pieces(step) {
            let mut rest = piece;
            while let Some(hit) = self.first_hit(&rest) {
                let s = f64::from(hit.s);
                let at_point = hit.triangle == points[self.number].triangle;
                let own = at_point && s > (1.0 - GRAZING) * self.length;
                if own || s >= (1.0 - SHORT) * self.length {
                    return Some(true);
                }
                if !self.passes(world, &hit) {
                    return Some(false);
                }
                let Some(beyond) = rest.after(s + BEYOND * self.length) else {
                    break;
                };
                rest = beyond;
            }
        }
        None
    }

    /// Finds the first hit of a piece.
    fn first_hit(&mut self, piece: &Cubic) -> Option<Hit> {
        self.search.as_mut()?.first_hit(piece, f64::INFINITY)
    }

    /// Takes the share that a surface lets through; tells whether that is any.
    fn passes(&mut self, world: &World, hit: &Hit) -> bool {
        self.through *= 1.0 - f64::from(world.opacity(hit));
        self.through > FAINT
    }
}
