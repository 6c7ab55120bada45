//! Shared by all commands: common options, logs, progress, results, exit codes.
//!
//! In: the command line and the result of a command. Out: text on stdout (results, JSON) and stderr
//! (logs, progress, errors), and the exit code of a run.

mod log;
pub mod values;

pub use log::{ProgressDisplay, TerminalObserver, colour, line};

use clap::error::ErrorKind;
use geofan_core::error::{Error, Result};
use serde::Serialize;
use serde_json::{Value, json};
use std::{
    borrow::Cow,
    ffi::OsString,
    io::{self, Write},
    path::Path,
    process::ExitCode,
};

/// Options of every command.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Number of threads; 0 takes all cores
    #[arg(long, global = true, value_name = "N", default_value_t = 0,
          value_parser = clap::value_parser!(u16).range(..=4096), hide_default_value = true)]
    pub threads: u16,
    /// Print no progress, no warnings and no summary of what was written: errors and asked-for results only
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print results as JSON on stdout
    #[arg(long, global = true)]
    pub json: bool,
}

/// Says how a command that did not fail has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It did what was asked.
    Done,
    /// It ran, and its own check says no.
    CheckFailed,
}

/// Lets options take what looks like another option: that a number may not be negative is told better than that it is none.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let lenient = |arg: clap::Arg| {
        let takes_value = arg.get_long().is_some() && arg.get_action().takes_values();
        arg.allow_negative_numbers(takes_value)
    };
    command
        .mut_args(lenient)
        .mut_subcommands(with_negative_numbers)
}

/// Reads a command line. A wrong one ends the process with code 2 (help and version with 0);
/// with `--json` on it, the complaint goes to stdout as JSON too.
pub fn parse<C: clap::Parser>(arguments: impl IntoIterator<Item = OsString>) -> C {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let json = arguments.iter().any(|a| a == "--json");
    let matched = with_negative_numbers(C::command()).try_get_matches_from(arguments);
    let parsed = matched.and_then(|matches| C::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| {
        if error.use_stderr() && json {
            let text = error.render().to_string();
            let paragraph = text.split("\n\n").next().unwrap_or_default();
            let message = match error.kind() {
                ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                    "arguments are missing; --help lists them"
                }
                _ => paragraph.trim().trim_start_matches("error: "),
            };
            let _ = print_json(&json!({ "error": { "message": message } }));
        }
        error.exit()
    })
}

/// Sets up logs and threads, runs `main`, and reports its error: on stderr with the source
/// underlined, with `--json` on stdout as well. Panics go through.
pub fn run(common: &CommonArgs, main: impl FnOnce() -> Result<Outcome>) -> ExitCode {
    log::start(common.quiet);
    log::survive_long_files();
    match start_threads(common.threads).and_then(|()| main()) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        // Whoever read the output has had enough (`geofan … | head`): nothing is wrong.
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            log::line(&error.report(colour()));
            if common.json {
                let _ = print_json(&json!({ "error": describe(&error) }));
            }
            ExitCode::from(error.exit_code())
        }
    }
}

/// Makes as many threads as the command line asks for.
fn start_threads(threads: u16) -> Result<()> {
    if threads == 0 {
        return Ok(());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads));
    pool.build_global().map_err(|e| Error::Environment {
        path: format!("{threads} threads"),
        source: io::Error::other(e),
    })
}

/// Name of stdout in errors.
const STDOUT: &str = "standard output";

/// Tells whether an error is stdout closed by its reader.
fn is_closed_pipe(error: &Error) -> bool {
    matches!(error, Error::Environment { path, source }
        if path == STDOUT && source.kind() == io::ErrorKind::BrokenPipe)
}

/// Writes `text` to stdout and flushes. Commands print by this and not by `println!`, which panics
/// on a closed pipe.
///
/// # Errors
/// stdout cannot be written; [`run`] takes a closed pipe for a quiet end.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(visible(text).as_bytes());
    written
        .and_then(|()| stdout.flush())
        .map_err(|source| Error::Environment {
            path: STDOUT.into(),
            source,
        })
}

/// Puts a mark in place of what a terminal obeys: names from files are a stranger's.
fn visible(text: &str) -> Cow<'_, str> {
    let is_obeyed = |c: char| c.is_control() && !['\n', '\t'].contains(&c);
    match text.contains(is_obeyed) {
        true => text.replace(is_obeyed, "\u{fffd}").into(),
        false => text.into(),
    }
}

