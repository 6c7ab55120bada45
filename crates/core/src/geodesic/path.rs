//! Whole geodesics with dense output: their samples, the time that light takes along them, where they arrive, and
//! whether they were followed far enough.
//!
//! In: [`Ray`]s. Out: [`Path`]s; [`Sample`]s of one, vectors in chart components, glued
//! coordinates inside their limits; the time of the spacetime
//! that passes along it.
//!
//! The exponential map takes a tangent vector `w` at a chart point `u` to where the geodesic with velocity `w`
//! arrives after unit time, `exp_u(w)`. Its differential by `w` comes from the geodesic deviation: along `w` it is
//! the tangent, across it `J/|w|` (M. do Carmo, *Riemannian Geometry*, ch. 5, cor. 2.5).
//!
//! In: how many of some paths ended by their length, and at what arc length a sample of those ends
//! when it is followed farther. Out: [`UnfinishedPaths`], in shares of all paths. What such a path would
//! have met farther on is not known, so that a picture shows nothing there.

use super::{End, MOST_STEPS, Ray, Settings, Sink, Step, follow, signed_area};
use crate::manifold::Manifold;
use glam::{DMat3, DQuat, DVec3};
use serde::Serialize;
use std::{fmt, num::NonZeroU32};

/// A geodesic as its steps.
#[derive(Debug, Clone)]
pub struct Path {
    /// The steps in order, without gaps.
    pub steps: Vec<Step>,
    /// The reason of its end.
    pub end: End,
    /// The arc length at which it ended.
    pub length: f64,
    /// Number of steps tried, rejected ones included.
    pub tried: usize,
}

impl Path {
    /// Lists the edges that the path meets: where, and their numbers (see [`Step::edge`]).
    pub fn edges(&self) -> impl Iterator<Item = (f64, NonZeroU32)> {
        self.steps
            .iter()
            .filter_map(|step| Some((step.start, step.edge?)))
    }

    /// The step that covers arc length `s`; `None` for a path that ended at its start.
    pub fn step_at(&self, s: f64) -> Option<&Step> {
        let after = self.steps.partition_point(|step| step.end < s);
        self.steps
            .get(after.min(self.steps.len().saturating_sub(1)))
    }
}

/// Follows `rays` and keeps their paths.
pub fn paths(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
) -> Vec<Path> {
    let mut kept = Vec::new();
    follow(manifold, settings, rays, &mut kept);
    kept
}

/// Follows `rays` and keeps the last step of each, with the arc length at which it ended; `None`
/// for a ray that ended at its start.
pub fn ends(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
) -> Vec<Option<(Step, f64)>> {
    let mut last = LastSteps(Vec::new());
    follow(manifold, settings, rays, &mut last);
    last.0
}

struct LastSteps(Vec<Option<(Step, f64)>>);

impl Sink for LastSteps {
    fn wants(&self, _: usize, _: f64) -> bool {
        false
    }

    fn step(&mut self, ray: usize, step: &Step) {
        if self.0.len() <= ray {
            self.0.resize(ray + 1, None);
        }
        self.0[ray] = Some((step.clone(), step.end));
    }

    fn end(&mut self, ray: usize, _: End, _: f64, _: usize) {
        if self.0.len() <= ray {
            self.0.resize(ray + 1, None);
        }
    }
}

/// A list keeps whole paths, each at the number of its ray.
impl Sink for Vec<Path> {
    fn step(&mut self, ray: usize, step: &Step) {
        path_of(self, ray).steps.push(step.clone());
    }

    fn end(&mut self, ray: usize, end: End, s: f64, steps: usize) {
        let path = path_of(self, ray);
        (path.end, path.length, path.tried) = (end, s, steps);
    }
}

/// Returns the path of a ray among those kept, empty at first.
fn path_of(kept: &mut Vec<Path>, ray: usize) -> &mut Path {
    let nothing = || Path {
        steps: Vec::new(),
        end: End::Length,
        length: 0.0,
        tried: 0,
    };
    if kept.len() <= ray {
        kept.resize_with(ray + 1, nothing);
    }
    &mut kept[ray]
}

