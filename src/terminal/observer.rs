//! Watches long work for the user: shows its progress and hands signals on to it.
//!
//! In: reports of progress, SIGINT and SIGTERM. Out: text on stderr; the first signal asks the work to end,
//! the second ends the process at once.

use super::{CommonArgs, ProgressDisplay};
use geofan_core::{Error, Observer, Progress, Result};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};
use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, Ordering},
};

/// The exit code of a process that quits at once, by the shells' convention for Ctrl-C.
const QUIT: i32 = 130;

/// Shows progress on the terminal, and ends work when the user asks.
#[derive(Debug)]
pub struct TerminalObserver {
    common: CommonArgs,
    signalled: Arc<AtomicBool>,
    /// Name of the work under way and its display.
    shown: Mutex<Option<(String, ProgressDisplay)>>,
}

impl TerminalObserver {
    /// Begins to listen to signals.
    ///
    /// # Errors
    /// The system refuses the handlers.
    pub fn new(common: &CommonArgs) -> Result<Self> {
        Ok(Self {
            common: common.clone(),
            signalled: note_signals()?,
            shown: Mutex::default(),
        })
    }
}

impl Observer for TerminalObserver {
    fn progress(&self, progress: Progress<'_>) {
        let mut shown = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        let display = match shown.take() {
            Some((work, display)) if work == progress.work => display,
            _ if progress.done >= progress.total && progress.total == 0 => return,
            _ => ProgressDisplay::new(&self.common, progress.work, progress.total),
        };
        display.update(progress);
        match progress.done >= progress.total {
            true => display.finish(),
            false => *shown = Some((progress.work.into(), display)),
        }
    }

    fn cancelled(&self) -> bool {
        self.signalled.load(Ordering::Relaxed)
    }
}

/// Notes the first SIGINT or SIGTERM from now on, and lets a second one end the process.
fn note_signals() -> Result<Arc<AtomicBool>> {
    let signalled = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // The order matters: the second signal finds the flag set before it is set again.
        flag::register_conditional_shutdown(signal, QUIT, signalled.clone())
            .and_then(|_| flag::register(signal, signalled.clone()))
            .map_err(|source| Error::Environment {
                path: "signal handlers".into(),
                source,
            })?;
    }
    Ok(signalled)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use signal_hook::low_level::raise;
    use std::process::{Command, Stdio};

    const VARIABLE: &str = "GEOFAN_TEST_SIGNALS";

    /// Signals concern the whole process, so this test runs itself again in a process of its own.
    #[test]
    fn the_first_signal_is_noted_and_the_second_quits() {
        if std::env::var_os(VARIABLE).is_some() {
            let signalled = note_signals().unwrap();
            assert!(!signalled.load(Ordering::Relaxed));
            raise(SIGTERM).unwrap();
            assert!(signalled.load(Ordering::Relaxed));
            raise(SIGINT).unwrap();
            unreachable!("the second signal quits");
        }
        let name = "terminal::observer::tests::the_first_signal_is_noted_and_the_second_quits";
        let status = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", name])
            .env(VARIABLE, "1")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .unwrap();
        assert_eq!(status.code(), Some(QUIT));
    }
}
