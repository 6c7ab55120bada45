//! The parametrisation of directions: one sphere or six faces, and where rays aim.
//!
//! In: the rays of a space. Out: the axes of the sphere of directions ([`sphere_axes`]) and the parallax of
//! the [`ReferenceSphere`](geofan_bundle::rays::ReferenceSphere) on which rays are known by the point that
//! they aim at ([`reference_sphere`]).
//!
//! One patch for the whole sphere of directions takes fewer bytes than six for its faces, if mirrors do
//! not spare most of the faces. Straight ahead and behind a moving camera the view hardly changes, beside it
//! the view turns about the direction of motion: with the pole there, motion changes polar angles only.

use crate::{
    plan::{PlanWatch, random_stored_rays},
    refine::tensor_train::rank_in_bits,
};
use faer::Mat;
use geofan_bundle::{
    Division, PlanRecord,
    rays::{Mirror, RaySpace, direction::direction, parallel, parameters_in_cell, sample},
};
use geofan_core::{Result, random::Stream};
use glam::{DMat3, DVec2, DVec3};

/// The fewest chunks of faces, for each of whole spheres, that are worth replacing: three bumps take 0.7
/// to 0.8 of the bytes of six.
const FEWEST_FACES: usize = 5;

/// Steps of the iteration that finds the longest axis of an ellipsoid.
const STEPS: usize = 100;

/// Finds the axes of the sphere of directions (columns, the pole last) for the rays of `plan`; `None` if
/// faces are better stored each by itself.
pub fn sphere_axes(space: &RaySpace, plan: &PlanRecord) -> Option<[[f64; 3]; 3]> {
    if space.planar() {
        return None;
    }
    let pole = pole(space, plan);
    let (first, second) = pole.any_orthonormal_pair();
    let together = PlanRecord {
        sphere: Some(DMat3::from_cols(first, second, pole).to_cols_array_2d()),
        ..plan.clone()
    };
    let chunks = |plan: &PlanRecord| plan.division(&plan.applied(space.clone())).chunks();
    let worth = chunks(plan) >= FEWEST_FACES * chunks(&together);
    together.sphere.filter(|_| worth)
}

/// Finds the direction in the standard frame along which cells of cameras are longest.
fn pole(space: &RaySpace, plan: &PlanRecord) -> DVec3 {
    let counts: Vec<usize> = plan.cells.iter().map(|n| *n as usize).collect();
    let cells = Division::new(counts.clone(), 1, &[]);
    let extents = (0..cells.chunks()).map(|cell| extent(space, &counts, &cells.of(cell).0));
    longest_axis(extents.fold(DMat3::ZERO, |sum, extent| sum + extent))
}

/// Sums `o oᵀ` over the offsets o, in the standard frame, from the middle of a cell to its sides.
fn extent(space: &RaySpace, counts: &[usize], cell: &[usize]) -> DMat3 {
    let at = |inner: &[f64]| {
        space.stored_point(&parameters_in_cell(counts, space.cameras(), cell, inner))
    };
    let middle = vec![0.0; counts.len()];
    let inverse = space.manifold().standard_frame(at(&middle)).inverse();
    let side = |axis: usize| {
        let mut inner = middle.clone();
        inner[axis] = 1.0;
        let o = inverse * (at(&inner) - at(&middle));
        DMat3::from_cols(o * o.x, o * o.y, o * o.z)
    };
    let sides = (0..counts.len()).map(side);
    sides.fold(DMat3::ZERO, |sum, side| sum + side)
}

/// Finds the longest axis of a symmetric matrix without negative eigenvalues, by iteration from the
/// coordinate that has most; z if there is none.
fn longest_axis(extent: DMat3) -> DVec3 {
    let diagonal = DVec3::new(extent.x_axis.x, extent.y_axis.y, extent.z_axis.z);
    let mut axis = DVec3::AXES[diagonal.max_position()];
    if !(diagonal.max_element() > 0.0 && diagonal.is_finite()) {
        return DVec3::Z;
    }
    for _ in 0..STEPS {
        axis = (extent * axis).normalize();
    }
    axis
}

/// Seed of the random parts of a table.
const SEED: u64 = 0x0066_6f63_7573;

/// Parts looked at, their cameras and their directions.
const PARTS: usize = 8;
const CAMERAS: usize = 48;
const DIRECTIONS: usize = 12;

