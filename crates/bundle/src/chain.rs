//! Products of chains of matrices.
//!
//! In: cores with open axes between their ranks. Out: their product, in the order of the fewest
//! multiplications.

use super::{cores::Core, matrix::product};
use geofan_expr::real::Real;

/// An array (left rank, open axes, right rank).
#[derive(Debug, Clone)]
pub(super) struct Link<T> {
    pub left: usize,
    pub right: usize,
    pub values: Vec<T>,
}

/// A factor of a chain.
#[derive(Debug, Clone)]
pub(super) enum Factor<'c, T> {
    /// Whose numbers are known.
    Known(Link<T>),
    /// A core all of whose axes are open, times a unit: as it is kept it is read faster than it is restored.
    Kept(&'c Core, f64),
    /// A core whose only axis is summed out with weights, times a unit: not before it is multiplied, so that few
    /// sums are held at once.
    Summed(&'c Core, &'c [T], f64),
}

impl<T: Real> Factor<'_, T> {
    /// The left rank.
    fn left(&self) -> usize {
        match self {
            Self::Known(link) => link.left,
            Self::Kept(core, _) | Self::Summed(core, ..) => core.shape[0],
        }
    }

    fn right(&self) -> usize {
        match self {
            Self::Known(link) => link.right,
            Self::Kept(core, _) | Self::Summed(core, ..) => core.shape[core.shape.len() - 1],
        }
    }

    /// The product of the lengths of the open axes.
    fn open(&self) -> usize {
        match self {
            Self::Known(link) => link.values.len() / (link.left * link.right).max(1),
            Self::Kept(core, _) => core.shape[1..core.shape.len() - 1].iter().product(),
            Self::Summed(..) => 1,
        }
    }

    /// The numbers.
    fn values(self) -> Vec<T> {
        match self {
            Self::Known(link) => link.values,
            Self::Kept(core, unit) => core.closed(&[], unit),
            Self::Summed(core, weights, unit) => core.sums(weights, unit).values(),
        }
    }

    /// The product of this and the next.
    fn times(self, next: &Self) -> Self {
        let (left, inner, right) = (self.left(), self.right(), next.right());
        let a = self.values();
        let values = match next {
            Self::Known(link) => product(&a, inner, &link.values),
            Self::Kept(core, unit) => core.behind(&a, *unit),
            Self::Summed(core, weights, unit) => core.sums(weights, *unit).behind(&a, inner),
        };
        Self::Known(Link {
            left,
            right,
            values,
        })
    }
}

/// The product of `factors`, whose ranks fit: the open axes of all, in their order.
pub(super) fn chained<T: Real>(mut factors: Vec<Factor<'_, T>>) -> Vec<T> {
    while factors.len() > 1 {
        let first = cheapest(&factors);
        let second = factors.remove(first + 1);
        let joined = factors.remove(first).times(&second);
        factors.insert(first, joined);
    }
    factors.pop().map_or(Vec::new(), Factor::values)
}

/// The first of the two neighbours to be multiplied next: those that belong together in the order of
/// the fewest multiplications.
fn cheapest<T: Real>(factors: &[Factor<'_, T>]) -> usize {
    let n = factors.len();
    let open = |i: usize, j: usize| -> usize { factors[i..=j].iter().map(Factor::open).product() };
    // Fewest multiplications for the factors i to j, and after which of them they are parted last.
    let mut best = vec![vec![(0_usize, 0_usize); n]; n];
    for length in 2..=n {
        for i in 0..=n - length {
            let j = i + length - 1;
            let joining = |k: usize| {
                let ends = factors[i].left() * open(i, j) * factors[j].right();
                (
                    best[i][k].0 + best[k + 1][j].0 + ends * factors[k].right(),
                    k,
                )
            };
            best[i][j] = (i..j).map(joining).min().unwrap_or_default();
        }
    }
    let (mut i, mut j) = (0, n - 1);
    while j > i + 1 {
        let after = best[i][j].1;
        (i, j) = if after > i {
            (i, after)
        } else {
            (after + 1, j)
        };
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_of_any_shape_are_multiplied() {
        // Ranks 1, 3, 5, 2, 1 with open axes 4, 1, 7, 3.
        let shapes = [(1, 4, 3), (3, 1, 5), (5, 7, 2), (2, 3, 1)];
        let number = |i: usize| ((i * 37 % 11) as f64) - 5.0;
        let links = |from: usize| {
            let links = shapes.iter().skip(from).map(|&(left, open, right)| Link {
                left,
                right,
                values: (0..left * open * right).map(number).collect(),
            });
            links.collect::<Vec<_>>()
        };
        let chained = |from| chained(links(from).into_iter().map(Factor::Known).collect());
        let mut expected = vec![1.0];
        let mut rank = 1;
        for link in links(0) {
            expected = product(&expected, rank, &link.values);
            rank = link.right;
        }
        assert_eq!(chained(0), expected);
        assert_eq!(chained(3), links(3)[0].values);
    }
}
