//! The nodes that a walk through the tree has still to visit.

/// Nodes that fit the array of a [`Stack`], which is cleared for every question.
const STACK: usize = 32;

/// Nodes still to visit, with the place where the ray enters them. Trees are rarely deeper than
/// the array; the list takes what is.
pub(super) struct Stack {
    array: [(u32, f32); STACK],
    count: usize,
    rest: Vec<(u32, f32)>,
}

impl Default for Stack {
    fn default() -> Self {
        Self {
            array: [(0, 0.0); STACK],
            count: 0,
            rest: Vec::new(),
        }
    }
}

impl Stack {
    #[inline(always)]
    pub(super) fn push_if(&mut self, wanted: bool, entry: (u32, f32)) {
        match self.array.get_mut(self.count) {
            _ if !wanted => {}
            Some(slot) => {
                *slot = entry;
                self.count += 1;
            }
            None => self.rest.push(entry),
        }
    }

    #[inline(always)]
    pub(super) fn pop(&mut self) -> Option<(u32, f32)> {
        if let Some(entry) = self.rest.pop() {
            return Some(entry);
        }
        self.count = self.count.checked_sub(1)?;
        Some(self.array[self.count])
    }
}
