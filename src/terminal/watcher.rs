//! Shows the progress of a library's long work, and hands signals on to it.

use super::{CommonArgs, Interrupt, ProgressDisplay};
use geofan_core::{Observer, Progress, Result};
use std::sync::Mutex;

/// Shows progress on the terminal, and ends work when the user asks.
#[derive(Debug)]
pub struct Watcher {
    common: CommonArgs,
    interrupt: Interrupt,
    shown: Mutex<Option<Shown>>,
}

/// Remembers what the display says.
#[derive(Debug)]
struct Shown {
    work: String,
    done: u64,
    display: ProgressDisplay,
}

impl Watcher {
    /// Begins to listen to signals.
    ///
    /// # Errors
    /// The system refuses the handlers.
    pub fn new(common: &CommonArgs) -> Result<Self> {
        Ok(Self {
            common: common.clone(),
            interrupt: Interrupt::install()?,
            shown: Mutex::default(),
        })
    }
}

impl Observer for Watcher {
    fn progress(&self, progress: Progress<'_>) {
        let mut shown = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        let current = match shown.take().filter(|s| s.work == progress.work) {
            Some(current) => current,
            None if progress.done >= progress.total && progress.total == 0 => return,
            None => Shown {
                work: progress.work.into(),
                done: 0,
                display: ProgressDisplay::new(&self.common, progress.work, progress.total),
            },
        };
        let done = progress.done.max(current.done);
        if !progress.detail.is_empty() {
            let message = format!("{}: {}", progress.work, progress.detail);
            current.display.set_message(message);
        }
        current.display.inc(done - current.done);
        match done >= progress.total {
            true => current.display.finish(),
            false => *shown = Some(Shown { done, ..current }),
        }
    }

    fn cancelled(&self) -> bool {
        self.interrupt.requested()
    }
}