/// Random paths on which lengths of coordinates are taken.
const PATHS: usize = 256;

/// Places along each path, as shares of its length.
const PLACES: [f64; 3] = [0.3, 0.6, 0.95];

/// Reference spheres tried: the parallax of the farthest corner of a cell.
const PARALLAXES: [f64; 6] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7];

/// Work of one part, whose rays carry nothing, and of all parts with all spheres, in the unit of
/// [`PlanWatch`].
const PART_WORK: u64 = (CAMERAS * DIRECTIONS / 4) as u64;
pub const REFERENCE_SPHERE_WORK: u64 =
    PATHS as u64 + ((1 + PARALLAXES.len()) * PARTS) as u64 * PART_WORK;

/// Share by which a nearer sphere must need fewer bits. The strongest parallax is never worth it: it crowds
/// directions (a Gaussian lens takes 102 kB with 0.4, 117 kB with the 0.6 that promises 0.7 % fewer bits).
const WORTH: f64 = 0.004;

/// A random part of a table: cameras × directions, whose paths form a matrix.
struct TableSample {
    cell: Vec<usize>,
    /// Places in the cell, in [−1, 1].
    cameras: Vec<Vec<f64>>,
    /// Unit vectors that rays are known by, on a face or anywhere.
    aims: Vec<DVec3>,
}

/// Finds the parallax (columns of W) with which paths from neighbouring cameras are most alike, for the rays
/// of `plan`, whose own parallax does not count.
///
/// Looked at are small random parts of the matrices cameras × directions of some cells and faces: the fewer
/// singular values count, the smaller are tensor trains.
///
/// # Errors
/// The observer ends it.
pub fn reference_sphere(
    space: &RaySpace,
    plan: &PlanRecord,
    watch: &PlanWatch<'_>,
) -> Result<[[f64; 3]; 3]> {
    let none = [[0.0; 3]; 3];
    if space.planar() || space.cameras().is_empty() {
        return Ok(none);
    }
    let parts = table_samples(space, plan);
    // A parallax of one unit of length in all directions, as symmetric as the space.
    let unit = Mirror::averaged(
        &plan.mirrors,
        DMat3::from_diagonal(coordinate_lengths(space, plan, watch)?),
    );
    let reach = farthest_corner(space, plan, &parts, unit);
    if !(reach > 0.0 && reach.is_finite()) {
        return Ok(none);
    }
    // Nearer and nearer spheres, as long as they need fewer bits.
    let mut best = (estimated_bits(space, plan, &parts, none, watch)?, none);
    for share in PARALLAXES {
        let parallax = (unit * (share / reach)).to_cols_array_2d();
        let bits = estimated_bits(space, plan, &parts, parallax, watch)?;
        if !(bits < (1.0 - WORTH) * best.0) {
            break;
        }
        best = (bits, parallax);
    }
    Ok(best.1)
}

/// Counts the cells along each camera parameter.
fn cell_counts(plan: &PlanRecord) -> Vec<usize> {
    plan.cells.iter().map(|n| *n as usize).collect()
}

/// Draws random parts of the table.
fn table_samples(space: &RaySpace, plan: &PlanRecord) -> Vec<TableSample> {
    let mut stream = Stream::new(&[SEED]);
    let cells = cell_counts(plan);
    let part = |number: usize| {
        let cell = cells.iter().map(|n| stream.bits() as usize % n).collect();
        let mut points = |count: usize, axes: usize| -> Vec<Vec<f64>> {
            let point = |_| (0..axes).map(|_| stream.between(-1.0, 1.0)).collect();
            (0..count).map(point).collect()
        };
        let cameras = points(CAMERAS, cells.len());
        let directions = points(DIRECTIONS, space.directions());
        let aim = |d: &Vec<f64>| match plan.sphere() {
            Some(sphere) => sphere.direction([d[0], parallel(d[1])]),
            None => direction(number % space.faces(), DVec2::new(d[0], d[1])),
        };
        TableSample {
            cell,
            cameras,
            aims: directions.iter().map(aim).collect(),
        }
    };
    (0..PARTS).map(part).collect()
}

/// Returns the arc lengths of [`PLACES`].
fn arc_lengths(plan: &PlanRecord) -> [f64; PLACES.len()] {
    PLACES.map(|share| share * plan.length)
}

