//! How far long work is: a bar on a terminal, a plain line every few seconds in a log.
//!
//! In: counts from any thread. Out: text on stderr, none when quiet.

use super::{CommonArgs, log};
use indicatif::{ProgressBar, ProgressStyle};
use std::{
    io::IsTerminal,
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// Time between two plain lines: a log of an hour stays below a thousand lines.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Time between two drawings of the bar while nothing is counted, so that its clock runs.
const TICK: Duration = Duration::from_millis(250);

const TEMPLATE: &str = "{msg} {wide_bar} {human_pos}/{human_len} {per_sec} {eta} left";

/// The progress of one piece of long work.
#[derive(Debug)]
pub struct ProgressDisplay(Display);

#[derive(Debug)]
enum Display {
    Bar(ProgressBar),
    Lines(Lines),
    Silent,
}

impl ProgressDisplay {
    /// Begins work of `total` pieces, called `message`.
    pub fn new(common: &CommonArgs, message: impl Into<String>, total: u64) -> Self {
        let message = message.into();
        Self(if common.quiet {
            Display::Silent
        } else if std::io::stderr().is_terminal() {
            Display::Bar(bar(message, total))
        } else {
            Display::Lines(Lines::new(message, total))
        })
    }

    /// `count` more pieces are done.
    pub fn inc(&self, count: u64) {
        match &self.0 {
            Display::Bar(bar) => bar.inc(count),
            Display::Lines(lines) => {
                lines.done.fetch_add(count, Ordering::Relaxed);
                if let Some(line) = lines.due(lines.started.elapsed()) {
                    log::line(&line);
                }
            }
            Display::Silent => {}
        }
    }

    /// The work has turned out to have `total` pieces.
    pub fn set_total(&self, total: u64) {
        match &self.0 {
            Display::Bar(bar) => bar.set_length(total),
            Display::Lines(lines) => lines.total.store(total, Ordering::Relaxed),
            Display::Silent => {}
        }
    }

    /// What is being done now.
    pub fn set_message(&self, message: impl Into<String>) {
        match &self.0 {
            Display::Bar(bar) => bar.set_message(message.into()),
            Display::Lines(lines) => {
                *lines.message.lock().unwrap_or_else(|e| e.into_inner()) = message.into();
            }
            Display::Silent => {}
        }
    }

    /// The work is over: the bar goes away, a log gets its last line.
    pub fn finish(&self) {
        match &self.0 {
            Display::Bar(bar) => bar.finish_and_clear(),
            Display::Lines(lines) => log::line(&lines.line(lines.started.elapsed())),
            Display::Silent => {}
        }
    }
}

/// A bar left behind by an error goes away too.
impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        if let Display::Bar(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

fn bar(message: String, total: u64) -> ProgressBar {
    let style = ProgressStyle::with_template(TEMPLATE);
    let bar = log::bars().add(ProgressBar::new(total));
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_message(message);
    bar.enable_steady_tick(TICK);
    bar
}

/// The state behind plain lines.
#[derive(Debug)]
struct Lines {
    started: Instant,
    /// When the next line is due, in milliseconds after the start.
    next: AtomicU64,
    done: AtomicU64,
    total: AtomicU64,
    message: Mutex<String>,
}

impl Lines {
    fn new(message: String, total: u64) -> Self {
        Self {
            started: Instant::now(),
            next: AtomicU64::new(BETWEEN_LINES.as_millis() as u64),
            done: AtomicU64::new(0),
            total: AtomicU64::new(total),
            message: Mutex::new(message),
        }
    }

    /// The line to print at `elapsed`, if one is due; only one thread gets it.
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
        won.ok().map(|_| self.line(elapsed))
    }

    fn line(&self, elapsed: Duration) -> String {
        let done = self.done.load(Ordering::Relaxed);
        let total = self.total.load(Ordering::Relaxed);
        let rate = done as f64 / elapsed.as_secs_f64().max(1e-3);
        let message = self.message.lock().unwrap_or_else(|e| e.into_inner());
        let mut line = format!("{message}: {done}/{total}, {} a second", significant(rate));
        if done >= total {
            line += &format!(", took {}", duration(elapsed.as_secs_f64()));
        } else if done > 0 {
            line += &format!(", {} left", duration((total - done) as f64 / rate));
        }
        line
    }
}

/// Three significant digits, without an exponent.
fn significant(x: f64) -> String {
    let decimals = (2 - x.max(1e-6).log10().floor() as i32).clamp(0, 6) as usize;
    format!("{x:.decimals$}")
}

/// Seconds as people say them.
fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_every_five_seconds_and_once() {
        let lines = Lines::new("baking".into(), 400);
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
        let lines = Lines::new("baking".into(), 7);
        lines.done.store(7, Ordering::Relaxed);
        assert_eq!(
            lines.line(Duration::from_secs(7000)),
            "baking: 7/7, 0.00100 a second, took 1 h 56 min"
        );
    }

    #[test]
    fn counting_is_possible_from_many_threads() {
        let progress = ProgressDisplay(Display::Lines(Lines::new("work".into(), 4000)));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..1000).for_each(|_| progress.inc(1)));
            }
        });
        let Display::Lines(lines) = &progress.0 else {
            unreachable!()
        };
        assert_eq!(lines.done.load(Ordering::Relaxed), 4000);
    }
}
