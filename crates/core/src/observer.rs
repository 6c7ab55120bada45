//! Watching long work, and ending it.

/// Tells how far long work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress<'a> {
    /// Name of the work, the same from its first report to its last.
    pub work: &'a str,
    /// Units done so far.
    pub done: u64,
    /// Units in all; `done` reaches it when the work has ended.
    pub total: u64,
    /// Further figures for people; may be empty.
    pub detail: &'a str,
}

/// Watches long work: is told how far it is, and can end it.
pub trait Observer: Sync {
    /// Takes note of how far the work is. Called from any thread, a few times a second at most for
    /// each piece of work that is under way.
    fn progress(&self, progress: Progress<'_>);

    /// Tells whether the work is to end at the next good place.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Ends work as another observer says and shows none of its progress: for pieces of work that shows its
/// own.
pub struct Muted<'a>(pub &'a dyn Observer);

impl Observer for Muted<'_> {
    fn progress(&self, _: Progress<'_>) {}

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Lets work run to its end unwatched.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn progress(&self, _: Progress<'_>) {}
}
