//! Placing points along geodesics from one point.
//!
//! In: points and normals of a mesh, and where its object is. Out: their chart points `u = exp_{u0}(X)` with `X = S R x ·
//! scale`, and normal covectors, by the inverse transpose of the differential: the tangent and the two columns of
//! geodesic deviation at the end of the path.
//!
//! Geodesics of a large mesh would take longer than all the rest of its start (12 µs each). `exp` is smooth, so where many
//! points are close together it is a polynomial of X: of Chebyshev polynomials up to the total degree [`DEGREE`] in each
//! cube of an octree about the points, by interpolation between geodesics to [`NODES`]³ nodes of the cube. A cube in which
//! the polynomial is off ([`ExponentialMap::polynomial`]) is divided, and where too few points are left geodesics are followed to each.

use super::{ObjectEntry, cutting::Points};
use geofan_bundle::chebyshev;
use geofan_core::parallel::*;
use geofan_core::{
    geodesic::{Ray, Settings, ends, perpendiculars},
    manifold::Manifold,
};
use glam::{DMat3, DVec3, DVec4};
use ndarray::ArrayD;

/// Tolerance of the geodesics.
const TOLERANCE: f64 = 1e-9;

/// Points placed by one thread at a time.
const BLOCK: usize = 1024;

/// Whether polynomials are tried at all: pages, which read no meshes, have the places of all vertices with them.
const USED: bool = cfg!(feature = "formats");

/// Points of a mesh from which on they are. Smaller meshes take a tenth of a second at most by geodesics alone.
const MANY: usize = 50_000;

/// Points in a cube from which on a polynomial pays: its nodes and its checks take as long as 140 geodesics with their deviation.
const WORTHWHILE: usize = 400;

/// Degree of the polynomials. With six nodes along an axis three Gaussian bumps, a torus among them, take 1.7 times the
/// geodesics, with ten as many.
const DEGREE: usize = NODES - 1;
const NODES: usize = 8;

/// Most halvings of the cube: points in one place stay together for ever.
const DEEPEST: usize = 10;

/// Points of a cube at which its polynomial is held against geodesics.
const CHECKED: usize = 32;

/// Largest error of a polynomial, as a share of the object's radius: a ten thousandth of what edges may be off.
const ERROR: f64 = 5e-8;

/// Largest error of its covectors, relative.
const NORMAL_ERROR: f64 = 1e-5;

/// Places points of one object.
pub(super) struct ExponentialMap<'m> {
    manifold: &'m Manifold,
    object: &'m ObjectEntry,
    /// The cube around all points, with polynomials in it; `None` where all are placed by geodesics.
    cube: Option<(Cube, Cell)>,
}

/// A cube of tangent vectors at the object's place.
#[derive(Clone, Copy)]
struct Cube {
    middle: DVec3,
    /// Half the length of its edges.
    half: f64,
}

/// What is known in a cube.
enum Cell {
    /// Its eight parts, by [`Cube::part_of`].
    Divided(Vec<Cell>),
    Polynomial(Box<CubePolynomial>),
    /// Nothing: geodesics are followed.
    Unknown,
}

impl<'m> ExponentialMap<'m> {
    /// Prepares for placing the points of a mesh, and others between them.
    pub(super) fn new(manifold: &'m Manifold, object: &'m ObjectEntry, points: &[DVec3]) -> Self {
        let mut map = Self {
            manifold,
            object,
            cube: None,
        };
        if USED && points.len() >= MANY {
            let points: Vec<DVec3> = points.iter().map(|x| map.tangent(*x)).collect();
            let reach = points.iter().map(|x| x.abs().max_element());
            let cube = Cube {
                middle: DVec3::ZERO,
                half: reach.fold(0.0, f64::max),
            };
            let radius = points.iter().map(|x| x.length()).fold(0.0, f64::max);
            map.cube = Some((cube, map.cell(cube, &points, ERROR * radius, 0)));
        }
        map
    }

    /// Places points with their normals; `None` if a geodesic does not get to one.
    pub(super) fn place(&self, points: &[DVec3], normals: &[DVec3]) -> Option<Points> {
        let blocks: Option<Vec<Points>> = points
            .par_chunks(BLOCK)
            .zip(normals.par_chunks(BLOCK))
            .map(|(points, normals)| self.block(points, normals))
            .collect();
        Some(blocks?.concat())
    }

    /// Returns where a point of the mesh is in the tangent space, in the standard frame.
    fn tangent(&self, point: DVec3) -> DVec3 {
        self.object.rotation * point * self.object.scale
    }