/// State of a path at one arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Arc length from the start.
    pub s: f64,
    /// Chart point, inside the limits of glued coordinates.
    pub u: DVec3,
    /// Tangent, of unit length (against the wind, where there is one).
    pub v: DVec3,
    /// Columns: the transported vectors that start as the standard frame. `None` when the frame
    /// was not carried, but for a path that ended where it starts.
    pub frame: Option<DMat3>,
    /// The area by which a unit solid angle has spread. `None` when deviation was not carried, but for a path that ended
    /// where it starts.
    pub area: Option<f64>,
    /// Faces of a glued domain crossed up to here.
    pub crossings: u32,
    /// Set if they have turned right into left.
    pub reversed: bool,
}

/// Computes the sample of `path`, which must be the path of `ray`, at arc length `s` up to its end.
pub fn sample(manifold: &Manifold, ray: &Ray, path: &Path, s: f64) -> Sample {
    match path.step_at(s) {
        Some(step) => on_step(manifold, step, s),
        None => at_start(manifold, ray),
    }
}

fn on_step(manifold: &Manifold, step: &Step, s: f64) -> Sample {
    let u = manifold.domain.wrap(step.position(s));
    let local = manifold.local_frame(u);
    let v = local.restored(manifold.metric(u), step.tangent(s));
    let area = |j| signed_area(&local, v, j).abs();
    Sample {
        s,
        u,
        v,
        frame: step.frame(s).map(|carried| local.frame * carried),
        area: step.deviation(s).map(area),
        crossings: step.crossings,
        reversed: step.reversed,
    }
}

fn at_start(manifold: &Manifold, ray: &Ray) -> Sample {
    let u = manifold.domain.wrap(ray.u);
    Sample {
        s: 0.0,
        u,
        v: ray.v,
        frame: Some(manifold.standard_frame(u)),
        area: Some(0.0),
        crossings: 0,
        reversed: false,
    }
}

/// Nodes and weights of Gauss's rule of order twelve on [−1, 1], those of one side.
const GAUSS: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691_1),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_36),
];

/// The time that light takes from the start of `path` to the parameter `s`.
pub fn elapsed(manifold: &Manifold, path: &Path, s: f64) -> f64 {
    if !manifold.has_drift() {
        return s;
    }
    let mut time = 0.0;
    for step in path.steps.iter().take_while(|step| step.start < s) {
        let to = step.end.min(s);
        let (middle, half) = (0.5 * (step.start + to), 0.5 * (to - step.start));
        let rate = |x: f64| {
            let s = middle + half * x;
            manifold.time_rate(step.position(s), step.tangent(s))
        };
        for (x, weight) in GAUSS {
            time += half * weight * (rate(x) + rate(-x));
        }
    }
    time
}

/// `exp_u(w)` and what belongs to it. Vectors are in chart components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exponential {
    /// The point reached. A glued coordinate is not brought back inside its limits.
    pub point: DVec3,
    /// The velocity on arrival: as long as `w`.
    pub velocity: DVec3,
    /// `∂point/∂w`; singular where the point is conjugate to `u`.
    pub differential: DMat3,
    /// The transported rotation, relative to the standard frames.
    pub rotation: DQuat,
}

/// `exp_u(w)`, each step exact to `tolerance`; `None` where the geodesic ends before. Exits do not end
/// it, and no wind blows it off.
pub fn exponential(manifold: &Manifold, u: DVec3, w: DVec3, tolerance: f64) -> Option<Exponential> {
    let manifold = &*manifold.still();
    let s = manifold.standard_frame(u);
    let components = s.inverse() * w;
    let length = components.length();
    if length == 0.0 {
        return Some(Exponential {
            point: u,
            velocity: w,
            differential: DMat3::IDENTITY,
            rotation: DQuat::IDENTITY,
        });
    }
    let ray = Ray::new(manifold, u, components / length, length);
    let settings = Settings::bare(tolerance).with_frame().with_deviation();
    let path = paths(manifold, settings, [ray]).pop()?;
    match (path.end, path.steps.last()) {
        (End::Length, Some(step)) => arrival(&ray, step),
        _ => None,
    }
}

