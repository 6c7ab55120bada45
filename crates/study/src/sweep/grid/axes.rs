//! Where a grid of fans has its nodes.
//!
//! In: the rays of a [`RaySpace`], a length and numbers of cells. Out: [`Axes`]: node positions along
//! every stored camera parameter, every direction parameter of a face, and the arc length. Nodes of
//! different faces on their common edge are stored twice.

use crate::sweep::Spacing;
use geofan_bundle::{chebyshev, rays::RaySpace};
use glam::DVec3;

impl Spacing {
    /// `count` nodes over [low, high].
    fn nodes(self, count: usize, [low, high]: [f64; 2]) -> Vec<f64> {
        let unit: Vec<f64> = match self {
            Self::Uniform => (0..count)
                .map(|i| 2.0 * i as f64 / (count.max(2) - 1) as f64 - 1.0)
                .collect(),
            Self::Chebyshev => chebyshev::nodes(count),
        };
        let at = |t: f64| 0.5 * ((high + low) + (high - low) * t);
        unit.into_iter().map(at).collect()
    }
}

/// The nodes of a grid of fans.
#[derive(Debug, Clone)]
pub struct Axes {
    /// Along each stored camera parameter.
    pub cameras: Vec<Vec<f64>>,
    /// Numbers of the faces.
    pub faces: Vec<usize>,
    /// Along each direction parameter, in [−1, 1], the same for every face.
    pub directions: Vec<Vec<f64>>,
    /// Arc lengths, ascending.
    pub lengths: Vec<f64>,
}

impl Axes {
    /// `counts` nodes along the axes (camera…, direction…, arc length) over all rays of `space`.
    pub fn new(space: &RaySpace, length: f64, counts: &[usize], spacing: Spacing) -> Self {
        let k = space.cameras().len();
        let cameras = space.cameras().iter().zip(counts);
        let directions = &counts[k..k + space.directions()];
        Self {
            cameras: cameras
                .map(|(interval, n)| spacing.nodes(*n, *interval))
                .collect(),
            faces: (0..space.faces()).collect(),
            directions: directions
                .iter()
                .map(|n| spacing.nodes(*n, [-1.0, 1.0]))
                .collect(),
            lengths: spacing.nodes(counts[counts.len() - 1], [0.0, length]),
        }
    }

    /// Nodes along camera…, face, direction…: what numbers the rays, the last running fastest.
    pub fn ray_shape(&self) -> Vec<usize> {
        let cameras = self.cameras.iter().map(Vec::len);
        let directions = self.directions.iter().map(Vec::len);
        cameras
            .chain([self.faces.len()])
            .chain(directions)
            .collect()
    }

    /// The number of rays.
    pub fn rays(&self) -> usize {
        self.ray_shape().iter().product()
    }

    /// The stored ray numbered `ray`: chart point and direction in the standard frame.
    pub fn ray(&self, space: &RaySpace, ray: usize) -> (DVec3, DVec3) {
        let shape = self.ray_shape();
        let mut place = vec![0; shape.len()];
        let mut rest = ray;
        for (at, n) in place.iter_mut().zip(&shape).rev() {
            (*at, rest) = (rest % n, rest / n);
        }
        let k = self.cameras.len();
        let pick = |nodes: &[Vec<f64>], at: &[usize]| -> Vec<f64> {
            nodes.iter().zip(at).map(|(n, i)| n[*i]).collect()
        };
        let camera = pick(&self.cameras, &place[..k]);
        let direction = pick(&self.directions, &place[k + 1..]);
        space.ray(self.faces[place[k]], &camera, &direction)
    }
}