    fn block(&self, points: &[DVec3], normals: &[DVec3]) -> Option<Points> {
        let tangents: Vec<DVec3> = points.iter().map(|x| self.tangent(*x)).collect();
        let turned = normals.iter().map(|n| self.object.rotation * *n);
        let normals: Vec<DVec3> = turned.collect();
        let Some((cube, cell)) = self.cube.as_ref().filter(|_| USED) else {
            return self.by_geodesics(&tangents, &normals);
        };
        let mut placed = vec![(DVec3::ZERO, DVec3::ZERO); tangents.len()];
        let mut rest = Vec::new();
        for (i, (x, n)) in tangents.iter().zip(&normals).enumerate() {
            match cell.at(*cube, *x) {
                Some((cube, polynomial)) => placed[i] = polynomial.place(cube, *x, *n),
                None => rest.push(i),
            }
        }
        let of = |all: &[DVec3]| rest.iter().map(|i| all[*i]).collect::<Vec<DVec3>>();
        let followed = self.by_geodesics(&of(&tangents), &of(&normals))?;
        for (i, point) in rest.iter().zip(followed) {
            placed[*i] = point;
        }
        Some(placed)
    }

    /// Places the ends of tangent vectors by a geodesic each.
    fn by_geodesics(&self, tangents: &[DVec3], normals: &[DVec3]) -> Option<Points> {
        let ends = ends(
            self.manifold,
            Settings::bare(TOLERANCE).with_deviation(),
            self.rays(tangents),
        );
        let axes = self.manifold.standard_frame(self.object.at);
        let mut placed = Vec::new();
        for (i, x) in tangents.iter().enumerate() {
            let n = normals[i];
            let length = x.length();
            let Some((step, reached)) = ends.get(i).and_then(Option::as_ref) else {
                placed.push((self.object.at, axes.inverse().transpose() * n));
                continue;
            };
            if *reached < length {
                return None;
            }
            let d = *x / length;
            let [e1, e2] = perpendiculars(d);
            let [j1, j2] = step.deviation(length)?;
            let to = DMat3::from_cols(step.tangent(length), j1 / length, j2 / length);
            let from = DMat3::from_cols(d, e1, e2);
            // The differential takes d, e1, e2 to the columns of `to`; covectors go by its inverse
            // transpose.
            placed.push((
                step.position(length),
                to.inverse().transpose() * (from.transpose() * n),
            ));
        }
        Some(placed)
    }

    /// Returns the rays whose ends are those of tangent vectors.
    fn rays(&self, tangents: &[DVec3]) -> impl Iterator<Item = Ray> {
        let at = self.object.at;
        let local = self.manifold.local_frame(at);
        tangents.iter().map(move |x| {
            let d = x.try_normalize().unwrap_or(DVec3::X);
            Ray::seen_by(&local, at, d, x.length())
        })
    }

    /// Finds polynomials in a cube with these points in it.
    fn cell(&self, cube: Cube, points: &[DVec3], error: f64, depth: usize) -> Cell {
        if points.len() < WORTHWHILE || depth > DEEPEST {
            return Cell::Unknown;
        }
        if let Some(found) = self.polynomial(cube, points, error) {
            return Cell::Polynomial(Box::new(found));
        }
        let mut parts: Vec<Vec<DVec3>> = vec![Vec::new(); 8];
        for x in points {
            parts[cube.part_of(*x)].push(*x);
        }
        let cell =
            |(i, points): (usize, Vec<DVec3>)| self.cell(cube.part(i), &points, error, depth + 1);
        let numbered: Vec<(usize, Vec<DVec3>)> = parts.into_iter().enumerate().collect();
        Cell::Divided(numbered.into_par_iter().map(cell).collect())
    }

    /// Finds the polynomial of a cube; `None` if it is off by more than `error` at some of the points, or if what it
    /// leaves out says so: no check between kinks would.
    fn polynomial(&self, cube: Cube, points: &[DVec3], error: f64) -> Option<CubePolynomial> {
        let ends = self.ends(&cube.nodes())?;
        let (found, left_out) = CubePolynomial::of(&ends);
        if !(left_out <= error) {
            return None;
        }
        let stride = points.len().div_ceil(CHECKED);
        let chosen: Vec<DVec3> = points.iter().step_by(stride).copied().collect();
        let normals: Vec<DVec3> = chosen.iter().map(|x| x.normalize_or(DVec3::X)).collect();
        let known = self.by_geodesics(&chosen, &normals)?;
        let right = |(i, known): (usize, &(DVec3, DVec3))| {
            let (u, n) = found.place(cube, chosen[i], normals[i]);
            (u - known.0).abs().max_element() <= error
                && (n - known.1).length() <= NORMAL_ERROR * known.1.length()
        };
        known.iter().enumerate().all(right).then_some(found)
    }

