//! A whole geodesic with dense output.

use super::{End, Ray, Settings, Sink, Step, follow};
use crate::manifold::Manifold;

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
    let mut kept = Kept(Vec::new());
    follow(manifold, settings, rays, &mut kept);
    kept.0
}

/// Follows `rays` and keeps the last step of each, with the arc length at which it ended; `None`
/// for a ray that ended at its start.
pub fn ends(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
) -> Vec<Option<(Step, f64)>> {
    let mut last = Last(Vec::new());
    follow(manifold, settings, rays, &mut last);
    last.0
}

struct Last(Vec<Option<(Step, f64)>>);

impl Sink for Last {
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

struct Kept(Vec<Path>);

impl Kept {
    fn path(&mut self, ray: usize) -> &mut Path {
        while self.0.len() <= ray {
            self.0.push(Path {
                steps: Vec::new(),
                end: End::Length,
                length: 0.0,
                tried: 0,
            });
        }
        &mut self.0[ray]
    }
}

impl Sink for Kept {
    fn step(&mut self, ray: usize, step: &Step) {
        self.path(ray).steps.push(step.clone());
    }

    fn end(&mut self, ray: usize, end: End, s: f64, steps: usize) {
        let path = self.path(ray);
        (path.end, path.length, path.tried) = (end, s, steps);
    }
}
