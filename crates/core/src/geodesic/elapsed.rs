//! How much time light has taken.
//!
//! In: a [`Path`] through a manifold. Out: the time of the spacetime that passes along it. Without a drift
//! that is the path's own parameter; with one it is `∫ (1 + b(v)) ds`, by Gauss's rule on every step.

use super::Path;
use crate::manifold::Manifold;

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
