//! What stands around an integer of a tensor, before it in storage order.
//!
//! In: a shape, and place after place. Out: the integers beside each, and the mean size at the same place of
//! the vectors before it.

/// An integer that comes before.
#[derive(Debug, Clone, Copy)]
struct Beside {
    axis: usize,
    /// How many places back along it.
    back: usize,
    /// How many places further along the last axis.
    shift: isize,
    /// How far before in storage.
    offset: usize,
    /// How much it counts at first.
    weight: f64,
}

/// How far back along the last axis integers are looked at, and how much they count at first. Two back as
/// much as one: in even and odd functions every other coefficient is zero.
const ALONG_LAST: [f64; 4] = [3.0, 3.0, 0.5, 0.5];

/// How far back along another axis, and how far on along the last, and how much these count at first.
const ALONG_OTHERS: [(usize, isize, f64); 6] = [
    (1, 0, 3.0),
    (2, 0, 2.0),
    (3, 0, 0.5),
    (1, -1, 0.5),
    (1, 1, 0.5),
    (1, 2, 0.5),
];

/// The farthest of them.
const FARTHEST_BACK: usize = 3;
const FARTHEST_ON: usize = 2;

/// How much the mean of the vectors before counts at first.
const BEFORE: f64 = 3.0;

/// Walks a tensor in storage order.
#[derive(Debug)]
pub(super) struct Walk {
    /// Lengths of the axes that are longer than one.
    shape: Vec<usize>,
    index: Vec<usize>,
    beside: Vec<Beside>,
    history: History,
    /// What stands around the present place, and one for each that does, zero for others: in an order that
    /// depends on the number of axes only, the mean of the vectors before last.
    around: Vec<f64>,
    present: Vec<f64>,
}

/// Mean sizes at each place of the vectors before: what has one index along the first axis is a vector.
#[derive(Debug)]
struct History {
    /// In units of 1/[`PARTS`].
    means: Vec<i64>,
    place: usize,
    /// Complete vectors, as far as they count.
    vectors: i64,
}

/// Parts of one that means are counted in.
const PARTS: i64 = 16;

/// How many vectors a mean goes back.
const REMEMBERED: i64 = 8;

impl History {
    fn new(length: usize) -> Self {
        Self {
            means: vec![0; length],
            place: 0,
            vectors: 0,
        }
    }

    /// The mean at the present place; `None` in the first vector.
    fn mean(&self) -> Option<f64> {
        (self.vectors > 0).then(|| self.means[self.place] as f64 / PARTS as f64)
    }

    /// Adds the value of the present place, and on to the next.
    fn add(&mut self, value: i32) {
        let off = PARTS * i64::from(value.unsigned_abs()) - self.means[self.place];
        self.means[self.place] += off / (self.vectors + 1);
        self.place += 1;
        if self.place == self.means.len() {
            self.place = 0;
            self.vectors = (self.vectors + 1).min(REMEMBERED - 1);
        }
    }
}

impl Walk {
    /// Before the first place of a tensor of this shape.
    pub(super) fn new(shape: &[usize]) -> Self {
        let shape: Vec<usize> = shape.iter().copied().filter(|n| *n > 1).collect();
        let beside = beside(&shape);
        Self {
            index: vec![0; shape.len()],
            history: History::new(shape.iter().skip(1).product()),
            around: vec![0.0; beside.len() + 1],
            present: vec![0.0; beside.len() + 1],
            beside,
            shape,
        }
    }

    /// On to the place after the `values`.
    pub(super) fn on(&mut self, values: &[i32]) {
        if let Some(last) = values.last() {
            self.history.add(*last);
            self.advance();
        }
    }

    /// Looks around at the present place, after the `values`.
    pub(super) fn look(&mut self, values: &[i32]) {
        match self.is_inside() {
            true => self.look_inside(values),
            false => self.look_at_border(values),
        }
        let (before, i) = (self.history.mean(), self.beside.len());
        self.around[i] = before.unwrap_or(0.0);
        self.present[i] = f64::from(u8::from(before.is_some()));
    }

