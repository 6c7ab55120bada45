//! Separatrices: surfaces among the rays of a box on whose two sides paths have different fates, such as the edge of a
//! hole's shadow or the outline of a ball of glass.
//!
//! In: a box of whose rays some meet an edge of the metric, or an exit, that the others do not. Out: where the surface is
//! along one axis of directions, as a polynomial in the other parameters ([`SeparatrixDivision`]). On each side paths are
//! smooth up to it, but ever less (beside a shadow they wind about the hole more often, the closer the more), so that
//! boxes there are halved towards it. There are as many of them with each halving, where boxes that the surface crosses
//! become more.
//!
//! In: parameters of a ray on a side. Out: its parameters in the box that the surface divides, and back
//! ([`SeparatrixSide`]).

use super::{
    Refiner,
    edges::{FIRST_NODES, ROOMY, groups, parting},
    grid_node,
    held_out::HeldOutRays,
    line_series::Resolution,
    refinement_tree::ParameterBox,
};
use geofan_bundle::{Polynomial, SideReach, Tensor, rays::EdgePiece};
use geofan_core::random::Stream;
use std::{ops::Range, sync::Arc};

/// How far the place of a separatrix may be off, in widths of half the box: rays between it and the true one are of the
/// other kind, and what is beside it is given up.
const PLACE_ERROR: f64 = 1e-6;

/// Factor by which it may be farther off where no polynomial does better.
const WORST: f64 = 100.0;

/// How far from the middle of a box its separatrix is looked for, in widths of half the box: it may leave the box within
/// its other parameters.
const REACHES: [f64; 4] = [1.0, 1.5, 2.0, 3.0];

/// The axes of rays among which separatrices are looked for: two directions from one place. With a camera's axis, too, a bake
/// about Kerr's hole had not ended after five times the time that it takes without them.
const RAY_AXES: usize = 2;

/// Halvings of the interval that holds a separatrix, until it is known to a part of that.
const BISECTIONS: usize = 24;

/// Halvings at the plan's tolerance, and as many as are trusted of these: the others are done again at the finer one.
const COARSE_BISECTIONS: usize = 14;
const TRUSTED_BISECTIONS: usize = 12;

/// Factor by which the tracer's tolerance is smaller beside separatrices: there errors grow as neighbouring paths part.
const FINER: f64 = 1e-2;
const FINEST: f64 = 1e-12;

/// Random lines on which the polynomial is held against the place found there.
const HELD_OUT_LINES: usize = 24;

/// Lines along each axis of a box, both ends among them, on which it is looked how far its separatrix goes, and what is added
/// for what is between them.
const REACH_LINES: usize = 33;
const REACH_ROOM: f64 = 1.0 / 64.0;

/// The least share of a box that either side counts as.
const LEAST_SHARE: f64 = 0.01;

/// Returns the tracer's local tolerance beside a separatrix.
pub fn finer(tolerance: f64) -> f64 {
    (FINER * tolerance).max(FINEST.min(tolerance))
}

/// A separatrix that parts the rays of a box.
#[derive(Debug)]
pub struct SeparatrixDivision {
    /// Where it is along its axis, as the table stores it.
    pub place: Arc<Tensor>,
    /// The axis, one of directions, and how far the boxes on both sides reach along it.
    pub reach: SideReach,
    /// The part of the box's rays on the lower side, in the mean.
    pub share: f64,
}

/// One side of a separatrix.
#[derive(Debug)]
pub struct SeparatrixSide {
    /// The box that it divides.
    of: ParameterBox,
    found: Arc<SeparatrixDivision>,
    number: usize,
}

impl SeparatrixSide {
    /// Takes the lower (0) or upper (1) side of what `found` divides the box `of` into.
    pub fn new(of: &ParameterBox, found: Arc<SeparatrixDivision>, number: usize) -> Self {
        Self {
            of: of.clone(),
            found,
            number,
        }
    }

    /// Returns the part of the box's rays that are on this side.
    pub fn share(&self) -> f64 {
        match self.number {
            0 => self.found.share,
            _ => 1.0 - self.found.share,
        }
    }

    /// Returns the part of the chunk's rays within the width of this side, along the axis.
    pub fn volume(&self) -> f64 {
        let reach = &self.found.reach;
        let [a, b] = self.of.intervals[reach.axis];
        let outer = self.of.beside.as_ref().map_or(1.0, |side| side.volume());
        0.25 * (b - a) * reach.lengths()[self.number] * outer
    }

