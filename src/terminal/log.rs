//! What the user is told of work under way: log lines and the progress of long work on stderr, prevented from writing
//! into each other; and what the user tells it, by signals.
//!
//! In: tracing events, lines, counts from any thread. Out: text on stderr, coloured on a terminal unless
//! `NO_COLOR` is set; progress is a bar on a terminal, a plain line every few seconds in a log, nothing
//! when quiet.
//!
//! In: reports of progress, SIGINT, SIGTERM and SIGHUP ([`TerminalObserver`]). Out: progress; the first signal asks the work to
//! end, the second ends the process at once.

use super::CommonArgs;
use geofan_core::{Error, Observer, Progress, Result};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};
use std::{
    collections::VecDeque,
    env,
    io::{self, IsTerminal, Write},
    sync::{
        Arc, LazyLock, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};
use tracing_subscriber::{Layer, filter::Targets, fmt, prelude::*};

/// Filter of the log when `RUST_LOG` does not say.
const USUAL: &str = "error,geofan=info";
const QUIET: &str = "error";

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Tells whether stderr takes colours.
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
    let asked = asked.and_then(|text| text.parse::<Targets>().ok());
    let filter = asked.or_else(|| usual.parse().ok()).unwrap_or_default();
    let lines = fmt::layer()
        .with_ansi(colour())
        .with_target(false)
        .with_writer(|| Stderr);
    let lines = match io::stderr().is_terminal() {
        true => lines.without_time().with_filter(filter).boxed(),
        false => lines.with_filter(filter).boxed(),
    };
    // Another subscriber is already at work when tests start this twice.
    let _ = tracing_subscriber::registry().with(lines).try_init();
}

/// Writes one line to stderr, above any bar. A closed stderr is no reason to stop.
pub fn line(text: &str) {
    let _ = writeln!(Stderr, "{text}");
}

/// Writes to stderr, with bars moved out of the way.
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

/// Time between two plain lines: a log of an hour stays below a thousand lines.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Time between two drawings of the bar while nothing is counted, so that its clock runs.
const TICK: Duration = Duration::from_millis(250);

const TEMPLATE: &str = "{msg} {wide_bar} {human_pos}/{human_len} {per_sec} {eta} left";

/// Shows the progress of one piece of long work.
#[derive(Debug)]
pub enum ProgressDisplay {
    /// On a terminal.
    Bar(ProgressBar),
    /// In a log.
    Lines(ProgressLines),
    /// Nowhere.
    Silent,
}

impl ProgressDisplay {
    /// Begins work of `total` pieces, called `message`.
    pub fn new(common: &CommonArgs, message: impl Into<String>, total: u64) -> Self {
        let message = message.into();
        if common.quiet {
            Self::Silent
        } else if io::stderr().is_terminal() {
            Self::Bar(bar(message, total))
        } else {
            Self::Lines(ProgressLines::new(message, total))
        }
    }

    /// Counts so many more pieces as done.
    pub fn inc(&self, count: u64) {
        match self {
            Self::Bar(bar) => bar.inc(count),
            Self::Lines(lines) => {
                lines.done.fetch_add(count, Ordering::Relaxed);
                if let Some(due) = lines.due(lines.started.elapsed()) {
                    line(&due);
                }
            }
            Self::Silent => {}
        }
    }

    /// Changes the number of pieces in all.
    pub fn set_total(&self, total: u64) {
        match self {
            Self::Bar(bar) => bar.set_length(total),
            Self::Lines(lines) => lines.total.store(total, Ordering::Relaxed),
            Self::Silent => {}
        }
    }

    /// Takes over a report of progress; it never goes back.
    pub fn update(&self, progress: Progress<'_>) {
        let message = match progress.detail {
            "" => progress.work.into(),
            detail => format!("{}: {detail}", progress.work),
        };
        let done = match self {
            Self::Bar(bar) => {
                bar.set_message(message);
                bar.position()
            }
            Self::Lines(lines) => {
                *lines.message.lock().unwrap_or_else(|e| e.into_inner()) = message;
                lines.done.load(Ordering::Relaxed)
            }
            Self::Silent => return,
        };
        self.set_total(progress.total);
        self.inc(progress.done.saturating_sub(done));
    }

    /// Ends the display: the bar goes away, a log gets its last line.
    pub fn finish(&self) {
        match self {
            Self::Bar(bar) => bar.finish_and_clear(),
            // Of work that was there already nothing is told.
            Self::Lines(lines) if lines.total.load(Ordering::Relaxed) == 0 => {}
            Self::Lines(lines) => line(&lines.describe(lines.started.elapsed())),
            Self::Silent => {}
        }
    }
}

/// A bar left behind by an error goes away too.
impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

/// Puts a bar on the terminal.
fn bar(message: String, total: u64) -> ProgressBar {
    let style = ProgressStyle::with_template(TEMPLATE);
    let bar = BARS.add(ProgressBar::new(total));
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_message(message);
    bar.enable_steady_tick(TICK);
    bar
}

/// Counts behind plain lines.
#[derive(Debug)]
pub struct ProgressLines {
    started: Instant,
    /// When the next line is due, in milliseconds after the start.
    next: AtomicU64,
    done: AtomicU64,
    total: AtomicU64,
    message: Mutex<String>,
    /// What was done when lines of the latter half of the time were written: the hardest work often comes last, and what
    /// is taken over from before takes no time at all.
    recent: Mutex<VecDeque<(Duration, u64)>>,
}

impl ProgressLines {
    fn new(message: String, total: u64) -> Self {
        Self {
            started: Instant::now(),
            next: AtomicU64::new(BETWEEN_LINES.as_millis() as u64),
            done: AtomicU64::new(0),
            total: AtomicU64::new(total),
            message: Mutex::new(message),
            recent: Mutex::default(),
        }
    }

