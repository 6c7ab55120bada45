//! The four numbers that every error report gives.
//!
//! In: any numbers, in any unit. Out: their median, 95th and 99th percentile and maximum, in the
//! same unit.

use serde::{Deserialize, Serialize};

/// Quantiles by nearest rank: `p95` is the smallest of the values that at least 95 % of all values
/// do not exceed, so each is one of the values given and none is interpolated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest value.
    pub max: f64,
}

impl Quantiles {
    /// The quantiles of `values`, which come back sorted. A NaN counts as infinite and is replaced
    /// so: an error that could not be computed must not look small. No values give zeros.
    pub fn of(values: &mut [f64]) -> Self {
        for value in values.iter_mut().filter(|value| value.is_nan()) {
            *value = f64::INFINITY;
        }
        values.sort_unstable_by(f64::total_cmp);
        let Some(&max) = values.last() else {
            return Self::default();
        };
        Self {
            p50: nearest_rank(values, 50),
            p95: nearest_rank(values, 95),
            p99: nearest_rank(values, 99),
            max,
        }
    }
}

/// The value of rank `ceil(percent / 100 * n)`, counted from 1, of sorted values; in integers,
/// because 0.95 * 20 in floating point need not be 19.
fn nearest_rank(sorted: &[f64], percent: usize) -> f64 {
    sorted[(percent * sorted.len()).div_ceil(100) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_numbers_give_their_own_ranks() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let quantiles = Quantiles::of(&mut values);
        let expected = Quantiles {
            p50: 50.0,
            p95: 95.0,
            p99: 99.0,
            max: 100.0,
        };
        assert_eq!(quantiles, expected);
    }

    #[test]
    fn few_numbers_take_the_next_rank_up() {
        let quantiles = Quantiles::of(&mut [3.0, 1.0, 2.0]);
        assert_eq!((quantiles.p50, quantiles.p95), (2.0, 3.0));
        assert_eq!(Quantiles::of(&mut [7.0]).p50, 7.0);
    }

    #[test]
    fn a_nan_counts_as_infinite_whatever_its_sign() {
        let quantiles = Quantiles::of(&mut [f64::NAN, 1.0, 2.0, 3.0, -f64::NAN]);
        assert_eq!(quantiles.p50, 3.0);
        assert_eq!(quantiles.max, f64::INFINITY);
    }

    #[test]
    fn no_numbers_give_zeros() {
        assert_eq!(Quantiles::of(&mut []), Quantiles::default());
    }

    #[test]
    fn quantiles_survive_json() {
        let quantiles = Quantiles::of(&mut [0.25, 0.5, 4.0]);
        let text = serde_json::to_string(&quantiles).unwrap();
        assert_eq!(text, r#"{"p50":0.5,"p95":4.0,"p99":4.0,"max":4.0}"#);
        assert_eq!(serde_json::from_str::<Quantiles>(&text).unwrap(), quantiles);
    }
}
