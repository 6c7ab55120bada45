//! Discrete symmetries of the stored rays: axes of the chart that may be exchanged or reversed.
//!
//! In: a [`RaySpace`] and signed permutations of the chart's axes. Out: [`Mirror`]s: isometries
//! `u -> c + P (u − c)`, with c the stored point in the middle of the camera region, that carry stored
//! cameras to stored cameras and faces of directions to faces. Of the chunks of a table that they
//! carry into each other only one has to be stored. No file claims them: they are looked for, and used
//! where the metric has them.

use super::space::{Located, RaySpace, Reduction, end_together};
use geofan_core::{manifold::Isometry, random::Stream};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// A permutation of coordinates some of which change their sign: entry `i` is `±(j + 1)` where
/// coordinate `i` of the image is `±` coordinate `j`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignedPermutation(Vec<i8>);

impl SignedPermutation {
    /// All of `n` coordinates, the identity first.
    pub fn all(n: usize) -> Vec<Self> {
        let mut found = vec![Vec::new()];
        for _ in 0..n {
            let longer = |p: &Vec<i8>| {
                let free = (1..=n as i8).filter(|j| !p.iter().any(|i| i.abs() == *j));
                let signed: Vec<i8> = free.flat_map(|j| [j, -j]).collect();
                signed
                    .into_iter()
                    .map(|j| [&p[..], &[j]].concat())
                    .collect::<Vec<_>>()
            };
            found = found.iter().flat_map(longer).collect();
        }
        found.into_iter().map(Self).collect()
    }

    /// Returns whether it is one of `n` coordinates: files may hold anything.
    fn is_of(&self, n: usize) -> bool {
        let has = |j: i8| self.0.iter().any(|i| i.unsigned_abs() == j.unsigned_abs());
        self.0.len() == n && (1..=n as i8).all(has)
    }

    /// Where coordinate `i` of an image comes from, and whether its sign changes.
    fn source(&self, i: usize) -> (usize, bool) {
        let j = self.0[i];
        (usize::from(j.unsigned_abs()) - 1, j < 0)
    }

    /// The image of `x`.
    pub fn apply(&self, x: &[f64]) -> Vec<f64> {
        let sources = (0..self.0.len()).map(|i| self.source(i));
        sources
            .map(|(j, negative)| if negative { -x[j] } else { x[j] })
            .collect()
    }

    /// This after `other`.
    fn after(&self, other: &Self) -> Self {
        let sources = (0..self.0.len()).map(|i| self.source(i));
        let through = |(j, negative): (usize, bool)| match negative {
            true => -other.0[j],
            false => other.0[j],
        };
        Self(sources.map(through).collect())
    }

    /// As a matrix.
    fn matrix(&self) -> DMat3 {
        let column = |j: usize| {
            let mut unit = [0.0; 3];
            unit[j] = 1.0;
            DVec3::from_slice(&self.apply(&unit))
        };
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// `u -> c + P (u − c)` as `P` and what it adds.
    fn about(&self, c: DVec3) -> (DMat3, DVec3) {
        let p = self.matrix();
        (p, c - p * c)
    }

    /// The one whose matrix `m` is, within rounding.
    fn near(m: DMat3) -> Option<Self> {
        let largest = |i: usize| {
            let row = m.row(i);
            let j = row.abs().max_position();
            let number = j as i8 + 1;
            if row[j] < 0.0 { -number } else { number }
        };
        let found = Self((0..3).map(largest).collect());
        let off = (found.matrix() - m).to_cols_array();
        (found.is_of(3) && off.iter().all(|x| x.abs() <= ROUNDING)).then_some(found)
    }
}

/// Adds all products.
fn close(group: &mut Vec<SignedPermutation>) {
    let mut next = 0;
    while next < group.len() {
        for i in 0..group.len() {
            let products = [group[next].after(&group[i]), group[i].after(&group[next])];
            for product in products {
                if !group.contains(&product) {
                    group.push(product);
                }
            }
        }
        next += 1;
    }
}

/// A discrete isometry of the stored rays.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mirror {
    /// P, of the chart's axes.
    axes: SignedPermutation,
    /// Its action on camera parameters, scaled to [−1, 1].
    cameras: SignedPermutation,
    /// Its action on directions in standard frames.
    directions: SignedPermutation,
}

/// Difference allowed between numbers that ought to be equal, as a share of their size.
const ROUNDING: f64 = 1e-9;

/// The largest relative discrepancy of the metric, as for symmetries that a file claims.
const WORST_DISCREPANCY: f64 = 1e-8;

/// Random cameras at which a mirror's action on cameras and directions is looked at.
const CAMERAS: usize = 16;

