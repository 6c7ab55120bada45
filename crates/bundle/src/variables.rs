//! How the parameters of a ray enter the polynomials of a patch.

use super::{chebyshev, spherical, stretch::MappedChebyshev};
use geofan_expr::real::Real;

/// The variables of a patch over (camera…, direction…).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variables {
    /// Camera axes.
    pub cameras: usize,
    /// Of the parameters of cameras and of faces of directions.
    pub stretch: MappedChebyshev,
    /// Whether the directions are the whole sphere (azimuth and polar angle, see [`spherical`]), not a
    /// face or a part of one.
    pub sphere: bool,
}

/// The values of the terms along each of the first axes.
pub(super) type Weights<T> = Vec<Vec<T>>;

impl Variables {
    /// Of a face of directions, or a part of one.
    pub const fn of_face(cameras: usize, stretch: MappedChebyshev) -> Self {
        Self {
            cameras,
            stretch,
            sphere: false,
        }
    }

    /// The values of the terms along the first axes of `shape` at `parameters` in [−1, 1], one for each
    /// of those axes. Coefficients are to be summed with each of the sets of weights: on the sphere there
    /// are two, for even and odd multiples of the azimuth.
    pub(super) fn weights<T: Real>(self, shape: &[usize], parameters: &[f64]) -> Vec<Weights<T>> {
        let count = match self.sphere {
            true => parameters.len().min(self.cameras),
            false => parameters.len(),
        };
        let along = |(x, n): (&f64, &usize)| {
            let mut values = vec![0.0; *n];
            chebyshev::values(self.stretch.variable(*x), &mut values);
            values.into_iter().map(T::from_f64).collect()
        };
        let plain: Weights<T> = parameters[..count].iter().zip(shape).map(along).collect();
        let [Some(a), Some(b)] = [0, 1].map(|k| parameters.get(count + k)) else {
            return vec![plain];
        };
        let sets = [false, true].map(|odd| {
            let [mut azimuth, mut polar] = [0, 1].map(|k| vec![0.0; shape[count + k]]);
            spherical::azimuth_values_of(odd, *a, &mut azimuth);
            spherical::polar_values(*b, odd, &mut polar);
            let mut weights = plain.clone();
            weights.extend([azimuth, polar].map(|v| v.into_iter().map(T::from_f64).collect()));
            weights
        });
        sets.into()
    }

    /// Where `count` nodes lie along `axis`, in [−1, 1].
    pub fn places(self, axis: usize, count: usize) -> Vec<f64> {
        match self
            .sphere
            .then(|| axis.checked_sub(self.cameras))
            .flatten()
        {
            Some(0) => spherical::azimuths(count),
            Some(_) => spherical::polar_angles(count),
            None => {
                let nodes = chebyshev::nodes(count);
                nodes.iter().map(|y| self.stretch.place(*y)).collect()
            }
        }
    }
}