    /// Returns the line to print at `elapsed`, if one is due; only one thread gets it.
    fn due(&self, elapsed: Duration) -> Option<String> {
        let now = elapsed.as_millis() as u64;
        let next = self.next.load(Ordering::Relaxed);
        if now < next {
            return None;
        }
        let after = now + BETWEEN_LINES.as_millis() as u64;
        let won = self
            .next
            .compare_exchange(next, after, Ordering::Relaxed, Ordering::Relaxed);
        won.ok().map(|_| self.describe(elapsed))
    }

    /// Writes a line about the work after `elapsed`.
    fn describe(&self, elapsed: Duration) -> String {
        let done = self.done.load(Ordering::Relaxed);
        let total = self.total.load(Ordering::Relaxed);
        let rate = done as f64 / elapsed.as_secs_f64().max(1e-3);
        let message = self.message.lock().unwrap_or_else(|e| e.into_inner());
        let mut line = format!("{message}: {done}/{total}, {} a second", significant(rate));
        if done >= total {
            line += &format!(", took {}", duration(elapsed.as_secs_f64()));
        } else if let Some(left) = self.left(elapsed, [done, total]) {
            line += &format!(", {} left", duration(left));
        }
        line
    }

    /// Estimates the seconds left from the rate of the latter half of the time; `None` if nothing was done in it.
    fn left(&self, elapsed: Duration, [done, total]: [u64; 2]) -> Option<f64> {
        let mut recent = self.recent.lock().unwrap_or_else(|e| e.into_inner());
        while recent.len() > 1 && recent[1].0 <= elapsed / 2 {
            recent.pop_front();
        }
        let half = recent.front().filter(|(at, _)| *at <= elapsed / 2);
        let (from, before) = half.copied().unwrap_or_default();
        recent.push_back((elapsed, done));
        let rate = done.checked_sub(before)? as f64 / (elapsed - from).as_secs_f64().max(1e-3);
        (rate > 0.0).then(|| (total - done) as f64 / rate)
    }
}

/// Writes a number with three significant digits, without an exponent.
fn significant(x: f64) -> String {
    let decimals = (2 - x.max(1e-6).log10().floor() as i32).clamp(0, 6) as usize;
    format!("{x:.decimals$}")
}

/// Writes seconds as people say them.
fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

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

/// Lets a write that makes a file longer than the system allows fail, where the signal for that would end the process.
#[cfg(unix)]
pub fn survive_long_files() {
    // Without the handler the process ends as it would anyway.
    let _ = flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
}

/// Nothing of that kind is sent here.
#[cfg(not(unix))]
pub fn survive_long_files() {}

/// Returns SIGHUP, which a closed terminal sends, unless whoever started the process has it ignored, as `nohup` does; only
/// Linux tells.
#[cfg(target_os = "linux")]
fn hang_up() -> Option<i32> {
    let signal = signal_hook::consts::SIGHUP;
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let ignored = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))?;
    let ignored = u64::from_str_radix(ignored.trim(), 16).ok()?;
    (ignored >> (signal - 1) & 1 == 0).then_some(signal)
}

/// Nothing is known of it here.
#[cfg(not(target_os = "linux"))]
fn hang_up() -> Option<i32> {
    None
}

/// Notes the first SIGINT, SIGTERM or SIGHUP from now on, and lets a second one end the process.
fn note_signals() -> Result<Arc<AtomicBool>> {
    let signalled = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM].into_iter().chain(hang_up()) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_every_five_seconds_and_once() {
        let lines = ProgressLines::new("baking".into(), 400);
        lines.done.store(100, Ordering::Relaxed);
        assert_eq!(lines.due(Duration::from_secs(4)), None);
        assert_eq!(
            lines.due(Duration::from_secs(5)).unwrap(),
            "baking: 100/400, 20.0 a second, 15 s left"
        );
        assert_eq!(lines.due(Duration::from_secs(6)), None);
        assert!(lines.due(Duration::from_secs(10)).is_some());
    }

    #[test]
    fn the_last_line_says_how_long_it_took() {
        let lines = ProgressLines::new("baking".into(), 7);
        lines.done.store(7, Ordering::Relaxed);
        assert_eq!(
            lines.describe(Duration::from_secs(7000)),
            "baking: 7/7, 0.00100 a second, took 1 h 56 min"
        );
    }

    #[test]
    fn counting_is_possible_from_many_threads() {
        let progress = ProgressDisplay::Lines(ProgressLines::new("work".into(), 4000));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..1000).for_each(|_| progress.inc(1)));
            }
        });
        let ProgressDisplay::Lines(lines) = &progress else {
            unreachable!()
        };
        assert_eq!(lines.done.load(Ordering::Relaxed), 4000);
    }

    #[cfg(unix)]
    const VARIABLE: &str = "GEOFAN_TEST_SIGNALS";

    /// Signals concern the whole process, so this test runs itself again in a process of its own.
    #[test]
    #[cfg(unix)]
    fn the_first_signal_is_noted_and_the_second_quits() {
        use signal_hook::low_level::raise;
        use std::process::{Command, Stdio};

        if std::env::var_os(VARIABLE).is_some() {
            let signalled = note_signals().unwrap();
            assert!(!signalled.load(Ordering::Relaxed));
            // That of a closed terminal, unless the tests run without regard to it.
            raise(hang_up().unwrap_or(SIGTERM)).unwrap();
            assert!(signalled.load(Ordering::Relaxed));
            raise(SIGINT).unwrap();
            unreachable!("the second signal quits");
        }
        let name = "terminal::log::tests::the_first_signal_is_noted_and_the_second_quits";
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