/// Writes `value` to stdout as one line of JSON.
///
/// # Errors
/// As [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_string(value).map_err(|e| Error::Environment {
        path: STDOUT.into(),
        source: e.into(),
    })?;
    text.push('\n');
    print(&text)
}

/// Describes the error as JSON: `message`, and `file`, `option` or `subject`, `line`, `column`, `hint` where known.
fn describe(error: &Error) -> Value {
    match error {
        Error::Source(diagnostic) => {
            let (line, column) = diagnostic.source.line_column(diagnostic.span.start);
            let mut value = json!({
                "file": diagnostic.source.name,
                "line": line,
                "column": column,
                "message": diagnostic.message,
            });
            if let Some(hint) = &diagnostic.hint {
                value["hint"] = json!(hint);
            }
            value
        }
        Error::Input { subject, message } => {
            // Other subjects are things such as a camera or a ray.
            let is_file = || subject.contains(['.', '/']) || Path::new(subject).exists();
            let kind = match subject {
                option if option.starts_with('-') => "option",
                _ if is_file() => "file",
                _ => "subject",
            };
            json!({ kind: subject, "message": message })
        }
        Error::Environment { path, source } => {
            json!({ "file": path, "message": source.to_string() })
        }
        Error::Interrupted { .. } => json!({ "message": error.to_string() }),
    }
}

/// Writes the command line of this process as a shell takes it back.
pub fn command_line() -> String {
    words()
        .iter()
        .map(|word| quoted(word))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Tells whether `option` stands on the command line of this process.
pub fn has_option(option: &str) -> bool {
    words().iter().any(|word| word == option)
}

/// Lists the arguments; those that are not UTF-8 with replacement characters.
fn words() -> Vec<String> {
    std::env::args_os()
        .map(|word| word.to_string_lossy().into_owned())
        .collect()
}

/// Quotes a word as a shell takes it back.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,+:@%".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::diagnostic::{Diagnostic, SourceText};

    fn common() -> CommonArgs {
        CommonArgs {
            quiet: true,
            ..CommonArgs::default()
        }
    }

    #[test]
    fn names_from_files_give_the_terminal_no_orders() {
        assert_eq!(
            visible("\u{1b}[31mred\u{7}\tspace\n"),
            "\u{fffd}[31mred\u{fffd}\tspace\n"
        );
        assert!(matches!(visible("a plain line\n"), Cow::Borrowed(_)));
    }

    /// `ExitCode` cannot be compared.
    fn code(result: Result<Outcome>) -> String {
        format!("{:?}", run(&common(), || result))
    }

    #[test]
    fn exit_codes_are_those_of_the_design() {
        let is = |code: u8| format!("{:?}", ExitCode::from(code));
        assert_eq!(code(Ok(Outcome::Done)), is(0));
        assert_eq!(code(Ok(Outcome::CheckFailed)), is(1));
        assert_eq!(code(Err(Error::input("--at", "test"))), is(2));
        let environment = |path: &str, kind: io::ErrorKind| Error::Environment {
            path: path.into(),
            source: kind.into(),
        };
        let full = environment("disk", io::ErrorKind::StorageFull);
        assert_eq!(code(Err(full)), is(3));
        let closed = environment(STDOUT, io::ErrorKind::BrokenPipe);
        assert_eq!(code(Err(closed)), is(0));
        let resume = "--resume goes on".into();
        assert_eq!(code(Err(Error::Interrupted { resume })), is(75));
    }

    #[test]
    fn errors_become_json_with_their_place() {
        let source = SourceText::new("a.toml", "x = 1\ny = oops");
        let diagnostic = Diagnostic::new(&source, 10..14, "wrong").with_hint("mend it");
        assert_eq!(
            describe(&diagnostic.into()),
            json!({"file": "a.toml", "line": 2, "column": 5, "message": "wrong", "hint": "mend it"})
        );
        assert_eq!(
            describe(&Error::input("--set", "no")),
            json!({"option": "--set", "message": "no"})
        );
        assert_eq!(
            describe(&Error::input("the camera", "no")),
            json!({"subject": "the camera", "message": "no"})
        );
        assert_eq!(
            describe(&Error::input("a.fan", "no")),
            json!({"file": "a.fan", "message": "no"})
        );
    }

    #[test]
    #[should_panic(expected = "not swallowed")]
    fn panics_go_through() {
        run(&common(), || panic!("not swallowed"));
    }

    #[test]
    fn words_are_quoted_for_the_shell() {
        assert_eq!(quoted("a/b.toml"), "a/b.toml");
        assert_eq!(quoted("my file"), "'my file'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}
