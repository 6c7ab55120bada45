//! Where cameras may be.
//!
//! In: expressions of 0 to 3 parameters, which may name the manifold's own, and their intervals. Out: [`CameraRegion`], which
//! maps parameters to chart points ([`CameraRegion::at`]) and back ([`CameraRegion::locate`]).

use super::description::digests;
use geofan_expr::{Digest, Tape};
use glam::{DMat3, DVec3};

/// A region of camera positions.
#[derive(Debug, Clone)]
pub struct CameraRegion {
    /// The names of the parameters.
    pub names: Vec<String>,
    /// Their intervals.
    pub intervals: Vec<[f64; 2]>,
    /// Whether the file says where cameras may be. Otherwise they may be anywhere within the limits of the
    /// coordinates, or, with a group, at its identity.
    pub written: bool,
    /// parameters -> u (3), then ∂u/∂parameter (3 for each parameter).
    pub(super) map: Tape,
}

/// Distance outside its interval, as a share of it, at which a parameter is still taken as on
/// the edge: rounding in the inverse map, far below any promise of accuracy.
const EDGE: f64 = 1e-9;

/// Parameters along each axis of the grid of a region of so many dimensions: about a thousand in all, for regions that are
/// bent a few dozen times.
const GRID: [usize; 4] = [1, 1024, 32, 10];

/// Parameters of the grid that are tried: the point may be closest to others than its own.
const CLOSE: usize = 8;

impl CameraRegion {
    /// The number of parameters.
    pub fn dimension(&self) -> usize {
        self.names.len()
    }

    /// Hashes where cameras may be: the intervals, and the points in them.
    pub fn digest(&self) -> Digest {
        let mut hasher = blake3::Hasher::new();
        for end in self.intervals.iter().flatten() {
            hasher.update(&end.to_bits().to_le_bytes());
        }
        hasher.update(&digests(&self.map)[..3].concat());
        *hasher.finalize().as_bytes()
    }

    /// The chart point at `parameters`.
    pub fn at(&self, parameters: &[f64]) -> DVec3 {
        DVec3::from_slice(&self.map.at(parameters)[..3])
    }

    /// The parameters at the fractions `t` in [0, 1] of their intervals.
    pub fn lerp(&self, t: &[f64]) -> Vec<f64> {
        self.intervals
            .iter()
            .zip(t)
            .map(|([low, high], t)| low + (high - low) * t)
            .collect()
    }

    /// Returns whether `parameters` lie in their intervals.
    pub fn contains(&self, parameters: &[f64]) -> bool {
        parameters
            .iter()
            .zip(&self.intervals)
            .all(|(p, [low, high])| {
                let slack = EDGE * (high - low);
                (low - slack..=high + slack).contains(p)
            })
    }

    /// The parameters whose point is `u`, by Gauss–Newton from several starts, and from those nearest to it of many where
    /// these lead elsewhere, as along a helix; `None` if `u` is not in the region. The point found agrees with `u` to a
    /// relative 1e-9.
    pub fn locate(&self, u: DVec3) -> Option<Vec<f64>> {
        self.locate_by(u, &|u, _| u)
    }

    /// Finds the parameters at whose point `value` is `u`; from a point and changes of it, `value`
    /// makes its own there, and its changes in their place.
    pub fn locate_by(
        &self,
        u: DVec3,
        value: &dyn Fn(DVec3, &mut [DVec3]) -> DVec3,
    ) -> Option<Vec<f64>> {
        let scale = self.size() + u.length() * 1e-3;
        if !scale.is_finite() {
            return None;
        }
        let mut starts = (0..3_usize.pow(self.dimension() as u32))
            .map(|i| [i % 3, i / 3 % 3, i / 9].map(|d| [0.5, 0.1, 0.9][d]))
            .map(|t| self.lerp(&t[..self.dimension()]));
        let is_there = |p: &Vec<f64>| {
            (value(self.at(p), &mut []) - u).length() <= 1e-9 * scale.max(f64::MIN_POSITIVE)
                && self.contains(p)
        };
        let from = |start| Some(self.descend(u, value, start)).filter(is_there);
        let found = starts.find_map(from);
        let found = found.or_else(|| self.close(u, value).find_map(from));
        found.map(|p| self.clamped(p))
    }

    /// Returns those of a grid of parameters at whose points `value` is closest to `u`, the closest first.
    fn close(
        &self,
        u: DVec3,
        value: &dyn Fn(DVec3, &mut [DVec3]) -> DVec3,
    ) -> impl Iterator<Item = Vec<f64>> {
        let k = self.dimension();
        let side = GRID[k];
        let place = move |i: usize| {
            let t = [i % side, i / side % side, i / side / side];
            self.lerp(&t.map(|t| (t as f64 + 0.5) / side as f64)[..k])
        };
        let distance = |i| (value(self.at(&place(i)), &mut []) - u).length_squared();
        let mut distances: Vec<f64> = (0..side.pow(k as u32)).map(distance).collect();
        (0..CLOSE).map_while(move |_| {
            let least = |a: &usize, b: &usize| distances[*a].total_cmp(&distances[*b]);
            let i = (0..distances.len()).min_by(least)?;
            let taken = std::mem::replace(&mut distances[i], f64::INFINITY);
            (taken < f64::INFINITY).then(|| place(i))
        })
    }

