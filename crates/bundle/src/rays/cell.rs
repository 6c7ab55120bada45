//! Cells of camera parameters, both ways.
//!
//! In: how many equal cells each camera interval is divided into, and parameters. Out: the cell that
//! holds them and the parameters in it, in [−1, 1], and back.

/// The cell that holds `parameters`, and the parameters in it.
pub fn locate(
    cells: &[usize],
    intervals: &[[f64; 2]],
    parameters: &[f64],
) -> (Vec<usize>, Vec<f64>) {
    let axes = cells.iter().zip(intervals).zip(parameters);
    let along = axes.map(|((&n, [low, high]), p)| {
        let t = if high > low {
            (p - low) / (high - low) * n as f64
        } else {
            0.5
        };
        let k = (t.max(0.0) as usize).min(n - 1);
        (k, (2.0 * (t - k as f64) - 1.0).clamp(-1.0, 1.0))
    });
    along.unzip()
}

/// The parameters at `inner` of `cell`: the inverse of [`locate`].
pub fn parameters(
    cells: &[usize],
    intervals: &[[f64; 2]],
    cell: &[usize],
    inner: &[f64],
) -> Vec<f64> {
    let axes = cells.iter().zip(intervals).zip(cell.iter().zip(inner));
    let along = axes.map(|((&n, [low, high]), (&k, x))| {
        let t = (k as f64 + 0.5 * (x + 1.0)) / n as f64;
        low + (high - low) * t
    });
    along.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_come_back() {
        let (cells, intervals) = ([2, 3], [[0.0, 1.0], [-1.0, 1.0]]);
        let (cell, inner) = locate(&cells, &intervals, &[0.75, 1.0]);
        assert_eq!((&cell, &inner), (&vec![1, 2], &vec![0.0, 1.0]));
        assert_eq!(parameters(&cells, &intervals, &cell, &inner), [0.75, 1.0]);
    }
}