    /// Finds the ends of tangent vectors; `None` if a geodesic does not get to one.
    fn ends(&self, tangents: &[DVec3]) -> Option<Vec<DVec3>> {
        let ends = ends(
            self.manifold,
            Settings::bare(TOLERANCE),
            self.rays(tangents),
        );
        let end = |(i, x): (usize, &DVec3)| match ends.get(i).and_then(Option::as_ref) {
            None => Some(self.object.at),
            Some((_, reached)) if *reached < x.length() => None,
            Some((step, _)) => Some(step.position(x.length())),
        };
        tangents.iter().enumerate().map(end).collect()
    }
}

impl Cube {
    /// Returns which of the eight parts of the cube a point is in: bit k is set beyond the middle of axis k.
    fn part_of(self, x: DVec3) -> usize {
        let beyond = x.cmpge(self.middle);
        beyond.bitmask() as usize
    }

    /// Returns a part of the cube.
    fn part(self, number: usize) -> Self {
        let half = 0.5 * self.half;
        let side = |k: usize| if number >> k & 1 == 1 { half } else { -half };
        let middle = self.middle + DVec3::new(side(0), side(1), side(2));
        Self { middle, half }
    }

    /// Lists the Chebyshev nodes of the cube, the last axis fastest.
    fn nodes(self) -> Vec<DVec3> {
        let nodes = chebyshev::nodes(NODES);
        let node = |k: usize| {
            let [i, j, k] = [k / (NODES * NODES), k / NODES % NODES, k % NODES];
            self.middle + self.half * DVec3::new(nodes[i], nodes[j], nodes[k])
        };
        (0..NODES * NODES * NODES).map(node).collect()
    }
}

impl Cell {
    /// Finds the polynomial at a point of the cube.
    fn at(&self, cube: Cube, x: DVec3) -> Option<(Cube, &CubePolynomial)> {
        let (mut cell, mut cube) = (self, cube);
        while let Self::Divided(parts) = cell {
            let part = cube.part_of(x);
            (cell, cube) = (&parts[part], cube.part(part));
        }
        match cell {
            Self::Polynomial(polynomial) => Some((cube, polynomial)),
            Self::Divided(_) | Self::Unknown => None,
        }
    }
}

/// Chart points in a cube: `Σ c_ijk T_i(x) T_j(y) T_k(z)` over `i + j + k ≤ DEGREE` of places in [-1, 1]³.
struct CubePolynomial {
    /// The coefficients, k fastest, then j; the fourth component is not used.
    coefficients: Vec<DVec4>,
}

impl CubePolynomial {
    /// Interpolates between the values at the nodes of a cube, and leaves out what is beyond the degree: the root of the
    /// sum of its squares is returned too.
    fn of(values: &[DVec3]) -> (Self, f64) {
        let samples = values.iter().flat_map(|u| u.to_array()).collect();
        let shape = vec![NODES, NODES, NODES, 3];
        let samples =
            ArrayD::from_shape_vec(shape, samples).expect("a number for each axis at each node");
        let (all, _) = chebyshev::coefficients(samples, 3).into_raw_vec_and_offset();
        let (mut coefficients, mut left_out) = (Vec::new(), 0.0);
        for (number, c) in all.chunks_exact(3).map(DVec3::from_slice).enumerate() {
            let order = number / (NODES * NODES) + number / NODES % NODES + number % NODES;
            match order <= DEGREE {
                true => coefficients.push(c.extend(0.0)),
                false => left_out += c.length_squared(),
            }
        }
        (Self { coefficients }, left_out.sqrt())
    }

    /// Places the end `x` of a tangent vector in the cube, with a normal there.
    fn place(&self, cube: Cube, x: DVec3, normal: DVec3) -> (DVec3, DVec3) {
        let place = (x - cube.middle) / cube.half;
        let [x, y, z] = place.to_array().map(chebyshev::values_and_slopes::<NODES>);
        let mut value = DVec4::ZERO;
        let mut slopes = [DVec4::ZERO; 3];
        let mut rest = self.coefficients.as_slice();
        for i in 0..NODES {
            for j in 0..NODES - i {
                let (row, after) = rest.split_at(NODES - i - j);
                rest = after;
                let (mut sum, mut slope) = (DVec4::ZERO, DVec4::ZERO);
                for (c, (t, dt)) in row.iter().zip(z) {
                    sum += *c * t;
                    slope += *c * dt;
                }
                value += sum * (x[i].0 * y[j].0);
                slopes[0] += sum * (x[i].1 * y[j].0);
                slopes[1] += sum * (x[i].0 * y[j].1);
                slopes[2] += slope * (x[i].0 * y[j].0);
            }
        }
        let [a, b, c] = slopes.map(|slope| slope.truncate() / cube.half);
        let covector = DMat3::from_cols(a, b, c).inverse().transpose() * normal;
        (value.truncate(), covector)
    }
}

#[cfg(all(test, feature = "formats"))]
#[path = "exponential_map_tests.rs"]
mod tests;
