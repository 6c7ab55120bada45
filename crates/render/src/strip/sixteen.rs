//! Sixteen paths of strips at once.
//!
//! In: their rungs and arc lengths. Out: points and tangents there.

use super::{FamilyPath, NODES, PLANE};
use crate::lanes::{LANES, Lanes, Points, each};
use geofan_expr::vectorised;

/// Points and tangents of sixteen paths at ascending arc lengths: what strips know there is made ready once
/// for all their paths.
pub(crate) fn refine_sixteen(rungs: &[FamilyPath<'_, '_>; LANES], s: &[f64]) -> Vec<[Points; 2]> {
    let mut states = vec![[[[0.0; LANES]; 3]; 2]; s.len()];
    let mut sums = vec![[[0.0; LANES]; PLANE]; s.len()];
    vectorised(
        #[inline(always)]
        || {
            for (l, rung) in rungs.iter().enumerate() {
                // Once for each strip, by the first of its paths.
                if !rungs[..l].iter().any(|other| other.is_beside(rung)) {
                    add_strip(rung, rungs, s, &mut sums);
                }
            }
            for (state, sums) in states.iter_mut().zip(&sums) {
                for c in 0..3 {
                    let x = each(|l| rungs[l].rotation.x_axis[c]);
                    let y = each(|l| rungs[l].rotation.y_axis[c]);
                    state[0][c] = each(|l| x[l] * sums[0][l] + y[l] * sums[1][l]);
                    state[1][c] = each(|l| x[l] * sums[2][l] + y[l] * sums[3][l]);
                }
            }
        },
    );
    states
}

/// Adds what those of `rungs` that are in the strip of `one` are in the stored plane.
#[inline(always)]
fn add_strip(
    one: &FamilyPath<'_, '_>,
    rungs: &[FamilyPath<'_, '_>; LANES],
    s: &[f64],
    sums: &mut [[Lanes; PLANE]],
) {
    let mut weights = [[0.0; LANES]; NODES];
    for (l, rung) in rungs
        .iter()
        .enumerate()
        .filter(|(_, rung)| rung.is_beside(one))
    {
        for degree in 0..NODES {
            weights[degree][l] = rung.weights[degree];
        }
    }
    for (sums, place) in sums.iter_mut().zip(one.strip.along(s)) {
        let mut more = *sums;
        for (weights, coefficients) in weights.iter().zip(&place.coefficients()) {
            for c in 0..PLANE {
                for l in 0..LANES {
                    more[c][l] += weights[l] * coefficients[c];
                }
            }
        }
        *sums = more;
    }
}
