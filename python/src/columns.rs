//! Results of many rays, written side by side by many threads.
//!
//! In: numpy arrays whose first axis counts rays. Out: their slices, cut into blocks of rays, so that each thread
//! writes its rays where Python reads them and nothing is copied.

/// Columns of the rays of a block; those that are not wanted are empty.
pub struct Columns<'a, const F: usize, const I: usize> {
    /// Columns of numbers, with how many each ray has.
    pub floats: [(&'a mut [f64], usize); F],
    /// Columns of whole numbers, one a ray.
    pub integers: [&'a mut [i32]; I],
}

impl<'a, const F: usize, const I: usize> Columns<'a, F, I> {
    /// Cuts them after so many rays.
    fn split(self, rays: usize) -> (Self, Self) {
        let floats = self.floats.map(|(column, width)| {
            let (head, tail) = column.split_at_mut((rays * width).min(column.len()));
            ((head, width), (tail, width))
        });
        let integers = self
            .integers
            .map(|column| column.split_at_mut(rays.min(column.len())));
        let (mut heads, mut tails) = (Vec::new(), Vec::new());
        for (head, tail) in floats {
            heads.push(head);
            tails.push(tail);
        }
        let (mut first, mut last) = (Vec::new(), Vec::new());
        for (head, tail) in integers {
            first.push(head);
            last.push(tail);
        }
        let join = |floats: Vec<_>, integers: Vec<_>| Self {
            floats: floats
                .try_into()
                .unwrap_or_else(|_| unreachable!("as many as before")),
            integers: integers
                .try_into()
                .unwrap_or_else(|_| unreachable!("as many as before")),
        };
        (join(heads, first), join(tails, last))
    }

    /// Cuts the columns of `rays` rays into blocks.
    pub fn blocks(self, rays: usize, block: usize) -> Vec<Self> {
        let mut blocks = Vec::with_capacity(rays.div_ceil(block));
        let (mut rest, mut left) = (self, rays);
        while left > block {
            let (head, tail) = rest.split(block);
            blocks.push(head);
            (rest, left) = (tail, left - block);
        }
        if left > 0 {
            blocks.push(rest);
        }
        blocks
    }

    /// Writes `values` of a ray from its place `at` on into a column; nothing if the column is not wanted.
    pub fn put(&mut self, column: usize, ray: usize, at: usize, values: &[f64]) {
        let (numbers, width) = &mut self.floats[column];
        if !numbers.is_empty() {
            let start = ray * *width + at;
            numbers[start..start + values.len()].copy_from_slice(values);
        }
    }

    /// Fills what a column has for a ray, from its place `at` on, with values that are not numbers.
    pub fn blank(&mut self, column: usize, ray: usize, at: usize) {
        let (numbers, width) = &mut self.floats[column];
        if !numbers.is_empty() {
            numbers[ray * *width + at..(ray + 1) * *width].fill(f64::NAN);
        }
    }
}
