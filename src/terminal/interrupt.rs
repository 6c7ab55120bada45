//! Ctrl-C and SIGTERM: the first asks, the second quits.
//!
//! In: signals. Out: an [`Interrupt`] that long work polls between pieces of work.

use geofan_core::error::{Error, Result};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// The exit code of a process that quits at once, by the shells' convention for Ctrl-C.
const QUIT: i32 = 130;

/// Whether the user asked to stop. Copies share the answer; the default one is never set by a
/// signal.
#[derive(Debug, Clone, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// From now on the first SIGINT or SIGTERM is only noted, and a second one ends the process with
    /// code 130.
    ///
    /// # Errors
    /// The system refuses the handlers.
    pub fn install() -> Result<Self> {
        let interrupt = Self::default();
        for signal in [SIGINT, SIGTERM] {
            // The order matters: the second signal finds the flag set before it is set again.
            flag::register_conditional_shutdown(signal, QUIT, interrupt.0.clone())
                .and_then(|_| flag::register(signal, interrupt.0.clone()))
                .map_err(|source| Error::Environment {
                    path: "signal handlers".into(),
                    source,
                })?;
        }
        Ok(interrupt)
    }

    /// Whether to stop at the next good place.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
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
            let interrupt = Interrupt::install().unwrap();
            assert!(!interrupt.requested());
            raise(SIGTERM).unwrap();
            assert!(interrupt.requested());
            raise(SIGINT).unwrap();
            unreachable!("the second signal quits");
        }
        let name = "terminal::interrupt::tests::the_first_signal_is_noted_and_the_second_quits";
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