    /// Finds the place of the separatrix for a ray with these parameters along the other axes.
    fn place(&self, x: &[f64]) -> f64 {
        self.found.place.at_many(&[&self.of.scaled(x)])[0][0]
    }

    /// Turns the coordinate of a ray on this side into that beyond, and returns the side that the whole box is on.
    pub fn leave(&self, x: &mut [f64]) -> Option<&Self> {
        let (reach, axis) = (&self.found.reach, self.found.reach.axis);
        let outer = reach.outer((self.number, x[axis]), self.place(x));
        x[axis] = self.of.at(axis, outer);
        self.of.beside.as_deref()
    }

    /// Turns the coordinates of a ray in the chunk into those on this side.
    pub fn enter(&self, x: &mut [f64]) {
        if let Some(side) = &self.of.beside {
            side.enter(x);
        }
        let (reach, axis) = (&self.found.reach, self.found.reach.axis);
        let own = self.of.scaled(x)[axis];
        x[axis] = reach.inner((self.number, own), self.place(x));
    }
}

impl Refiner<'_> {
    /// Finds the separatrix that parts the rays of a box, if they are of two kinds and there is one.
    pub(super) fn separatrix(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        held_out: &HeldOutRays<'_>,
    ) -> Option<SeparatrixDivision> {
        let cameras = self.space.cameras().len();
        let rays = (self.space.directions(), bounds.arc());
        if rays != (2, RAY_AXES) || !self.may_halve_rays(bounds)[cameras] {
            return None;
        }
        let piece = parted_at(bounds.piece(), held_out)?;
        // Along the axis that parts them best first.
        let urgency = parting(bounds, held_out.kinds());
        let mut axes: Vec<usize> = (cameras..bounds.arc()).collect();
        axes.sort_by(|a, b| urgency[*b].total_cmp(&urgency[*a]));
        let ways = axes
            .iter()
            .flat_map(|axis| REACHES.map(|within| (*axis, within)));
        let search = |(axis, within)| SeparatrixSearch {
            refiner: self,
            chunk,
            bounds,
            piece: &piece,
            axis,
            within,
        };
        ways.into_iter().find_map(|way| search(way).division())
    }
}

/// Returns the piece of paths up to the edge that one kind of the rays of a box meets next and the other does not; none
/// if there are not two such kinds.
fn parted_at(mut piece: EdgePiece, held_out: &HeldOutRays<'_>) -> Option<EdgePiece> {
    let kinds: Vec<_> = groups(held_out.kinds()).into_keys().collect();
    let [Some(one), Some(other)] = kinds[..] else {
        return None;
    };
    if !one.starts_with(&piece.before) || !other.starts_with(&piece.before) {
        return None;
    }
    let known = piece.before.len();
    piece.next = Some(*other.get(known).or(one.get(known))?);
    Some(piece)
}

/// The search for a separatrix along one axis of a box.
struct SeparatrixSearch<'a> {
    refiner: &'a Refiner<'a>,
    chunk: usize,
    bounds: &'a ParameterBox,
    /// Paths on one side end at the edge behind it.
    piece: &'a EdgePiece,
    axis: usize,
    /// How far from the middle of the box it may be.
    within: f64,
}

