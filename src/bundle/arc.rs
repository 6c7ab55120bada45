//! One path of a patch along the arc length.
//!
//! In: what a patch stores for one path, rows of channels: the displacement at the start of the
//! patch's arc lengths if that is not the start of the path, and the Chebyshev coefficients of the
//! departure's slope ([`Lift::slope`](crate::fan::Lift::slope)). Out: departures and slopes at arc
//! lengths, and the points and tangents there. The departure is the integral of its slope, coefficient by coefficient (L. N. Trefethen,
//! *Approximation Theory and Approximation Practice*, exercise 2.8 and chapter 21):
//! `b_k = h (a_{k−1} − a_{k+1})/2k`, with `a₀` doubled, for `h` half the length of the interval.

use crate::{
    expr::vectorised,
    fan::{FanSpace, Start},
};
use glam::DVec3;

/// Departures and their slopes in the arc length: four channels each, at `W` arc lengths.
pub type Sums<const W: usize> = [[[f64; W]; 4]; 2];

/// Whether patches of the arc lengths `interval` store where they start.
pub fn stores_start(interval: [f64; 2]) -> bool {
    interval[0] > 0.0
}

/// Appends to `rows`, for each degree, the coefficients of the departures and then those of the
/// slopes, from what is `stored` for one path. Returns how many degrees there are.
pub fn unfold(stored: &[f64], channels: usize, interval: [f64; 2], rows: &mut Vec<f64>) -> usize {
    let (start, slopes) = match stores_start(interval) {
        true => stored.split_at(channels),
        false => (&[][..], stored),
    };
    let half = 0.5 * (interval[1] - interval[0]);
    let degrees = slopes.len() / channels + 1;
    let first = rows.len();
    rows.resize(first + 2 * channels * degrees, 0.0);
    let rows = &mut rows[first..];
    for (row, slope) in rows
        .chunks_exact_mut(2 * channels)
        .zip(slopes.chunks_exact(channels))
    {
        row[channels..].copy_from_slice(slope);
    }
    for c in 0..channels {
        let slope = |k: usize| slopes.get(k * channels + c).copied().unwrap_or(0.0);
        let mut constant = start.get(c).map_or(0.0, |d| d * interval[0]);
        for k in 1..degrees {
            let before = if k == 1 { 2.0 } else { 1.0 } * slope(k - 1);
            let departure = half * (before - slope(k + 1)) / (2 * k) as f64;
            rows[2 * channels * k + c] = departure;
            // T_k(−1) = ±1: the departure starts where it is stored to.
            constant -= if k % 2 == 0 { departure } else { -departure };
        }
        rows[c] = constant;
    }
    degrees
}

/// Chebyshev sums of unfolded `rows` at `W` arc lengths of their interval at once.
pub fn sums<const W: usize>(
    rows: &[f64],
    channels: usize,
    [low, high]: [f64; 2],
    s: &[f64; W],
) -> Sums<W> {
    let scale = 2.0 / (high - low);
    let mut sums = [[[0.0; W]; 4]; 2];
    vectorised(
        #[inline(always)]
        || {
            let t = s.map(|s| scale * (s - low) - 1.0);
            let (mut value, mut next) = ([1.0; W], t);
            for row in rows.chunks_exact(2 * channels) {
                for (kind, sums) in sums.iter_mut().enumerate() {
                    for (c, x) in row[kind * channels..][..channels].iter().enumerate() {
                        for l in 0..W {
                            sums[c][l] += value[l] * x;
                        }
                    }
                }
                for l in 0..W {
                    (value[l], next[l]) = (next[l], 2.0 * t[l] * next[l] - value[l]);
                }
            }
        },
    );
    sums
}

/// Chart point and tangent of the stored ray from `start` at arc length `s`, whose departure and slope
/// are in the lane `lane` of `sums`.
#[inline]
pub fn state<const W: usize>(
    space: &FanSpace,
    start: &Start,
    sums: &Sums<W>,
    lane: usize,
    s: f64,
) -> (DVec3, DVec3) {
    let [mut departure, mut slope] = [[0.0; 4]; 2];
    for (k, channel) in space.channels().iter().enumerate() {
        departure[*channel] = sums[0][k][lane];
        slope[*channel] = sums[1][k][lane];
    }
    space.lift().state(start, departure, slope, s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One channel: 0.3 T₀ − 0.2 T₁ + 0.1 T₂ + 0.05 T₃ in t.
    fn slope(t: f64) -> f64 {
        0.3 - 0.2 * t + 0.1 * (2.0 * t * t - 1.0) + 0.05 * (4.0 * t * t * t - 3.0 * t)
    }

    #[test]
    fn the_departure_is_the_integral_of_the_slope_from_where_it_starts() {
        let coefficients = [0.3, -0.2, 0.1, 0.05];
        for (interval, stored) in [
            ([0.0, 3.0], coefficients.to_vec()),
            ([2.0, 3.0], [&[0.7][..], &coefficients].concat()),
        ] {
            let mut rows = Vec::new();
            assert_eq!(unfold(&stored, 1, interval, &mut rows), 5);
            let at = |s: f64| sums(&rows, 1, interval, &[s]);
            let [low, high] = interval;
            assert!((at(low)[0][0][0] - 0.7 * low).abs() < 1e-14);
            let step = 1e-3;
            let mut integral = at(low)[0][0][0];
            let mut s = low;
            while s < high - 0.5 * step {
                let t = |s: f64| 2.0 * (s - low) / (high - low) - 1.0;
                let [a, b, c] = [s, s + 0.5 * step, s + step].map(|s| slope(t(s)));
                integral += step * (a + 4.0 * b + c) / 6.0;
                s += step;
                let found = at(s);
                assert!((found[0][0][0] - integral).abs() < 1e-12);
                assert!((found[1][0][0] - c).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_patch_without_slopes_is_straight() {
        let mut rows = Vec::new();
        assert_eq!(unfold(&[0.5, -0.25], 2, [4.0, 8.0], &mut rows), 1);
        let found = sums(&rows, 2, [4.0, 8.0], &[7.0]);
        assert_eq!(found[0][0][0], 2.0);
        assert_eq!(found[0][1][0], -1.0);
        assert_eq!(found[1][0][0], 0.0);
    }
}
