//! Products of chains of matrices.
//!
//! In: cores with open axes between their ranks. Out: their product, in the order of the fewest
//! multiplications.

use super::matrix::product;
use crate::expr::real::Real;

/// An array (left rank, open axes, right rank).
#[derive(Debug, Clone)]
pub(super) struct Link<T> {
    pub left: usize,
    pub right: usize,
    pub values: Vec<T>,
}

impl<T> Link<T> {
    /// The product of the lengths of the open axes.
    fn open(&self) -> usize {
        self.values.len() / (self.left * self.right).max(1)
    }
}

/// The product of `links`, whose ranks fit: the open axes of all, in their order.
pub(super) fn chained<T: Real>(mut links: Vec<Link<T>>) -> Vec<T> {
    while links.len() > 1 {
        let first = cheapest(&links);
        let second = links.remove(first + 1);
        let joined = &mut links[first];
        joined.values = product(&joined.values, joined.right, &second.values);
        joined.right = second.right;
    }
    links.pop().map_or(Vec::new(), |link| link.values)
}

/// The first of the two neighbours to be multiplied next: those that belong together in the order of
/// the fewest multiplications.
fn cheapest<T>(links: &[Link<T>]) -> usize {
    let n = links.len();
    let open = |i: usize, j: usize| -> usize { links[i..=j].iter().map(Link::open).product() };
    // Fewest multiplications for the links i to j, and after which link they are parted last.
    let mut best = vec![vec![(0_usize, 0_usize); n]; n];
    for length in 2..=n {
        for i in 0..=n - length {
            let j = i + length - 1;
            let joining = |k: usize| {
                let ends = links[i].left * open(i, j) * links[j].right;
                (best[i][k].0 + best[k + 1][j].0 + ends * links[k].right, k)
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
        let mut expected = vec![1.0];
        let mut rank = 1;
        for link in links(0) {
            expected = product(&expected, rank, &link.values);
            rank = link.right;
        }
        assert_eq!(chained(links(0)), expected);
        assert_eq!(chained(links(3)), links(3)[0].values);
    }
}
