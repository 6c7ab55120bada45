//! Paths that were not followed far enough, and how far they would have to be.
//!
//! In: how many of some paths ended by their length, and at what arc length a sample of those ends
//! when it is followed farther. Out: [`UnfinishedPaths`], in shares of all paths. What such a path would
//! have met farther on is not known, so that a picture shows nothing there.

use super::{End, Ray, Settings, Sink, Step, follow};
use crate::manifold::Manifold;
use serde::Serialize;
use std::fmt;

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
        self.enough = decides.filter(|s| s.is_finite()).map(rounded_up);
        self.tried = Some(tried);
        self
    }

    /// Says what share is missing and which length would do; `None` where nobody misses it. `who` names the
    /// paths and what becomes of them.
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
                "; even a length of {tried} is not enough: paths wind around, as at a photon sphere, or never leave"
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
            true => write!(f, ", {singular:.2} % where the metric ends"),
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

/// Follows `rays` and returns the arc length at which each meets an exit; `None` for one that does not.
pub fn end_lengths(manifold: &Manifold, rays: &[Ray], tolerance: f64) -> Vec<Option<f64>> {
    let settings = Settings::bare(tolerance).with_events();
    let mut sink = EndLengths(vec![None; rays.len()]);
    follow(manifold, settings, rays.iter().copied(), &mut sink);
    sink.0
}

/// Keeps the ends of rays.
struct EndLengths(Vec<Option<f64>>);

impl Sink for EndLengths {
    fn wants(&self, _: usize, _: f64) -> bool {
        false
    }

    fn wants_carried(&self) -> bool {
        false
    }

    fn step(&mut self, _: usize, _: &Step) {}

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        self.0[ray] = matches!(end, End::Exit(_)).then_some(s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::SourceText;
    use glam::DVec3;

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
        let [out, along] = end_lengths(&manifold, &rays, 1e-9)[..] else {
            unreachable!("two rays")
        };
        assert!((out.unwrap() - 4.0).abs() < 1e-9);
        assert_eq!(along, None);
    }
}