impl SeparatrixSearch<'_> {
    /// Finds it.
    fn division(&self) -> Option<SeparatrixDivision> {
        let (refiner, bounds) = (self.refiner, self.bounds);
        // No more than a few lines, most often, to find that there is none.
        let nodes = self
            .limits()
            .iter()
            .map(|most| FIRST_NODES.min(*most))
            .collect();
        let first = Resolution::of_nodes(nodes);
        let polynomial = self.fit(&first)?;
        let mut stream = Stream::new(&[&bounds.name[..], &[self.axis as u64, u64::MAX]].concat());
        let lines = (0..HELD_OUT_LINES).map(|_| bounds.random_ray(&mut stream));
        let held_out = self.places(lines.collect())?;
        let share = held_out.share();
        if !(LEAST_SHARE..=1.0 - LEAST_SHARE).contains(&share) {
            return None;
        }
        let (polynomial, left) = self.refined(first, polynomial, &held_out)?;
        let left = left.max(ROOMY);
        if left > WORST {
            return None;
        }
        let reach = self.reach(&polynomial)?;
        let place = refiner.quantise_place(&polynomial, left * PLACE_ERROR, |tensor| {
            held_out.error(|points| tensor.at_many(points)) / (2.0 * left)
        })?;
        Some(SeparatrixDivision {
            place: Arc::new(place),
            reach,
            share,
        })
    }

    /// Returns how far the boxes of both sides have to reach, with some room, to hold all rays of the box; none if that is
    /// too far.
    fn reach(&self, place: &Polynomial) -> Option<SideReach> {
        let even = |i: usize| 2.0 * i as f64 / (REACH_LINES - 1) as f64 - 1.0;
        let mut axes = vec![(0..REACH_LINES).map(even).collect(); self.bounds.arc()];
        axes[self.axis] = vec![0.0];
        let count = axes.iter().map(Vec::len).product();
        let lines: Vec<Vec<f64>> = (0..count).map(|line| grid_node(&axes, line)).collect();
        let points: Vec<&[f64]> = lines.iter().map(Vec::as_slice).collect();
        let places: Vec<f64> = place.at(&points).into_iter().map(|row| row[0]).collect();
        let least = places.iter().copied().reduce(f64::min)? - REACH_ROOM;
        let most = places.iter().copied().reduce(f64::max)? + REACH_ROOM;
        SideReach::covering(self.axis, [least, most])
    }

    /// Returns the most nodes along each axis: the place does not depend on the separatrix's own, nor on the arc length.
    fn limits(&self) -> Vec<usize> {
        let mut limits = self.refiner.most_nodes(self.bounds);
        (limits[self.axis], limits[self.bounds.arc()]) = (1, 1);
        limits
    }

    /// Fits the polynomial through the places on lines through the nodes.
    fn fit(&self, resolution: &Resolution) -> Option<Polynomial> {
        let (refiner, bounds) = (self.refiner, self.bounds);
        let lines = refiner.all_parameters(bounds, &resolution.nodes);
        let places = self.places(lines)?.places;
        Some(refiner.polynomial_of(bounds, &resolution.nodes, places))
    }

    /// Takes more nodes until the polynomial is as close to the held-out places as it has to be, or gets no closer; returns
    /// it with its error there.
    fn refined(
        &self,
        mut resolution: Resolution,
        mut polynomial: Polynomial,
        held_out: &PlacesOnLines,
    ) -> Option<(Polynomial, f64)> {
        let most_lines = self.refiner.most_rays(self.bounds) / BISECTIONS;
        let limits = self.limits();
        loop {
            let left = held_out.error(|points| polynomial.at(points));
            let mut spectra = polynomial.spectra();
            spectra[self.axis] = vec![0.0];
            spectra[self.bounds.arc()] = vec![0.0];
            if left <= ROOMY || !resolution.raise((&limits, most_lines), &spectra, left) {
                return Some((polynomial, left));
            }
            polynomial = self.fit(&resolution)?;
        }
    }

    /// Finds by bisection where the kind of rays changes on lines along the axis through these parameters; none if it does
    /// not on all of them, and in one sense.
    fn places(&self, lines: Vec<Vec<f64>>) -> Option<PlacesOnLines> {
        let tolerance = self.refiner.plan.tolerance;
        let coarse = Bisection {
            search: self,
            lines: &lines,
            around: self.within,
            halvings: COARSE_BISECTIONS,
            tolerance,
        };
        let middle = vec![0.0; lines.len()];
        let near = coarse.changes(middle.clone())?;
        let finer = Bisection {
            around: self.within * 0.5_f64.powi(TRUSTED_BISECTIONS as i32),
            halvings: BISECTIONS - TRUSTED_BISECTIONS,
            tolerance: finer(tolerance),
            ..coarse
        };
        // Where the plan's tolerance does not tell, from the beginning.
        let places = finer.changes(near).or_else(|| {
            let whole = Bisection {
                around: self.within,
                halvings: BISECTIONS,
                ..finer
            };
            whole.changes(middle)
        })?;
        Some(PlacesOnLines { lines, places })
    }

    /// Tells of rays with these parameters whether their paths end at the edge behind the piece; none when it is stopped.
    fn meet_edge(&self, points: &[Vec<f64>], tolerance: f64) -> Option<Vec<bool>> {
        let refiner = self.refiner;
        if !refiner.tally.go_on(points.len()) {
            return None;
        }
        let ray = |x: &Vec<f64>| {
            let (u, d) = refiner.ray(self.chunk, self.bounds, x);
            (u, refiner.space.manifold().local_frame(u).tangent(d))
        };
        let rays = |numbers: Range<usize>| points[numbers].iter().map(ray).collect();
        let ends = refiner.ends(self.piece, tolerance, (points.len(), rays));
        Some(ends.iter().map(|end| !end.is_nan()).collect())
    }
}