fn arrival(ray: &Ray, step: &Step) -> Option<Exponential> {
    let s = ray.length;
    let (v, j) = (step.tangent(s), step.deviation(s)?);
    // Columns: how the end moves with w along the ray, and across it.
    let moved = DMat3::from_cols(v, j[0] / s, j[1] / s);
    let start = DMat3::from_cols(ray.v, ray.spread[0], ray.spread[1]);
    Some(Exponential {
        point: step.position(s),
        velocity: v * s,
        differential: moved * start.inverse(),
        rotation: step.rotation(s)?,
    })
}

/// The shares of paths that end neither at an exit nor at anything in their way, and the length that would
/// do.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct UnfinishedPaths {
    /// Share of the paths whose length is used up.
    pub length: f64,
    /// Share of the paths that the metric ends.
    pub singular: f64,
    /// The length by which all but a negligible share of the paths would end at an exit or at something in
    /// their way; `None` if that is not known, or if no length tried is enough.
    pub enough: Option<f64>,
    /// How far a sample of the paths that ended by length was followed; `None` if none was.
    pub tried: Option<f64>,
}

/// Share of paths that may end by their length without a word: single dark pixels, as beside any photon
/// sphere, where the time that light takes grows without bound.
const NEGLIGIBLE: f64 = 1e-3;

/// The most paths that are followed farther: the share that is left is then known to a fifth of a percent of
/// them.
const SAMPLE: usize = 512;

/// Factor by which they are followed farther, at most: it bounds the work where paths never end.
const FARTHER: f64 = 16.0;

impl UnfinishedPaths {
    /// Computes the shares of `all` paths of which so many ended by length and so many where the metric ends.
    pub fn counted(by_length: usize, singular: usize, all: usize) -> Self {
        let share = |count: usize| count as f64 / all.max(1) as f64;
        Self {
            length: share(by_length),
            singular: share(singular),
            ..Self::default()
        }
    }

    /// Tells whether so few paths end by length or where the metric ends that nobody misses them.
    pub fn is_negligible(&self) -> bool {
        self.length <= NEGLIGIBLE && self.singular <= NEGLIGIBLE
    }

    /// Chooses those of the paths that ended by length which are followed farther, evenly.
    pub fn sample<T: Copy>(by_length: &[T]) -> Vec<T> {
        let stride = by_length.len().div_ceil(SAMPLE).max(1);
        by_length.iter().step_by(stride).copied().collect()
    }

    /// Finds the length that would do, where `ends` gives the arc lengths at which the [`sample`](Self::sample)
    /// of the paths that ended by `length` ends when it is followed over a given length: `None` for each that
    /// goes on even there.
    pub fn followed(mut self, length: f64, ends: impl FnOnce(f64) -> Vec<Option<f64>>) -> Self {
        if self.length <= NEGLIGIBLE {
            return self;
        }
        let tried = FARTHER * length;
        let mut ends: Vec<f64> = ends(tried)
            .into_iter()
            .map(|end| end.unwrap_or(f64::INFINITY))
            .collect();
        ends.sort_by(f64::total_cmp);
        // So many of the sample may go on.
        let spared = (NEGLIGIBLE / self.length * ends.len() as f64) as usize;
        let decides = ends.len().checked_sub(1 + spared).map(|i| ends[i]);
        if decides.is_none_or(|s| s <= length) {
            // Others than they ended early, as paths of a table may: no length helps.
            return self;
        }
        self.enough = decides.filter(|s| s.is_finite()).map(rounded_up);
        self.tried = Some(tried);
        self
    }

    /// Writes a warning that tells the share of unfinished paths and the length that would do; `None` where the share
    /// is negligible. `who` names the paths and what becomes of them, `remedy` how they are made longer.
    pub fn warning(&self, who: &str, remedy: &str) -> Option<String> {
        if self.is_negligible() {
            return None;
        }
        let percent = 100.0 * NEGLIGIBLE;
        let advice = match (self.enough, self.tried) {
            (Some(enough), _) => {
                format!("; a length of {enough} would do for all but {percent} % ({remedy})")
            }
            (None, Some(tried)) => format!(
                "; even a length of {tried} is not enough: these paths take longer, as those do that wind around a photon sphere, or never leave"
            ),
            (None, None) => String::new(),
        };
        Some(format!("{who}: {self}{advice}"))
    }
}

impl fmt::Display for UnfinishedPaths {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [length, singular] = [self.length, self.singular].map(|share| 100.0 * share);
        write!(f, "{length:.2} % of paths end by their length")?;
        match self.singular > 0.0 {
            true => write!(
                f,
                ", {singular:.2} % where the metric ends or after {MOST_STEPS} steps"
            ),
            false => Ok(()),
        }
    }
}

