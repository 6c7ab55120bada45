//! Random numbers that depend on nothing but their key: the same for any thread, tile or resume
//! order; and places that look random but are spread evenly.
//!
//! In: a key of several numbers. Out: uniform numbers, directions, rotations. The hash is
//! SplitMix64's finaliser (Steele, Lea, Flood, 2014) chained over the key.

use glam::{DQuat, DVec3};
use std::f64::consts::TAU;

/// A stream of random numbers for one key.
#[derive(Debug, Clone)]
pub struct Stream {
    state: u64,
}

/// The finaliser of SplitMix64: a bijection of 64-bit numbers that looks random.
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// The golden ratio in 64 bits: steps of the counter.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

impl Stream {
    /// The stream of `key`.
    pub fn new(key: &[u64]) -> Self {
        let state = key
            .iter()
            .fold(STEP, |state, &k| mix(state ^ mix(k.wrapping_add(STEP))));
        Self { state }
    }

    /// The next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(STEP);
        mix(self.state)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform over the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        let z = self.between(-1.0, 1.0);
        let phi = TAU * self.uniform();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * phi.cos(), r * phi.sin(), z)
    }

    /// Uniform over rotations (Shoemake, *Uniform Random Rotations*, 1992).
    pub fn rotation(&mut self) -> DQuat {
        let (u, a, b) = (self.uniform(), TAU * self.uniform(), TAU * self.uniform());
        let (r, s) = ((1.0 - u).sqrt(), u.sqrt());
        DQuat::from_xyzw(r * a.sin(), r * a.cos(), s * b.sin(), s * b.cos())
    }
}

/// Returns direction number `i` of `count` spread evenly over the sphere: a Fibonacci lattice, each a golden angle further round than
/// the one before.
pub fn fibonacci_direction(i: usize, count: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
    let phi = i as f64 * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * phi.cos(), r * phi.sin(), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_numbers_have_the_right_moments() {
        let mut stream = Stream::new(&[1, 2, 3]);
        let n = 100_000;
        let numbers: Vec<f64> = (0..n).map(|_| stream.uniform()).collect();
        let mean = numbers.iter().sum::<f64>() / f64::from(n);
        let square = numbers.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
        assert!((mean - 0.5).abs() < 4e-3 && (square - 1.0 / 3.0).abs() < 4e-3);
    }

    #[test]
    fn directions_have_no_preferred_axis() {
        let mut stream = Stream::new(&[7]);
        let mean = (0..50_000).map(|_| stream.direction()).sum::<DVec3>() / 50_000.0;
        assert!(mean.length() < 0.015);
    }
}