/// Points tested between two looks at whether the search is cancelled: milliseconds of work.
const BETWEEN_LOOKS: usize = 256;

impl Mirror {
    /// `map`, from chart coordinates to standard frames, averaged over the group `mirrors`: afterwards it
    /// takes images to images.
    pub fn averaged(mirrors: &[Self], map: DMat3) -> DMat3 {
        let images = mirrors
            .iter()
            .map(|m| m.directions.matrix().transpose() * map * m.axes.matrix());
        let sum = images.fold(map, |sum, image| sum + image);
        sum * (1.0 / (mirrors.len() + 1) as f64)
    }

    /// The mirrors of `space` whose metric, and whose rays' ends, agree at all of `rays` (chart points
    /// and tangents); `None` as soon as `cancelled` says so.
    pub fn find(
        space: &RaySpace,
        rays: &[(DVec3, DVec3)],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Self>> {
        // Rotations leave one direction parameter: nothing to exchange.
        if space.reduction() == Reduction::Rotation {
            return Some(Vec::new());
        }
        let mut group = SignedPermutation::all(3);
        let others = group.split_off(1);
        let mut mirrors = Vec::new();
        for axes in others {
            let Some(mirror) = Self::with_axes(space, axes.clone()) else {
                continue;
            };
            // Products of isometries are isometries.
            let known = group.contains(&axes);
            if !known && !mirror.holds(space, rays, cancelled)? {
                continue;
            }
            mirrors.push(mirror);
            if !known {
                group.push(axes);
                close(&mut group);
            }
        }
        Some(mirrors)
    }

    /// The mirror by `axes`, if it carries stored cameras to stored cameras and faces to faces.
    fn with_axes(space: &RaySpace, axes: SignedPermutation) -> Option<Self> {
        let (p, shift) = axes.about(space.middle());
        let turned = |t: &[f64]| {
            let u = space.stored_at(t);
            let image = p * u + shift;
            let manifold = space.manifold();
            manifold.standard_frame(image).inverse() * p * manifold.standard_frame(u)
        };
        let dimension = space.cameras().len();
        let directions = SignedPermutation::near(turned(&vec![0.0; dimension]))?;
        let mut stream = Stream::new(&[0x006d_6972]);
        let mut camera = || (0..dimension).map(|_| stream.between(-1.0, 1.0)).collect();
        let cameras: Vec<Vec<f64>> = (0..CAMERAS).map(|_| camera()).collect();
        if !cameras
            .iter()
            .all(|t| SignedPermutation::near(turned(t)).is_some_and(|p| p == directions))
        {
            return None;
        }
        let follows = |cameras_by: &SignedPermutation| {
            cameras.iter().all(|t| {
                let image = p * space.stored_at(t) + shift;
                let off = (space.stored_at(&cameras_by.apply(t)) - image).length();
                off <= ROUNDING * (image.length() + space.middle().length())
            })
        };
        let cameras = SignedPermutation::all(dimension)
            .into_iter()
            .find(follows)?;
        Some(Self {
            axes,
            cameras,
            directions,
        })
    }

    /// Tells whether metric and ends of rays are unchanged at `rays`; `None` as soon as `cancelled` says so.
    fn holds(
        &self,
        space: &RaySpace,
        rays: &[(DVec3, DVec3)],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<bool> {
        let manifold = space.manifold();
        let (p, shift) = self.axes.about(space.middle());
        let isometry = Isometry::Affine(p, shift);
        let domain = &manifold.domain;
        let glued = (0..3).all(|i| domain.period(i) == domain.period(self.axes.source(i).0));
        if !glued {
            return Some(false);
        }
        let unchanged = |&(u, v): &(DVec3, DVec3)| {
            let image = domain.wrap(p * u + shift);
            manifold.discrepancy(&isometry, u) <= WORST_DISCREPANCY
                && end_together(manifold, (u, v), (image, p * v))
        };
        for rays in rays.chunks(BETWEEN_LOOKS) {
            if cancelled() {
                return None;
            }
            if !rays.iter().all(unchanged) {
                return Some(false);
            }
        }
        Some(true)
    }

    /// Returns whether a file's mirror is one of `space` as far as cameras and directions go.
    pub fn fits(&self, space: &RaySpace) -> bool {
        self.axes.is_of(3)
            && space.reduction() != Reduction::Rotation
            && Self::with_axes(space, self.axes.clone()).is_some_and(|found| found == *self)
    }

    /// The image of camera parameters in [−1, 1].
    pub fn camera(&self, t: &[f64]) -> Vec<f64> {
        self.cameras.apply(t)
    }

    /// The cell that the `cell` among `counts` is carried to; `None` if it is cut by the division.
    pub fn cell(&self, cell: &[usize], counts: &[usize]) -> Option<Vec<usize>> {
        let image = (0..cell.len()).map(|i| {
            let (j, negative) = self.cameras.source(i);
            let moved = if negative {
                counts[j] - 1 - cell[j]
            } else {
                cell[j]
            };
            (counts[i] == counts[j]).then_some(moved)
        });
        image.collect()
    }

    /// The face that `face` is carried to.
    pub fn face(&self, face: usize) -> usize {
        let axis = face / 2;
        let to = (0..3).find(|i| self.directions.source(*i).0 == axis);
        let to = to.unwrap_or(axis);
        let negative = self.directions.source(to).1;
        2 * to + usize::from(face.is_multiple_of(2) == negative)
    }

    /// Computes its action on the rays of `space` in the directions of `face`.
    pub fn image(&self, space: &RaySpace, face: usize) -> Image {
        let (axis, image) = (face / 2, self.face(face));
        let to = image / 2;
        // Warped or not, the coordinates of a direction change places alike.
        let parameter = |k: usize| {
            let (j, negative) = self.directions.source((to + k) % 3);
            ((j + 3 - axis) % 3 - 1, if negative { -1.0 } else { 1.0 })
        };
        let (p, shift) = self.axes.about(space.middle());
        let back = p.transpose();
        Image {
            face: image,
            parameters: [parameter(1), parameter(2)],
            forth: (p, shift),
            back: (back, -(back * shift)),
        }
    }
}

/// The action of a [`Mirror`] on the rays in the directions of one face.
#[derive(Debug, Clone)]
pub struct Image {
    /// The face that they are carried to.
    pub face: usize,
    /// For each parameter there, the one that it comes from and its sign.
    parameters: [(usize, f64); 2],
    /// `u -> P u + t`, and its inverse.
    forth: (DMat3, DVec3),
    back: (DMat3, DVec3),
}

impl Located {
    /// The ray that this is carried to by `image`, and how to get back from there; this one without.
    pub fn carried(self, image: Option<&Image>) -> Self {
        let Some(image) = image else { return self };
        let (p, shift) = image.forth;
        let parameters = image.parameters.map(|(j, sign)| sign * self.direction[j]);
        Self {
            face: image.face,
            direction: parameters,
            u: p * self.u + shift,
            v: p * self.v,
            isometry: self.isometry.after(image.back),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::direction::{FACES, direction},
        *,
    };
    use crate::rays::direction::ReferenceSphere;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use glam::DVec2;
    use std::sync::Arc;

    fn space(metric: &str, rest: &str) -> RaySpace {
        let text = format!(
            "name = \"test\"\ncoordinates = [\"x\", \"y\", \"z\"]\n\
             metric = {{ {metric} }}\n{rest}"
        );
        let manifold = Manifold::from_source(SourceText::new("test", &text), &[]);
        RaySpace::new(Arc::new(manifold.unwrap())).unwrap()
    }

    const BOX: &str = "[domain]\nx = [-2, 2]\ny = [-2, 2]\nz = [-2, 2]";

    /// Points about the region and random tangents.
    fn rays() -> Vec<(DVec3, DVec3)> {
        let mut stream = Stream::new(&[8]);
        let mut coordinate = || stream.between(-2.0, 2.0);
        let mut vector = || DVec3::from_array([0; 3].map(|_| coordinate()));
        (0..200).map(|_| (vector(), vector())).collect()
    }

    fn count(space: &RaySpace) -> usize {
        Mirror::find(space, &rays(), &|| false).unwrap().len()
    }

    #[test]
    fn mirrors_are_those_of_the_metric() {
        let round = r#"conformal = "exp(exp(-(x^2 + y^2 + z^2)/2))""#;
        assert_eq!(count(&space(round, BOX)), 47);
        let long = r#"conformal = "exp(exp(-(x^2 + y^2 + 1.0001*z^2)/2))""#;
        assert_eq!(count(&space(long, BOX)), 15);
        let bent = r#"conformal = "exp(exp(-(x^2 + y^2 + z^2 + 0.0001*x*y*z)/2))""#;
        assert_eq!(count(&space(bent, BOX)), 23);
        let none = r#"conformal = "exp(exp(-(x^2 + 2*y^2 + 3*z^2)/2) + x + 2*y + 3*z)""#;
        assert_eq!(count(&space(none, BOX)), 0);
    }

    #[test]
    fn mirrors_keep_cameras_and_ends() {
        let round = r#"conformal = "exp(exp(-(x^2 + y^2 + z^2)/2))""#;
        let rail = "[cameras]\nparameters = { c = [-1.0, 1.0] }\nat = [\"c\", \"0\", \"0\"]";
        assert_eq!(count(&space(round, rail)), 15);
        let aside = "[cameras]\nparameters = { c = [-1.0, 1.0] }\nat = [\"c\", \"0.3\", \"0\"]";
        assert_eq!(count(&space(round, aside)), 3);
        let slanted = "[cameras]\nparameters = { c = [-1.0, 1.0] }\nat = [\"c\", \"c^2\", \"0\"]";
        assert_eq!(count(&space(round, slanted)), 3);
        let exit = format!("{BOX}\n[[exit]]\nname = \"sky\"\nwhen = \"x - 1.5\"");
        assert_eq!(count(&space(round, &exit)), 7);
        let uneven = "[domain]\nx = [-2, 3]\ny = [-2, 2]\nz = [-2, 2]";
        assert_eq!(count(&space(round, uneven)), 7);
    }

    /// Frames are made in the order of the coordinates, so exchanging them turns the frames of a
    /// metric that is not diagonal: faces then do not go to faces.
    #[test]
    fn mirrors_carry_faces_to_faces() {
        let skew = r#"xx = "2", yy = "2", zz = "2", xy = "1", yz = "1", xz = "1""#;
        assert_eq!(count(&space(skew, BOX)), 1);
    }

    #[test]
    fn permutations_are_a_group() {
        let all = SignedPermutation::all(3);
        assert_eq!((all.len(), SignedPermutation::all(0).len()), (48, 1));
        let x = [0.3, -1.2, 2.5];
        for a in &all {
            assert!(a.is_of(3) && !a.is_of(2));
            for b in &all {
                assert_eq!(a.after(b).apply(&x), a.apply(&b.apply(&x)));
            }
        }
        for p in &all {
            let off = DMat3::from_diagonal(DVec3::splat(1e-10));
            assert_eq!(SignedPermutation::near(p.matrix() + off).as_ref(), Some(p));
            assert_eq!(SignedPermutation::near(p.matrix() + 100.0 * off), None);
        }
        let onto_a_plane = SignedPermutation(vec![1, 1, 2]).matrix();
        for none in [onto_a_plane, DMat3::ZERO, DMat3::NAN] {
            assert_eq!(SignedPermutation::near(none), None);
        }
        for wrong in [vec![1, 1, 2], vec![0, 1, 2], vec![1, 2], vec![1, 2, -128]] {
            assert!(!SignedPermutation(wrong).is_of(3));
        }
        let mut group = vec![all[0].clone(), SignedPermutation(vec![2, -1, 3])];
        close(&mut group);
        assert_eq!(group.len(), 4);
    }

    #[test]
    fn images_of_rays_come_back() {
        let round = r#"conformal = "exp(exp(-(x^2 + y^2 + z^2)/2))""#;
        let space = space(round, BOX);
        let mirrors = Mirror::find(&space, &rays(), &|| false).unwrap();
        come_back(&space, &mirrors);
        let uneven = DMat3::from_diagonal(DVec3::new(0.1, 0.2, 0.3));
        let even = Mirror::averaged(&mirrors, uneven);
        assert!((even - DMat3::from_diagonal(DVec3::splat(0.2))).abs_diff_eq(DMat3::ZERO, 1e-15));
        come_back(
            &space.with_reference_sphere(ReferenceSphere::new(even, vec![2; 3])),
            &mirrors,
        );
    }

    fn come_back(space: &RaySpace, mirrors: &[Mirror]) {
        let u = DVec3::new(0.3, -1.1, 0.7);
        let place = space.place(u).unwrap();
        for mirror in mirrors {
            for face in 0..FACES {
                let d = direction(face, DVec2::new(0.3, -0.6));
                let located = space.locate(&place, d);
                let image = located
                    .clone()
                    .carried(Some(&mirror.image(space, located.face)));
                assert_eq!(image.face, mirror.face(located.face));
                let (back, p) = image.isometry.apply(image.u);
                assert!((back - u).length() < 1e-15);
                assert!((p * image.v - located.v).length() < 1e-15);
                // The image is known as the ray that it is.
                let own = space.manifold().standard_frame(image.u).inverse() * image.v;
                let known = space.locate(&space.place(image.u).unwrap(), own);
                let [found, given] = [known.direction, image.direction].map(DVec2::from_array);
                assert_eq!(known.face, image.face);
                assert!((found - given).length() < 1e-12);
                let camera = mirror.camera(&[u.x / 2.0, u.y / 2.0, u.z / 2.0]);
                assert!((space.stored_at(&camera) - image.u).length() < 1e-15);
            }
        }
    }
}
