//! Which vectors of a core are kept one after the other.
//!
//! The cores of a train, each as the centre of an orthogonal train, have columns that are orthogonal to
//! each other (those of all left indices and axes, one for each right index) and rows that are (those of
//! all axes and right indices, one for each left index). Of one kind [`super::reflections`] keeps what
//! orthogonality leaves free; of the more numerous kind that is least.

use super::reflections::transposed;

/// The kind of vectors that are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// One for each right index.
    Columns,
    /// One for each left index.
    Rows,
}

impl Side {
    /// Of a core of this shape (left rank, axes…, right rank) behind another. Bonds are divided by scales,
    /// which are only near their singular values. That is made good in the columns before the bond or
    /// in the rows behind it, and these are then no longer orthogonal to those of the other kind: once
    /// rows are kept, columns are not.
    pub(super) fn behind(before: Option<Self>, shape: &[usize]) -> Self {
        match before == Some(Self::Rows) || shape[0] > shape[shape.len() - 1] {
            true => Self::Rows,
            false => Self::Columns,
        }
    }

    /// How many vectors there are; all numbers are one where so many cannot be orthogonal.
    fn count(self, shape: &[usize]) -> usize {
        let count = match self {
            Self::Columns => shape[shape.len() - 1],
            Self::Rows => shape[0],
        };
        match count * count <= shape.iter().product() {
            true => count,
            false => 1,
        }
    }

    /// How long they are.
    pub(super) fn length(self, shape: &[usize]) -> usize {
        shape.iter().product::<usize>() / self.count(shape)
    }

    fn turns(self, shape: &[usize]) -> bool {
        self == Self::Columns && self.count(shape) > 1
    }

    /// The shape of a core of this shape as one vector after the other.
    pub(super) fn shape(self, shape: &[usize]) -> Vec<usize> {
        let mut turned = shape.to_vec();
        if self.turns(shape) {
            turned.rotate_right(1);
        }
        turned
    }

    /// One vector after the other of the values of a core in storage order.
    pub(super) fn vectors(self, shape: &[usize], values: Vec<f64>) -> Vec<f64> {
        match self.turns(shape) {
            true => transposed(&values, shape[shape.len() - 1]),
            false => values,
        }
    }

    /// What [`Side::vectors`] made these of.
    pub(super) fn values(self, shape: &[usize], vectors: Vec<f64>) -> Vec<f64> {
        match self.turns(shape) {
            true => transposed(&vectors, self.length(shape)),
            false => vectors,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_come_back_as_values() {
        for shape in [
            &[1, 7, 5][..],
            &[5, 6, 4],
            &[4, 3, 2, 1],
            &[2, 2, 9],
            &[1, 8, 1],
        ] {
            let values: Vec<f64> = (0..shape.iter().product::<usize>())
                .map(|i| i as f64)
                .collect();
            for side in [Side::Columns, Side::Rows] {
                let vectors = side.vectors(shape, values.clone());
                assert_eq!(side.values(shape, vectors), values);
                assert_eq!(side.shape(shape).iter().product::<usize>(), values.len());
                assert_eq!(values.len() % side.length(shape), 0);
            }
        }
        let columns = Side::Columns.vectors(&[1, 3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(columns, [0.0, 2.0, 4.0, 1.0, 3.0, 5.0]);
    }

    #[test]
    fn columns_are_kept_while_ranks_grow_and_rows_from_then_on() {
        let mut before = None;
        let shapes = [[1, 9, 5], [5, 9, 30], [30, 9, 7], [7, 9, 8], [8, 9, 1]];
        let expected = [
            Side::Columns,
            Side::Columns,
            Side::Rows,
            Side::Rows,
            Side::Rows,
        ];
        for (shape, expected) in shapes.iter().zip(expected) {
            let side = Side::behind(before, shape);
            assert_eq!(side, expected, "{shape:?}");
            before = Some(side);
        }
    }
}
