//! Paths in a table behind their ends, where they run into a singularity.
//!
//! In: the parameters at which a path ends for all who see it, and at which its space does. Out: a smooth
//! change of its parameter ([`Slowing`]) that leaves everything before the end as it is, and comes to
//! rest before the singularity.
//!
//! A table holds paths over its whole length, smooth as far as polynomials see, and nobody looks behind
//! their ends. Where only the metric bends light, paths come to rest near a horizon by themselves. In a
//! wind they cross it, and reach the singularity soon after, faster than anything: continued straight
//! from there, Kerr's hole seen from one place took twice the bytes, and most rays into the hole were
//! given up.

/// Changes the parameter of a path such that it stands still in the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slowing {
    /// Where it begins.
    from: f64,
    /// Over how long the speed falls to a half.
    scale: f64,
}

/// The scale as a share of what is left up to the singularity: the way left in the end is 1.11 times it.
const SHARE: f64 = 0.5;

impl Slowing {
    /// Begins at `end`, and comes to rest before the singularity at `last`.
    pub fn new(end: f64, last: f64) -> Self {
        Self {
            from: end,
            scale: SHARE * (last - end),
        }
    }

    /// Returns the path's own parameter at `s` of the table, and its speed there: 1, and from the end on
    /// `1/(1 + t⁴)` with t counted in scales.
    pub fn at(self, s: f64) -> (f64, f64) {
        let t = (s - self.from) / self.scale;
        match t > 0.0 {
            true => (self.from + self.scale * way(t), 1.0 / (1.0 + t.powi(4))),
            false => (s, 1.0),
        }
    }
}

/// Computes `∫ 1/(1 + x⁴) dx` from 0 to `t`.
fn way(t: f64) -> f64 {
    let root = std::f64::consts::SQRT_2;
    // Far away the difference of two large squares would be rounding.
    let ratio = 2.0 * root * t / (t * t - root * t + 1.0);
    let angles = (root * t + 1.0).atan() + (root * t - 1.0).atan();
    ratio.ln_1p() / (4.0 * root) + angles / (2.0 * root)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_changes_before_the_end_and_the_singularity_is_never_reached() {
        let slowing = Slowing::new(3.0, 4.0);
        assert_eq!(slowing.at(2.9), (2.9, 1.0));
        for s in [3.0, 3.3, 4.0, 9.0, 1e6] {
            let (at, speed) = slowing.at(s);
            assert!((3.0..3.6).contains(&at) && speed <= 1.0, "{s} {at} {speed}");
        }
        assert!((way(1e9) - std::f64::consts::PI / 8.0_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_speed_is_the_derivative_of_the_parameter() {
        let slowing = Slowing::new(1.0, 5.0);
        for s in [0.5, 1.0, 1.4, 3.0, 8.0] {
            let h = 1e-5;
            let difference = (slowing.at(s + h).0 - slowing.at(s - h).0) / (2.0 * h);
            assert!((difference - slowing.at(s).1).abs() < 1e-9);
        }
    }
}
