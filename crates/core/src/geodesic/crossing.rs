//! Where a continuous function becomes positive.

/// The `s` in `[low, high]` at which `value`, not positive at `low` and positive at `high`, becomes
/// positive, to rounding: the Illinois method (M. Dowell and P. Jarratt, BIT 11 (1971) 168–174), with
/// a bisection whenever three rounds did not halve the interval, so that no shape of function can make
/// it crawl. Smooth functions take about ten looks.
pub fn crossing(low: f64, high: f64, mut value: impl FnMut(f64) -> f64) -> f64 {
    let (mut low, mut high) = (low, high);
    let (mut below, mut above) = (value(low).min(-0.0), value(high));
    let mut width = high - low;
    let mut was_above = None;
    for round in 1..100 {
        // Never nearer to an end than this: once a side has come close, one look across the crossing
        // closes the interval.
        let least = 2.0 * f64::EPSILON * high.abs();
        if high - low <= 2.0 * least {
            break;
        }
        let crawls = round % 3 == 0 && high - low > 0.5 * width;
        if round % 3 == 0 {
            width = high - low;
        }
        let share = (below / (below - above)).clamp(0.0, 1.0);
        let share = if share.is_finite() && !crawls {
            share
        } else {
            0.5
        };
        let s = (low + (high - low) * share).clamp(low + least, high - least);
        let v = value(s);
        if v > 0.0 {
            (high, above) = (s, v);
            below *= if was_above == Some(true) { 0.5 } else { 1.0 };
        } else {
            (low, below) = (s, v.min(-0.0));
            above *= if was_above == Some(false) { 0.5 } else { 1.0 };
            if v == 0.0 {
                return s;
            }
        }
        was_above = Some(v > 0.0);
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossings_are_found_to_rounding() {
        let root = crossing(0.0, 3.0, |s| s * s - 2.0);
        assert!((root - 2.0_f64.sqrt()).abs() < 1e-14);
        let late = crossing(0.0, 1.0, |s| (s - 0.999).powi(9));
        assert!((late - 0.999).abs() < 1e-2);
        assert_eq!(crossing(0.0, 4.0, |s| s - 3.0), 3.0);
        let mut looks = 0;
        let root = crossing(7.0, 7.8, |s| {
            looks += 1;
            s * s - 60.0
        });
        assert!(
            (root - 60.0_f64.sqrt()).abs() < 1e-14 && looks < 14,
            "{looks}"
        );
    }
}