/// Measures the length of a unit of each chart coordinate, in the median of points on random paths.
fn coordinate_lengths(space: &RaySpace, plan: &PlanRecord, watch: &PlanWatch<'_>) -> Result<DVec3> {
    let rays = random_stored_rays(space, PATHS);
    let lengths = |_: usize, _: f64| arc_lengths(plan).to_vec();
    let paths = watch.probe(space, (plan.length, plan.tolerance), &rays, lengths)?;
    let manifold = space.manifold();
    let probes = paths.iter().flat_map(|path| &path.probes);
    let metrics: Vec<DMat3> = probes.map(|probe| manifold.metric(probe.u)).collect();
    let median = |k: usize| {
        let sizes = metrics.iter().map(|g| g.col(k)[k].sqrt());
        let mut sizes: Vec<f64> = sizes.collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).map_or(1.0, |s| *s)
    };
    Ok(DVec3::from_array([0, 1, 2].map(median)))
}

/// Returns the largest parallax of the corners of cells.
fn farthest_corner(
    space: &RaySpace,
    plan: &PlanRecord,
    parts: &[TableSample],
    parallax: DMat3,
) -> f64 {
    let cells = cell_counts(plan);
    let axes = cells.len();
    let corner = |part: &TableSample, number: usize| {
        let side = |axis: usize| if number >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let inner: Vec<f64> = (0..axes).map(side).collect();
        let at = |inner: &[f64]| {
            space.stored_point(&parameters_in_cell(
                &cells,
                space.cameras(),
                &part.cell,
                inner,
            ))
        };
        (parallax * (at(&inner) - at(&vec![0.0; axes]))).length()
    };
    let all = parts
        .iter()
        .flat_map(|part| (0..1 << axes).map(move |number| corner(part, number)));
    all.fold(0.0, f64::max)
}

/// Estimates the bits that the parts take with rays aimed with the parallax `focus`.
fn estimated_bits(
    space: &RaySpace,
    plan: &PlanRecord,
    parts: &[TableSample],
    parallax: [[f64; 3]; 3],
    watch: &PlanWatch<'_>,
) -> Result<f64> {
    let aimed = PlanRecord {
        parallax,
        ..plan.clone()
    };
    let aimed = aimed.applied(space.clone());
    let mut bits = 0.0;
    for part in parts {
        watch.add(PART_WORK)?;
        bits += bits_of_part(part, &aimed, plan);
    }
    Ok(bits)
}

/// Estimates the bits that one part takes: the matrix cameras × (directions, places, channels).
fn bits_of_part(part: &TableSample, space: &RaySpace, plan: &PlanRecord) -> f64 {
    let manifold = space.manifold();
    let cells = cell_counts(plan);
    let rays = part.cameras.iter().flat_map(|camera| {
        let camera = parameters_in_cell(&cells, space.cameras(), &part.cell, camera);
        let ray = move |aim: &DVec3| -> (DVec3, DVec3) {
            let (u, d) = space.ray_aimed(&camera, *aim);
            (u, manifold.local_frame(u).tangent(d))
        };
        part.aims.iter().map(ray)
    });
    let rays: Vec<(DVec3, DVec3)> = rays.collect();
    let lengths = arc_lengths(plan);
    let samples = sample(space, plan.tolerance, &rays, (&lengths, None));
    let channels = space.channels();
    let width = lengths.len() * channels.len();
    rank_in_bits(&Mat::from_fn(CAMERAS, DIRECTIONS * width, |i, j| {
        let (ray, rest) = (i * DIRECTIONS + j / width, j % width);
        let found = samples[[ray, rest / channels.len(), channels[rest % channels.len()]]];
        if found.is_finite() { found } else { 0.0 }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_axis_is_found() {
        let axes = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, 1.0, -0.3);
        let extent = axes * DMat3::from_diagonal(DVec3::new(0.2, 3.0, 1.0)) * axes.transpose();
        assert!(longest_axis(extent).dot(axes.y_axis).abs() > 1.0 - 1e-12);
        assert_eq!(longest_axis(DMat3::ZERO), DVec3::Z);
        assert_eq!(
            longest_axis(DMat3::from_diagonal(DVec3::new(2.0, 2.0, 0.0))),
            DVec3::X
        );
    }
}
