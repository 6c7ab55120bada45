//! How the numbers of a core are cut into panels, and how many bytes they need.
//!
//! In: an array in units of a step, and along which axis it is read. Out: integers, sixteen columns for all of that
//! axis before the next sixteen, and for each such panel how many of its numbers are long, short and small.

use std::ops::Range;

/// Numbers side by side that are kept alike: one of the widest vectors.
pub(super) const BESIDE: usize = 16;

/// So many of them.
pub(super) type Beside<N> = [N; BESIDE];

/// The lengths of the axes of an array whose numbers are read along the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Axes {
    pub before: usize,
    pub along: usize,
    pub after: usize,
    pub columns: usize,
}

impl Axes {
    /// How many panels a row has.
    pub fn beside(self) -> usize {
        self.columns.div_ceil(BESIDE)
    }

    /// How many rows there are without the axis along.
    pub fn rows(self) -> usize {
        self.before * self.after
    }

    /// How many numbers there are.
    pub fn numbers(self) -> usize {
        self.rows() * self.along * self.columns
    }

    /// Of which row and columns a panel is, in storage order without the axis along.
    pub fn place(self, panel: usize) -> (usize, Range<usize>) {
        let first = panel % self.beside() * BESIDE;
        let range = first..self.columns.min(first + BESIDE);
        (panel / self.beside(), range)
    }
}

/// How closely numbers are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// In four bytes, within a thousandth of a step where they are not large: for what is still compared.
    Close,
    /// In as few bytes as leave them within a sixteenth of a step. Together with the half step by which
    /// kept integers are rounded, that is 1.01 times as much.
    Small,
}

impl Packing {
    /// Bits behind the point that numbers have at most.
    fn fraction(self) -> i32 {
        match self {
            Self::Close => 10,
            Self::Small => 3,
        }
    }

    /// How many numbers of a panel are kept, and how.
    fn depth(self, panel: &[Beside<i32>]) -> Depth {
        // Behind the last that is too large.
        let end = |most: i32| {
            let fits = |x: &Beside<i32>| x.iter().all(|x| x.abs() <= most);
            let last = panel.iter().rposition(|x| !fits(x));
            last.map_or(0, |last| last + 1)
        };
        let kept = end(0);
        let [longs_end, shorts_end] = match self {
            Self::Close => [kept; 2],
            Self::Small => [i16::MAX.into(), i8::MAX.into()].map(end),
        };
        Depth {
            kept,
            shorts_end,
            longs_end,
        }
    }
}

/// How many numbers of a panel are kept, and behind which of them are none longer than bytes and than short ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Depth {
    kept: usize,
    shorts_end: usize,
    longs_end: usize,
}

impl Depth {
    /// Which numbers of a panel are long, short and small.
    #[inline(always)]
    pub fn ranges(self) -> [Range<usize>; 3] {
        let Self {
            kept,
            shorts_end,
            longs_end,
        } = self;
        [0..longs_end, longs_end..shorts_end, shorts_end..kept]
    }

    /// How many they are.
    #[inline(always)]
    pub fn lengths(self) -> [usize; 3] {
        self.ranges().map(|range| range.len())
    }
}

/// The largest integer; a bit is spared for sums.
const LARGEST: f64 = (1 << 30) as f64;

/// An array as integers, cut into panels.
pub(super) struct Panels {
    /// What an integer stands for.
    pub unit: f64,
    /// Sixteen columns for all of the axis along before the next sixteen.
    pub integers: Vec<Beside<i32>>,
    /// How the panels that are not all zeros are kept, and which they are; those kept alike behind each other.
    pub depths: Vec<(Depth, u32)>,
}

impl Panels {
    /// Of `values` in storage order.
    pub fn new(values: &[f64], axes: Axes, packing: Packing) -> Self {
        let largest = values.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
        let room = (LARGEST / largest).log2().floor() as i32;
        let per_step = f64::from(1 << room.clamp(0, packing.fraction()));
        let integers = in_panels(values, axes, per_step);
        let panels = integers.chunks_exact(axes.along);
        let depths = panels.map(|panel| packing.depth(panel)).zip(0..);
        let mut depths: Vec<_> = depths.filter(|(depth, _)| depth.kept > 0).collect();
        depths.sort_unstable();
        Self {
            unit: 1.0 / per_step,
            integers,
            depths,
        }
    }

    /// How many numbers are long, short and small in all.
    pub fn lengths(&self) -> [usize; 3] {
        let lengths = self.depths.iter().map(|(depth, _)| depth.lengths());
        lengths.fold([0; 3], |all, own| {
            [0, 1, 2].map(|size| all[size] + own[size])
        })
    }
}

/// `values` as integers, each sixteen columns for all of the axis along before the next sixteen.
fn in_panels(values: &[f64], axes: Axes, per_step: f64) -> Vec<Beside<i32>> {
    let Axes {
        along,
        after,
        columns,
        ..
    } = axes;
    let mut integers = vec![[0; BESIDE]; axes.rows() * axes.beside() * along];
    for (row, numbers) in values.chunks_exact(columns).enumerate() {
        let (before, k, after) = (row / after / along, row / after % along, row % after);
        let first = (before * axes.after + after) * axes.beside();
        for (panel, numbers) in numbers.chunks(BESIDE).enumerate() {
            let to = &mut integers[(first + panel) * along + k];
            let pairs = to.iter_mut().zip(numbers);
            pairs.for_each(|(to, x)| *to = (x * per_step).round() as i32);
        }
    }
    integers
}
