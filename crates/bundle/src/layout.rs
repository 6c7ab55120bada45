//! How the axes of a tensor are shared out among the cores of its train.
//!
//! A tensor has ray axes (camera…, direction…), and last the arc length and the channel. In a train
//! each ray axis has a core of its own, in any order, and arc length and channel share the last. The
//! order matters: ranks are small where axes that belong together stand together, and which do
//! depends on the manifold, the region and the face of directions.

/// How the axes are shared out among cores.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layout {
    /// One core over all axes.
    Plain,
    /// A train with these ray axes, one to a core.
    Train(Vec<usize>),
}

impl Layout {
    /// The train that pairs each camera axis with a direction axis.
    pub fn paired(cameras: usize, directions: usize) -> Self {
        let mut order = Vec::new();
        for j in 0..cameras.max(directions) {
            order.extend((j < cameras).then_some(j));
            order.extend((j < directions).then_some(cameras + j));
        }
        Self::Train(order)
    }

    /// The axes of each core of a tensor of so many ray axes.
    pub fn cores(&self, rays: usize) -> Vec<Vec<usize>> {
        match self {
            Self::Plain => vec![(0..rays + 2).collect()],
            Self::Train(order) => {
                let last = vec![rays, rays + 1];
                order.iter().map(|axis| vec![*axis]).chain([last]).collect()
            }
        }
    }

    /// A number that stands for the layout: 0, or one more than the rank of the order among all
    /// orders sorted like words.
    pub fn code(&self) -> u8 {
        let Self::Train(order) = self else { return 0 };
        let smaller_after = |i: usize| order[i + 1..].iter().filter(|a| **a < order[i]).count();
        let rank = (0..order.len()).fold(0, |rank, i| rank * (order.len() - i) + smaller_after(i));
        1 + rank as u8
    }

    /// The layout of `rays` ray axes, five at most, that `code` stands for; `None` if there is none.
    pub fn of_code(code: u8, rays: usize) -> Option<Self> {
        let Some(mut rank) = usize::from(code).checked_sub(1) else {
            return Some(Self::Plain);
        };
        let mut places: Vec<usize> = (1..=rays)
            .map(|left| {
                let place = rank % left;
                rank /= left;
                place
            })
            .collect();
        places.reverse();
        let mut left: Vec<usize> = (0..rays).collect();
        let order = places.iter().map(|place| left.remove(*place)).collect();
        (rank == 0).then_some(Self::Train(order))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_order_has_a_code_of_its_own() {
        for (rays, orders) in [(0, 1), (1, 1), (2, 2), (3, 6), (4, 24), (5, 120)] {
            let mut seen = std::collections::HashSet::new();
            for code in 1..=orders {
                let layout = Layout::of_code(code, rays).unwrap();
                assert_eq!(layout.code(), code);
                assert_eq!(layout.cores(rays).concat().len(), rays + 2);
                assert!(seen.insert(format!("{layout:?}")));
            }
            assert_eq!(Layout::of_code(orders + 1, rays), None);
        }
        assert_eq!(Layout::of_code(0, 3), Some(Layout::Plain));
        assert_eq!(Layout::paired(2, 2), Layout::Train(vec![0, 2, 1, 3]));
        assert_eq!(Layout::paired(3, 2), Layout::Train(vec![0, 3, 1, 4, 2]));
    }
}
