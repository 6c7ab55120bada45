//! Geodesics of a manifold: integrators, transport, deviation, paths with dense output.
//!
//! In: a [`Manifold`] and [`Ray`]s, which start where [`check_start`] finds nothing wrong. Out: [`Step`]s given
//! to a [`Sink`], or whole [`Path`]s.
//! Arc length is measured in the metric; tangents have unit length. Besides: parallel transport along
//! any curve ([`transport()`]), and the exponential map with its differential ([`exponential()`]).

mod curve_checks;
mod curve_edges;
mod deviation;
mod domain_events;
mod dormand_prince;
mod face_crossing;
mod fixed;
mod integrator;
mod parallel_transport;
mod path;
mod poles;
mod refraction;
mod state;
mod step;
mod switching;

pub use curve_checks::{check_inside, check_jumps, to_nearest_image};
pub use curve_edges::EdgeFault;
pub use deviation::{JacobiField, conjugate_points, perpendiculars, signed_area};
pub use domain_events::{crossing, first_event, may_rise_between};
pub use dormand_prince::MOST_STEPS;
pub use fixed::fixed_steps;
pub use integrator::follow;
pub use parallel_transport::{Transport, TransportFailed, carry, transport, transport_piece};
pub use path::{Exponential, Path, Sample, elapsed, ends, exponential, paths, sample};
pub use path::{UnfinishedPaths, ends_alone};
pub use poles::{
    PASSING_ANGLE, RayPath, beside, follow_past_poles, meets_pole, paths_beside_poles,
};
pub use refraction::turn_at_edge;
pub use step::Step;

use crate::{
    error::{Error, Result},
    manifold::{Carried, EventKind, Gluing, LocalFrame, Manifold},
};
use glam::{DMat3, DVec3};
use state::{LANES, NIL, Row, each, weighted};

/// A geodesic to follow.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Chart point.
    pub u: DVec3,
    /// Tangent, chart components: `v`, or in a wind W `v − W`, has unit length in the metric at `u`.
    pub v: DVec3,
    /// Arc length to follow it to.
    pub length: f64,
    /// The initial δv of the two deviations, chart components; used only when deviation is carried.
    pub spread: [DVec3; 2],
}

impl Ray {
    /// The ray seen from `u` in the direction `d` (standard frame, unit), with deviations along two
    /// perpendicular directions that make a right-handed triple with it.
    pub fn new(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> Self {
        Self::seen_by(&manifold.local_frame(u), u, d, length)
    }

    /// [`Ray::new`] where the observer at `u` is known.
    pub fn seen_by(local: &LocalFrame, u: DVec3, d: DVec3, length: f64) -> Self {
        let across = perpendiculars(d);
        Self {
            u,
            v: local.tangent(d),
            length,
            spread: across.map(|e| local.frame * e),
        }
    }

    /// Makes a ray from `u` with the tangent `v` whose neighbours do not matter: deviation must not be carried.
    pub fn without_spread(u: DVec3, v: DVec3, length: f64) -> Self {
        Self {
            u,
            v,
            length,
            spread: [DVec3::ZERO; 2],
        }
    }
}

/// The reason of a path's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// At the length asked for, or where its [`Sink`] had seen enough.
    Length,
    /// Through the exit with this index in [`Manifold::exits`].
    Exit(usize),
    /// Where the metric allows no further step.
    Singular,
}

impl End {
    /// The name that `trace` prints.
    pub fn name(self, manifold: &Manifold) -> &str {
        match self {
            Self::Length => "length",
            Self::Singular => "singular",
            Self::Exit(k) => &manifold.exits[k].name,
        }
    }
}

/// Settings of the integrator: error budget, quantities carried along, events.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Largest local error of a step: an angle in radians for directions and frames, a share of the
    /// arc length for positions.
    pub tolerance: f64,
    /// Quantities to carry along.
    pub carried: Carried,
    /// Set to end rays at exits and at the end of the domain.
    pub events: bool,
}

impl Settings {
    /// Carries nothing along and ends rays nowhere.
    pub const fn bare(tolerance: f64) -> Self {
        Self {
            tolerance,
            carried: Carried {
                frame: false,
                deviation: false,
            },
            events: false,
        }
    }

    /// Carries the frame along, too.
    pub const fn with_frame(mut self) -> Self {
        self.carried.frame = true;
        self
    }

    /// Carries geodesic deviation along, too.
    pub const fn with_deviation(mut self) -> Self {
        self.carried.deviation = true;
        self
    }

    /// Ends rays at exits and at the end of the domain.
    pub const fn with_events(mut self) -> Self {
        self.events = true;
        self
    }
}

/// Takes the steps of many rays as they are made.
pub trait Sink {
    /// Returns whether the step of `ray` that ends at arc length `to` is to be made into a curve and given to
    /// [`Sink::step`]; the one in which the ray ends always is.
    fn wants(&self, ray: usize, to: f64) -> bool {
        let _ = (ray, to);
        true
    }
    /// Returns the box of the chart outside which no steps are wanted, `None` for everywhere: all lanes are tested at
    /// once, before any step is made into a curve.
    fn region(&self) -> Option<(DVec3, DVec3)> {
        None
    }
    /// Returns whether steps are to have what is carried along; that in which a ray ends always has.
    fn wants_carried(&self) -> bool {
        true
    }
    /// The next step of `ray` that was wanted; steps of one ray come in order, those of different rays mixed.
    fn step(&mut self, ray: usize, step: &Step);
    /// Returns whether to follow `ray` further; asked after each of its steps. A ray that is given up ends
    /// as [`End::Length`] at the end of that step.
    fn wants_more(&self, _ray: usize) -> bool {
        true
    }
    /// `ray` goes on behind face `face` of a glued domain: steps after this are there.
    fn crossed(&mut self, ray: usize, face: usize) {
        let _ = (ray, face);
    }
    /// `ray` has ended at arc length `s` after `steps` steps tried.
    fn end(&mut self, ray: usize, end: End, s: f64, steps: usize);
}

