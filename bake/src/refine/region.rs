//! A box of the table.

use geofan_bundle::{
    MappedChebyshev, Variables,
    rays::{FACES, parallel},
};
use geofan_core::random::Stream;

/// A box of the table: an interval of [−1, 1] of each axis of the chunk, and its place in the tree.
#[derive(Debug, Clone)]
pub struct Region {
    /// Intervals of the axes camera…, direction…, arc length.
    pub intervals: Vec<[f64; 2]>,
    /// The face of its directions; `None` if it has the whole sphere of them.
    pub face: Option<usize>,
    /// The share of the chunk's rays and of their lengths.
    pub share: f64,
    /// One number for each halving, after those of the chunk: names the box.
    pub path: Vec<u64>,
}

impl Region {
    /// The whole of a chunk of so many axes and of the directions of `face`, named by `path`.
    pub fn whole(axes: usize, face: Option<usize>, path: Vec<u64>) -> Self {
        Self {
            intervals: vec![[-1.0, 1.0]; axes],
            face,
            share: 1.0,
            path,
        }
    }

    /// The faces of the whole sphere.
    pub fn faces(&self) -> Vec<Self> {
        let face = |face: usize| Self {
            face: Some(face),
            share: self.share / FACES as f64,
            path: [&self.path[..], &[(2 * self.intervals.len() + face) as u64]].concat(),
            ..self.clone()
        };
        (0..FACES).map(face).collect()
    }

    /// How the parameters of its rays enter polynomials.
    pub fn variables(&self, cameras: usize, stretch: MappedChebyshev) -> Variables {
        Variables {
            cameras,
            stretch,
            sphere: self.face.is_none(),
        }
    }

    /// Random parameters of a ray, in [−1, 1]: all directions of the sphere are equally likely, and all
    /// parameters of a face.
    pub fn ray(&self, stream: &mut Stream) -> Vec<f64> {
        let axes = 0..self.arc();
        let mut x: Vec<f64> = axes.map(|_| stream.between(-1.0, 1.0)).collect();
        if let (None, Some(b)) = (self.face, x.last_mut()) {
            *b = parallel(*b);
        }
        x
    }

    /// The index of the arc length.
    pub fn arc(&self) -> usize {
        self.intervals.len() - 1
    }

    /// The share of the chunk's rays, whatever part of their length.
    pub fn volume(&self) -> f64 {
        let all = &self.intervals[..self.arc()];
        all.iter().map(|[a, b]| 0.5 * (b - a)).product()
    }

    /// How often the arc length was halved.
    pub fn arc_halvings(&self) -> u32 {
        let [a, b] = self.intervals[self.arc()];
        (2.0 / (b - a)).log2().round() as u32
    }

    /// The lower (0) or upper (1) half along `axis`.
    pub fn half(&self, axis: usize, side: usize) -> Self {
        let mut half = self.clone();
        let [a, b] = half.intervals[axis];
        half.intervals[axis][1 - side] = 0.5 * (a + b);
        half.share *= 0.5;
        half.path.push((2 * axis + side) as u64);
        half
    }

    /// The point of the box at `x` in [−1, 1] of `axis`.
    pub fn at(&self, axis: usize, x: f64) -> f64 {
        let [a, b] = self.intervals[axis];
        0.5 * (a + b) + 0.5 * (b - a) * x
    }

    /// The arc lengths of the box, of paths of `length`.
    pub fn arc_interval(&self, length: f64) -> [f64; 2] {
        self.intervals[self.arc()].map(|t| 0.5 * (t + 1.0) * length)
    }
}