    /// Whether all neighbours exist.
    fn is_inside(&self) -> bool {
        let last = self.shape.len().saturating_sub(1);
        let (column, width) = match self.index.last() {
            Some(column) => (*column, self.shape[last]),
            None => return false,
        };
        let row = self.index[..last].iter().all(|i| *i >= FARTHEST_BACK);
        row && column >= ALONG_LAST.len() && column + FARTHEST_ON < width
    }

    fn look_inside(&mut self, values: &[i32]) {
        for (around, beside) in self.around.iter_mut().zip(&self.beside) {
            *around = f64::from(values[values.len() - beside.offset]);
        }
        self.present.fill(1.0);
    }

    fn look_at_border(&mut self, values: &[i32]) {
        let last = self.shape.len().saturating_sub(1);
        for (i, beside) in self.beside.iter().enumerate() {
            let column = self.index[last].wrapping_add_signed(beside.shift);
            let exists = self.index[beside.axis] >= beside.back && column < self.shape[last];
            let value = if exists {
                values[values.len() - beside.offset]
            } else {
                0
            };
            self.around[i] = f64::from(value);
            self.present[i] = f64::from(u8::from(exists));
        }
    }

    /// How many axes are longer than one.
    fn axes(&self) -> usize {
        self.shape.len()
    }

    /// What stands around the present place (0 where nothing does), and one for each that does, zero for
    /// others. Last the mean size at this place of the vectors before.
    pub(super) fn around(&self) -> (&[f64], &[f64]) {
        (&self.around, &self.present)
    }

    /// The integers beside the present place, and for each whether there is one.
    pub(super) fn beside(&self) -> (&[f64], &[f64]) {
        let count = self.beside.len();
        (&self.around[..count], &self.present[..count])
    }

    /// How much each of those around counts before anything is known, all together one.
    pub(super) fn first_weights(&self) -> Vec<f64> {
        let beside = self.beside.iter().map(|b| b.weight);
        let weights: Vec<f64> = beside.chain([BEFORE]).collect();
        let sum: f64 = weights.iter().sum();
        weights.iter().map(|w| w / sum).collect()
    }

    fn advance(&mut self) {
        for axis in (0..self.shape.len()).rev() {
            self.index[axis] += 1;
            if self.index[axis] < self.shape[axis] {
                return;
            }
            self.index[axis] = 0;
        }
    }
}

/// Weights of what stands around a place, for each number of axes.
#[derive(Debug, Default)]
pub(super) struct Weights(Vec<Vec<f64>>);

impl Weights {
    /// Those for the axes of `walk`, as `first` gives them before anything is known.
    pub(super) fn of(&mut self, walk: &Walk, first: impl FnOnce() -> Vec<f64>) -> &mut [f64] {
        let axes = walk.axes();
        if self.0.len() <= axes {
            self.0.resize(axes + 1, Vec::new());
        }
        let weights = &mut self.0[axes];
        if weights.is_empty() {
            *weights = first();
        }
        weights
    }
}

/// All that a place inside of a tensor of this shape has.
fn beside(shape: &[usize]) -> Vec<Beside> {
    let mut all = Vec::new();
    for axis in (0..shape.len()).rev() {
        let stride: usize = shape[axis + 1..].iter().product();
        let along_last = (1..).zip(ALONG_LAST).map(|(back, w)| (back, 0, w));
        let ways: Vec<(usize, isize, f64)> = match axis + 1 == shape.len() {
            true => along_last.collect(),
            false => ALONG_OTHERS.to_vec(),
        };
        all.extend(ways.into_iter().map(|(back, shift, weight)| Beside {
            axis,
            back,
            shift,
            offset: (back * stride).saturating_add_signed(-shift),
            weight,
        }));
    }
    all
}