/// The ray from `u` in the direction `d` (standard frame, unit); `subject` names where the point
/// came from, for the complaint.
///
/// # Errors
/// As [`check_start`].
pub fn depart(manifold: &Manifold, subject: &str, u: DVec3, d: DVec3, length: f64) -> Result<Ray> {
    check_start(manifold, subject, u)?;
    Ok(Ray::new(manifold, u, d, length))
}

/// The tightest and the loosest local error of a step that the integrator is asked for: below the
/// first, rounding decides; above the second, steps skip over what they should see.
pub const TOLERANCES: std::ops::RangeInclusive<f64> = 1e-14..=1e-1;

/// Returns `v` at unit length; `None` if it is zero or not finite.
pub fn unit(v: DVec3) -> Option<DVec3> {
    // Scaled first, so that no square overflows or vanishes.
    let largest = v.abs().max_element();
    (v.is_finite() && largest > 0.0).then(|| (v / largest).normalize())
}

/// Refuses a point outside the domain, or where the metric is not finite and positive definite.
///
/// # Errors
/// [`Error::Input`] about `subject`.
pub fn check_point(manifold: &Manifold, subject: &str, u: DVec3) -> Result<()> {
    match fault(manifold, u) {
        None => Ok(()),
        Some(fault) => Err(Error::input(
            subject,
            format!("{}: {fault}", named(manifold, u)),
        )),
    }
}

/// Refuses a point from which no path can be seen: as [`check_point`], beyond an exit, and where the metric has no
/// derivatives.
///
/// # Errors
/// [`Error::Input`] about `subject`.
pub fn check_start(manifold: &Manifold, subject: &str, u: DVec3) -> Result<()> {
    check_point(manifold, subject, u)?;
    let fault = match beyond_exit(manifold, manifold.located(u)) {
        Some(fault) => format!("{fault}; start on this side of it"),
        None if !sets_out(manifold, u) => "the metric has no derivatives there, as sqrt(x^2 + y^2) has none at 0; start beside it, or write the formula without the root".into(),
        None => return Ok(()),
    };
    let message = format!("{}: {fault}", named(manifold, u));
    Err(Error::input(subject, message))
}

/// Tells whether geodesics have an acceleration at `u`, or an axis of textbook coordinates is there, over which they go.
fn sets_out(manifold: &Manifold, u: DVec3) -> bool {
    let v = Ray::new(manifold, u, DVec3::new(0.48, 0.6, 0.64), 1.0).v;
    manifold.acceleration(u, v).is_finite() || manifold.is_on_axis(u)
}

/// Says which exit a point lies beyond, and the value of its formula there; `None` if it lies beyond none.
pub fn beyond_exit(manifold: &Manifold, u: DVec3) -> Option<String> {
    let (exit, value) = manifold.domain.exit_beyond(u)?;
    let name = &manifold.exits[exit].name;
    Some(format!(
        "the point lies beyond the exit `{name}`, whose `when` is {value:.6} there (a path leaves where it becomes positive)"
    ))
}

fn fault(manifold: &Manifold, u: DVec3) -> Option<String> {
    if !u.is_finite() {
        return Some("the point is not finite".into());
    }
    match manifold.domain.violation(u) {
        Some(EventKind::Limit) => return Some(limit_fault(manifold, u)),
        Some(_) => return Some("the point violates a condition of `inside`".into()),
        None => {}
    }
    if let Some(gluing) = manifold.gluing() {
        match gluing.locate(u) {
            Some((image, _)) if manifold.domain.violation(image).is_some() => {
                return Some("the point that it stands for in the glued domain violates a condition of `inside`".into());
            }
            Some(_) => {}
            None => return Some(gluing_fault(gluing, u)),
        }
    }
    let (g, s) = manifold.metric_and_frame(u);
    let finite = |m: DMat3| m.to_cols_array().iter().all(|x| x.is_finite());
    if !finite(g) {
        return Some("the metric is not finite there".into());
    }
    let positive = finite(s) && (0..3).all(|k| s.col(k)[k] > 0.0);
    (!positive).then(|| "the metric is not positive definite there".into())
}

fn gluing_fault(gluing: &Gluing, u: DVec3) -> String {
    match gluing.behind_mirror(u) {
        Some(k) => format!("the point lies behind the mirror of face {}", k + 1),
        None => "the point cannot be brought into the glued domain".into(),
    }
}

fn limit_fault(manifold: &Manifold, u: DVec3) -> String {
    let domain = &manifold.domain;
    let beyond = (0..3).find_map(|k| {
        let [low, high] = domain.limits[k].filter(|_| !domain.periodic[k])?;
        let name = &manifold.coordinates[k];
        (!(low..=high).contains(&u[k]))
            .then(|| format!("`{name}` must lie in its limits [{low}, {high}]"))
    });
    beyond.unwrap_or_else(|| "the point is outside a coordinate limit".into())
}

fn named(manifold: &Manifold, u: DVec3) -> String {
    // Far from 1 all digits would be hundreds.
    let number = |x: f64| match format!("{x}") {
        plain if plain.len() <= 24 => plain,
        _ => format!("{x:e}"),
    };
    let [x, y, z] = &manifold.coordinates;
    let [a, b, c] = u.to_array().map(number);
    format!("{x} = {a}, {y} = {b}, {z} = {c}")
}