    /// The parameters nearest to `u` in the chart that are found by descent from the parameters `from`.
    pub fn nearest(&self, u: DVec3, from: Vec<f64>) -> Vec<f64> {
        self.clamped(self.descend(u, &|u, _| u, from))
    }

    fn clamped(&self, mut parameters: Vec<f64>) -> Vec<f64> {
        for (p, [low, high]) in parameters.iter_mut().zip(&self.intervals) {
            *p = p.clamp(*low, *high);
        }
        parameters
    }

    /// The extent of the region in the chart, from its corners and middle.
    fn size(&self) -> f64 {
        let middle = self.at(&self.lerp(&[0.5; 3]));
        (0..8)
            .map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|i: usize| i as f64))
            .map(|t| (self.at(&self.lerp(&t)) - middle).length())
            .fold(0.0, f64::max)
    }

    fn descend(
        &self,
        u: DVec3,
        value: &dyn Fn(DVec3, &mut [DVec3]) -> DVec3,
        mut p: Vec<f64>,
    ) -> Vec<f64> {
        let k = self.dimension();
        for _ in 0..60 {
            let o = self.map.at(&p);
            let mut columns: Vec<DVec3> =
                (0..k).map(|j| DVec3::from_slice(&o[3 + 3 * j..])).collect();
            let residual = u - value(DVec3::from_slice(&o[..3]), &mut columns);
            let step = least_squares(&columns, residual);
            if !step.iter().all(|d| d.is_finite()) {
                break;
            }
            for ((p, d), [low, high]) in p.iter_mut().zip(&step).zip(&self.intervals) {
                let width = high - low;
                *p = (*p + d.clamp(-width, width)).clamp(low - EDGE * width, high + EDGE * width);
            }
            if k == 0 || residual.length() == 0.0 {
                break;
            }
        }
        p
    }
}

/// Computes the `x` that minimises |Σ x_j columns_j − b|, by modified Gram–Schmidt; the shortest where columns depend on
/// each other.
fn least_squares(columns: &[DVec3], b: DVec3) -> Vec<f64> {
    let n = columns.len();
    let mut q: Vec<DVec3> = Vec::new();
    let mut r = [[0.0; 3]; 3];
    for (j, &column) in columns.iter().enumerate() {
        let mut rest = column;
        for (i, qi) in q.iter().enumerate() {
            r[i][j] = qi.dot(rest);
            rest -= *qi * r[i][j];
        }
        r[j][j] = rest.length();
        if !(r[j][j] > 1e-14 * column.length()) {
            return shortest(columns, b);
        }
        q.push(rest / r[j][j]);
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| r[i][j] * x[j]).sum();
        x[i] = (q[i].dot(b) - known) / r[i][i];
    }
    x
}

/// Damping of [`shortest`], as a share of the columns' squares.
const DAMPING: f64 = 1e-12;

/// Computes the shortest of all `x` for which |Σ x_j columns_j − b| is least, but for a little damping.
fn shortest(columns: &[DVec3], b: DVec3) -> Vec<f64> {
    let squares = columns
        .iter()
        .map(|c| DMat3::from_cols(*c * c.x, *c * c.y, *c * c.z));
    let gram = squares.fold(DMat3::ZERO, |sum, square| sum + square);
    let size: f64 = columns.iter().map(|c| c.length_squared()).sum();
    let damping = DMat3::from_diagonal(DVec3::splat(DAMPING * size.max(f64::MIN_POSITIVE)));
    let multipliers = (gram + damping).inverse() * b;
    columns.iter().map(|c| c.dot(multipliers)).collect()
}

#[cfg(test)]
mod tests {
    use crate::{diagnostic::SourceText, manifold::Manifold};

    #[test]
    fn parameters_are_found_again_along_curves_and_surfaces_that_wind() {
        let regions = [
            ("c = [-1, 1]", ["c", "0.3*sin(9*c)", "0.1"]),
            ("c = [0, 19]", ["cos(c)", "sin(c)", "0.05*c"]),
            ("c = [0, 6.2]", ["cos(c)", "sin(3*c)", "0.1"]),
            ("c = [0, 60]", ["0.1*c*cos(c)", "0.1*c*sin(c)", "0"]),
            (
                "a = [0, 12], b = [0.5, 1]",
                ["b*cos(a)", "b*sin(a)", "0.1*a + 0.2*sin(9*b)"],
            ),
        ];
        for (parameters, [x, y, z]) in regions {
            let text = format!(
                "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\n\
                 cameras = {{ parameters = {{ {parameters} }}, at = ['{x}', '{y}', '{z}'] }}\n"
            );
            let source = SourceText::new("flat", text);
            let space = Manifold::from_source(source, &[])
                .unwrap_or_else(|e| panic!("{}", e.report(false)));
            let region = space.cameras.unwrap();
            for i in 0..301 {
                let t = [f64::from(i) / 300.0, f64::from(i * 7 % 301) / 301.0];
                let u = region.at(&region.lerp(&t[..region.dimension()]));
                let found = region
                    .locate(u)
                    .unwrap_or_else(|| panic!("{x}, {y}, {z}: {u}"));
                assert!((region.at(&found) - u).length() < 1e-8);
            }
        }
    }
}
