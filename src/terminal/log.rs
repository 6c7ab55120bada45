//! What goes to stderr: log lines and progress bars, kept from writing into each other.
//!
//! In: tracing events, lines. Out: text on stderr, coloured on a terminal unless `NO_COLOR` is set.

use indicatif::MultiProgress;
use std::{
    env,
    io::{self, IsTerminal, Write},
    sync::LazyLock,
};
use tracing_subscriber::{EnvFilter, fmt};

/// What is logged when `RUST_LOG` does not say.
const USUAL: &str = "warn,geofan=info,geofan_bake=info";
const QUIET: &str = "error";

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// The bars on the terminal.
pub(super) fn bars() -> &'static MultiProgress {
    &BARS
}

/// Whether stderr takes colours.
pub fn colour() -> bool {
    let unset = |name| env::var_os(name).is_none_or(|value| value.is_empty());
    io::stderr().is_terminal()
        && unset("NO_COLOR")
        && env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Sends tracing events to stderr: those that `RUST_LOG` names, errors only when `quiet`. In a log
/// file each line has its time. A second call changes nothing.
pub(super) fn start(quiet: bool) {
    let asked = env::var("RUST_LOG").ok().filter(|_| !quiet);
    let usual = if quiet { QUIET } else { USUAL };
    let filter = EnvFilter::builder().parse_lossy(asked.as_deref().unwrap_or(usual));
    let builder = fmt()
        .with_env_filter(filter)
        .with_ansi(colour())
        .with_target(false)
        .with_writer(|| Stderr);
    // Another subscriber is already at work when tests start this twice.
    let _ = if io::stderr().is_terminal() {
        builder.without_time().try_init()
    } else {
        builder.try_init()
    };
}

/// Writes one line to stderr, above any bar. A closed stderr is no reason to stop.
pub fn line(text: &str) {
    let _ = writeln!(Stderr, "{text}");
}

/// stderr, with bars moved out of the way.
struct Stderr;

impl Write for Stderr {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.write_all(bytes).map(|()| bytes.len())
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        BARS.suspend(|| io::stderr().lock().write_all(bytes))
    }

    fn write_fmt(&mut self, arguments: std::fmt::Arguments<'_>) -> io::Result<()> {
        self.write_all(arguments.to_string().as_bytes())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
