//! A box around a cell where rays fold, along the cell's own axes.
//!
//! In: the map of a cell. Out: the affine map that takes all that the cell may be asked about into
//! the cube [-1, 1]³. Where rays fold, the cell is a thin sheet on edge: a box along the chart's axes
//! holds mostly points that the cell never reaches, and to learn that by Newton's method from several
//! starts is what a search for light would spend most of its time on.

use crate::prism::Prism;
use glam::{DMat3, DVec3};

/// Parts of each side of the lattice of samples. The map is quadratic across and cubic along, so
/// between samples it leaves their box by at most a 32nd of its bend: less than [`SLACK`].
const PARTS: usize = 4;

/// Share of its extent by which the box is widened.
const SLACK: f64 = 0.05;

/// The centre and the linear part of the map. Holds all points up to `margin` outside the cell in b, c
/// and t, and what is within the share `near` of its size from them.
pub(super) fn slanted(prism: &Prism<'_>, margin: f64, near: f64) -> (DVec3, DMat3) {
    let (_, slope) = prism.map(DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.5));
    let axes = axes(slope);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut size = 0.0_f64;
    for at in samples(margin) {
        let (u, slope) = prism.map(at);
        let p = axes.transpose() * u;
        (low, high) = (low.min(p), high.max(p));
        size = size.max(slope.x_axis.length().max(slope.y_axis.length()));
    }
    let half = (high - low) * (0.5 + SLACK) + near * size;
    let shrunk = DMat3::from_diagonal(half.max(DVec3::splat(f64::MIN_POSITIVE)).recip());
    (axes * (0.5 * (low + high)), shrunk * axes.transpose())
}

/// The direction of the rays, the longest across them, and the third.
fn axes(slope: DMat3) -> DMat3 {
    let along = slope.z_axis.normalize_or(DVec3::X);
    let [a, b] = [slope.x_axis, slope.y_axis].map(|x| x - along * along.dot(x));
    let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
    // The larger of the two eigenvectors of the Gram matrix of a and b.
    let angle = 0.5 * (2.0 * ab).atan2(aa - bb);
    let longest = a * angle.cos() + b * angle.sin();
    let across = longest.normalize_or(along.any_orthonormal_vector());
    DMat3::from_cols(along, across, along.cross(across))
}

/// Places (b, c, t) all over the cell with `margin` around it.
fn samples(margin: f64) -> impl Iterator<Item = DVec3> {
    let part = |i: usize| i as f64 / PARTS as f64;
    let across = move |i: usize| part(i) * (1.0 + 3.0 * margin) - margin;
    let along = move |k: usize| part(k) * (1.0 + 2.0 * margin) - margin;
    let pairs = (0..=PARTS).flat_map(|i| (0..=PARTS - i).map(move |j| (i, j)));
    pairs.flat_map(move |(i, j)| {
        (0..=PARTS).map(move |k| DVec3::new(across(i), across(j), along(k)))
    })
}
