//! Lines through a box on which needs are looked at.
//!
//! In: an axis of a box. Out: rays along it through given ones, whose coefficients tell how many nodes
//! that axis needs. Along a face they are those of polynomials. Around the whole sphere they are waves:
//! along its parallels, and, for the polar angle, around whole meridians.

use geofan_bundle::{Variables, spherical};

/// What series along a line are made of.
#[derive(Debug, Clone, Copy)]
pub enum Basis {
    /// Chebyshev polynomials.
    Polynomials,
    /// Sines and cosines.
    Waves,
}

/// Lines along one axis.
pub enum Sweep {
    /// Between its ends, or around its circle, at these places.
    Along(usize, Vec<f64>, Basis),
    /// Around meridians, of these angles (in half turns from the pole); the polar angle is this axis.
    Meridian(usize, Vec<f64>),
}

impl Sweep {
    /// Along `axis`, with at least as many rays as are needed to tell up to `most` nodes.
    pub fn new(variables: Variables, axis: usize, most: usize) -> Self {
        match (variables.sphere, axis.checked_sub(variables.cameras)) {
            (true, Some(1)) => {
                let around = spherical::azimuths(2 * most - 1);
                Self::Meridian(axis, around.iter().map(|a| a + 1.0).collect())
            }
            (true, Some(0)) => Self::Along(axis, variables.places(axis, most), Basis::Waves),
            _ => Self::Along(axis, variables.places(axis, most), Basis::Polynomials),
        }
    }

    /// What its series are made of.
    pub fn basis(&self) -> Basis {
        match self {
            Self::Along(_, _, basis) => *basis,
            Self::Meridian(..) => Basis::Waves,
        }
    }

    /// How many rays a line has.
    pub fn count(&self) -> usize {
        match self {
            Self::Along(_, places, _) | Self::Meridian(_, places) => places.len(),
        }
    }

    /// The nodes that the axis needs if a line needs so many terms.
    pub fn nodes(&self, terms: usize) -> usize {
        match self {
            Self::Along(_, _, Basis::Polynomials) => terms,
            // Both waves of each number.
            Self::Along(_, _, Basis::Waves) => terms | 1,
            Self::Meridian(..) => terms / 2 + 1,
        }
    }

    /// The parameters of the line's rays through the ray with parameters `x`.
    pub fn through(&self, x: &[f64]) -> Vec<Vec<f64>> {
        let at = |place: &f64| {
            let mut x = x.to_vec();
            match self {
                Self::Along(axis, ..) => x[*axis] = *place,
                Self::Meridian(axis, _) if *place <= 1.0 => x[*axis] = 2.0 * place - 1.0,
                // Beyond the other pole.
                Self::Meridian(axis, _) => {
                    x[*axis] = 2.0 * (2.0 - place) - 1.0;
                    x[axis - 1] += if x[axis - 1] < 0.0 { 1.0 } else { -1.0 };
                }
            }
            x
        };
        match self {
            Self::Along(_, places, _) | Self::Meridian(_, places) => {
                places.iter().map(at).collect()
            }
        }
    }
}