/// The search for the places on lines along an axis of a box at which the kind of rays changes.
#[derive(Clone, Copy)]
struct Bisection<'a> {
    search: &'a SeparatrixSearch<'a>,
    lines: &'a [Vec<f64>],
    /// How far on both sides of where it begins it is looked for.
    around: f64,
    halvings: usize,
    tolerance: f64,
}

impl Bisection<'_> {
    /// Finds them around `places`; none if they are not there on all lines, or not in one sense.
    fn changes(&self, mut places: Vec<f64>) -> Option<Vec<f64>> {
        let [low, high] = [-self.around, self.around].map(|by| {
            let ends: Vec<f64> = places.iter().map(|place| place + by).collect();
            self.kinds(&ends)
        });
        let (low, high) = (low?, high?);
        let first = *low.first()?;
        if low.contains(&!first) || high.contains(&first) {
            return None;
        }
        for halving in 1..=self.halvings {
            let step = self.around * 0.5_f64.powi(halving as i32);
            let kinds = self.kinds(&places)?;
            for (place, kind) in places.iter_mut().zip(kinds) {
                *place += if kind == first { step } else { -step };
            }
        }
        Some(places)
    }

    /// Returns the kind of a ray on each line, at these places.
    fn kinds(&self, places: &[f64]) -> Option<Vec<bool>> {
        let point = |(line, x): (&Vec<f64>, &f64)| {
            let mut line = line.clone();
            line[self.search.axis] = *x;
            line
        };
        let points: Vec<Vec<f64>> = self.lines.iter().zip(places).map(point).collect();
        self.search.meet_edge(&points, self.tolerance)
    }
}

/// Lines along an axis of a box, and where on each of them the separatrix is.
struct PlacesOnLines {
    lines: Vec<Vec<f64>>,
    places: Vec<f64>,
}

impl PlacesOnLines {
    /// Measures the largest error of what `read` gives as the places, in units of [`PLACE_ERROR`].
    fn error(&self, read: impl FnOnce(&[&[f64]]) -> Vec<Vec<f64>>) -> f64 {
        let points: Vec<&[f64]> = self.lines.iter().map(Vec::as_slice).collect();
        let found = read(&points).into_iter().zip(&self.places);
        let errors = found.map(|(row, place)| (row[0] - place).abs());
        errors.fold(0.0, f64::max) / PLACE_ERROR
    }

    /// Returns the part of the box on the lower side.
    fn share(&self) -> f64 {
        let lower = self.places.iter().map(|x| 0.5 * (x.clamp(-1.0, 1.0) + 1.0));
        lower.sum::<f64>() / self.places.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_bundle::{MappedChebyshev, StepSize, Train, Variables};
    use ndarray::{ArrayD, IxDyn};

    /// Makes a separatrix along `axis` of a box of two directions whose place depends on the other one.
    fn found(axis: usize) -> Arc<SeparatrixDivision> {
        let mut shape = [1, 1, 1, 1];
        shape[1 - axis] = 2;
        let place = Train::plain(&Polynomial {
            coefficients: ArrayD::from_elem(IxDyn(&shape), 0.3),
            variables: Variables {
                cameras: 0,
                mapping: MappedChebyshev::NONE,
                sphere: false,
            },
        });
        Arc::new(SeparatrixDivision {
            place: Arc::new(place.rounded(StepSize::near(1e-7)).unwrap()),
            reach: SideReach::covering(axis, [0.0, 0.6]).unwrap(),
            share: 0.65,
        })
    }

    #[test]
    fn rays_in_nested_boxes_beside_separatrices_are_found_again() {
        let whole = ParameterBox::whole(3, Some(0), vec![1]).half(1, 0);
        let [low, _] = whole.sides(&found(1));
        let [_, inner] = low.half(0, 1).half(1, 1).sides(&found(0));
        let inner = inner.half(0, 0);
        for x in [[-0.9, 0.2], [0.0, 0.0], [0.7, -0.4]] {
            let chunk = inner.in_chunk(&x);
            let again = inner.in_box(&chunk);
            assert!(
                (again[0] - x[0]).abs() + (again[1] - x[1]).abs() < 1e-12,
                "{again:?}"
            );
        }
        // The upper end of the lower side is the separatrix itself, of the lower half of axis 1.
        let on_it = low.in_chunk(&[0.5, 1.0]);
        assert!(
            (on_it[1] - 0.5 * (0.3 + 0.3 * 0.5 - 1.0)).abs() < 1e-6,
            "{on_it:?}"
        );
        let all: f64 = whole.sides(&found(1)).iter().map(|side| side.share).sum();
        assert!((all - whole.share).abs() < 1e-15);
    }
}