/// Rounds up to two digits.
fn rounded_up(x: f64) -> f64 {
    let unit = 10_f64.powf(x.log10().floor() - 1.0);
    // Without the trailing digits that the product brings.
    let text = format!("{:.1e}", unit * (x / unit - 1e-9).ceil());
    text.parse().unwrap_or(x)
}

/// Follows `rays` and returns how and at which arc length each ends.
pub fn ends_alone(manifold: &Manifold, settings: Settings, rays: &[Ray]) -> Vec<(End, f64)> {
    let mut sink = EndsAlone(vec![(End::Length, 0.0); rays.len()]);
    follow(manifold, settings, rays.iter().copied(), &mut sink);
    sink.0
}

/// Keeps the ends of rays.
struct EndsAlone(Vec<(End, f64)>);

impl Sink for EndsAlone {
    fn wants(&self, _: usize, _: f64) -> bool {
        false
    }

    fn wants_carried(&self) -> bool {
        false
    }

    fn step(&mut self, _: usize, _: &Step) {}

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        self.0[ray] = (end, s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::SourceText;

    #[test]
    fn the_length_that_would_do_leaves_a_negligible_share() {
        // A tenth of all ends by length; those of the sample end at 10.01 to 20 evenly.
        let found = UnfinishedPaths::counted(1000, 0, 10_000).followed(9.0, |tried| {
            assert_eq!(tried, 144.0);
            (1..=500)
                .map(|k| Some(10.0 + 0.02 * f64::from(k)))
                .collect()
        });
        // A hundredth of the tenth, five of the sample, may go on: beyond 19.9.
        assert_eq!(found.enough, Some(20.0));
        let text = found.warning("the picture", "--length").unwrap();
        assert!(
            text.contains("10.00 % of paths end by their length"),
            "{text}"
        );
        assert!(text.contains("a length of 20 would do"), "{text}");
    }

    #[test]
    fn paths_that_never_end_are_told_from_those_that_are_too_short() {
        let half = |_| (0..100).map(|k| (k % 2 == 0).then_some(12.0)).collect();
        let found = UnfinishedPaths::counted(10, 0, 100).followed(5.0, half);
        assert_eq!((found.enough, found.tried), (None, Some(80.0)));
        let text = found.warning("the picture", "--length").unwrap();
        assert!(text.contains("even a length of 80 is not enough"), "{text}");
        // Exact paths end, where those of a table did not.
        let within = UnfinishedPaths::counted(10, 0, 100).followed(5.0, |_| vec![Some(4.9); 10]);
        let text = within.warning("the picture", "--length").unwrap();
        assert!(!text.contains("a length of"), "{text}");
        // Too few to matter: nothing is followed and nothing said.
        let few = UnfinishedPaths::counted(1, 0, 2000).followed(5.0, |_| unreachable!());
        assert_eq!(few.warning("the picture", "--length"), None);
    }

    #[test]
    fn lengths_are_rounded_up_to_two_digits() {
        let rounded = [91.98, 92.0, 92.1, 120.0, 0.123, 8.0].map(rounded_up);
        assert_eq!(rounded, [92.0, 92.0, 93.0, 120.0, 0.13, 8.0]);
    }

    #[test]
    fn rays_end_where_they_meet_the_exit_and_not_at_their_length() {
        let text = r#"
            name = "flat"
            coordinates = ["x", "y", "z"]
            metric = { conformal = "1" }
            [[exit]]
            name = "sky"
            when = "x - 4"
        "#;
        let source = SourceText::new("flat.toml", text);
        let manifold = Manifold::from_source(source, &[]).unwrap();
        let rays = [DVec3::X, DVec3::Y].map(|d| Ray::new(&manifold, DVec3::ZERO, d, 9.0));
        let settings = Settings::bare(1e-9).with_events();
        let [(out, s), along] = ends_alone(&manifold, settings, &rays)[..] else {
            unreachable!("two rays")
        };
        assert!(out == End::Exit(0) && (s - 4.0).abs() < 1e-9);
        assert_eq!(along, (End::Length, 9.0));
    }
}
