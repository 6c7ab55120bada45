//! Work without the GIL, the threads that it runs on, and errors of the libraries as Python exceptions.
//!
//! In: a closure over plain Rust values. Out: its result, or the exception of its error: one of `geofan._errors`, which
//! carries the file, line, column and hint where there are any. Work runs in a pool while the calling thread looks for
//! signals and hands progress to Python a few times a second, so that all Python code runs in the thread that called.
//!
//! A thread of the pool that waits for its own pieces of work takes up those of another call meanwhile. Work must
//! therefore not wait for a lock that other work holds: the calling thread takes it before ([`lock`]).
//!
//! Threads are as many as there are processors, or as a `with geofan.threads(n)` says. They do not survive a fork, so
//! that a pool is used by the process that made it alone: a worker of `multiprocessing`, Dask or Ray makes its own on
//! its first call.

use geofan_core::{Error, Observer, Progress, Result, diagnostic::Diagnostic};
use pyo3::{
    exceptions::{PyKeyboardInterrupt, PyOSError},
    prelude::*,
    types::PyDict,
};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::{
    any::Any,
    cell::RefCell,
    collections::BTreeMap,
    io::{self, ErrorKind},
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, TryLockError,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, channel},
    },
    time::Duration,
};

/// Time between two looks at signals and progress.
const GLANCE: Duration = Duration::from_millis(40);

/// Time between two looks at a lock that another thread holds.
const TURN: Duration = Duration::from_millis(5);

/// Runs work that tells no progress.
pub fn run<T: Send>(
    py: Python<'_>,
    about: About,
    work: impl FnOnce(&dyn Observer) -> Result<T> + Send,
) -> PyResult<T> {
    watch(py, about, None, work)
}

/// Takes a lock for the calling thread, which handles signals while it waits.
pub fn lock<'m, T>(py: Python<'_>, mutex: &'m Mutex<T>) -> PyResult<MutexGuard<'m, T>> {
    loop {
        match mutex.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => py.detach(|| std::thread::sleep(TURN)),
        }
        py.check_signals()?;
    }
}

/// Runs work; `progress` is called with the name of the work, units done, units in all and further figures.
pub fn watch<T: Send>(
    py: Python<'_>,
    about: About,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Observer) -> Result<T> + Send,
) -> PyResult<T> {
    let pool = pool(py)?;
    watch_in(py, about, progress, &pool, work)
}

/// Runs work on the threads of `pool`.
pub fn watch_in<T: Send>(
    py: Python<'_>,
    about: About,
    progress: Option<&Py<PyAny>>,
    pool: &ThreadPool,
    work: impl FnOnce(&dyn Observer) -> Result<T> + Send,
) -> PyResult<T> {
    let watcher = Watcher::default();
    let (result, raised) = py.detach(|| {
        pool.in_place_scope(|scope| {
            let (send, ended) = channel();
            let watcher = &watcher;
            scope.spawn(move |_| {
                let result = catch_unwind(AssertUnwindSafe(|| work(watcher)));
                // The receiver waits until this has been sent.
                let _ = send.send(result);
            });
            let mut raised = None;
            loop {
                match ended.recv_timeout(GLANCE) {
                    Ok(result) => break (result, raised),
                    Err(RecvTimeoutError::Disconnected) => {
                        break (Err(Box::new("the work's thread ended") as Panic), raised);
                    }
                    Err(RecvTimeoutError::Timeout) if raised.is_none() => {
                        raised = Python::attach(|py| watcher.glance(py, progress)).err();
                        watcher.cancelled.store(raised.is_some(), Ordering::Relaxed);
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                }
            }
        })
    });
    match (raised, result) {
        (Some(raised), Ok(Err(Error::Interrupted { resume }))) => {
            Err(noted(py, raised, &keywords(&resume)))
        }
        (Some(raised), _) => Err(raised),
        (None, result) => {
            watcher.tell(py, progress)?;
            finish(py, about, result)
        }
    }
}

/// Ends work that has been cancelled.
pub fn go_on(observer: &dyn Observer) -> Result<()> {
    match observer.cancelled() {
        true => Err(interrupted()),
        false => Ok(()),
    }
}

/// Returns the error of work that was cancelled and of which nothing is kept.
pub fn interrupted() -> Error {
    Error::Interrupted {
        resume: "nothing is kept".into(),
    }
}

/// What the unwinding of [`give_up`] carries.
struct GivenUp;

/// Ends work that has been cancelled from inside a function that a library calls and that cannot fail: by unwinding.
/// [`watch`] ends with what cancelled it.
pub fn give_up(observer: &dyn Observer) {
    if observer.cancelled() {
        resume_unwind(Box::new(GivenUp));
    }
}

/// The payload of a panic.
type Panic = Box<dyn Any + Send>;

/// Turns how work ended into its value or an exception.
fn finish<T>(py: Python<'_>, about: About, ended: Result<Result<T>, Panic>) -> PyResult<T> {
    match ended {
        Ok(result) => result.map_err(|error| about.raise(py, error)),
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| text.to_string());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
            let text = text.unwrap_or_default();
            Err(refuse(
                py,
                "",
                format!("a fault in geofan, please report it: {text}"),
            ))
        }
    }
}

/// Adds to an exception how interrupted work can go on.
fn noted(py: Python<'_>, raised: PyErr, resume: &str) -> PyErr {
    // Python 3.10 has no notes.
    let _ = raised.value(py).call_method1("add_note", (resume,));
    raised
}

/// Takes note of progress for the thread that called.
#[derive(Default)]
struct Watcher {
    cancelled: AtomicBool,
    /// By the name of the work: done, in all, further figures. What Python has been told is taken out.
    news: Mutex<BTreeMap<String, (u64, u64, String)>>,
}

impl Observer for Watcher {
    fn progress(&self, progress: Progress<'_>) {
        let Progress {
            work,
            done,
            total,
            detail,
        } = progress;
        let mut news = self.news.lock().unwrap_or_else(PoisonError::into_inner);
        news.insert(work.into(), (done, total, detail.into()));
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

impl Watcher {
    /// Lets Python handle signals and take note of progress.
    fn glance(&self, py: Python<'_>, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        py.check_signals()?;
        self.tell(py, progress)
    }

    /// Tells Python what is new.
    fn tell(&self, py: Python<'_>, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        let news = std::mem::take(&mut *self.news.lock().unwrap_or_else(PoisonError::into_inner));
        let Some(progress) = progress else {
            return Ok(());
        };
        for (work, (done, total, detail)) in news {
            progress.call1(py, (work, done, total, detail))?;
        }
        Ok(())
    }
}

/// The most threads of a pool.
const MOST: usize = 4096;

/// A pool with the process that made it.
#[derive(Clone)]
struct OwnedPool {
    process: u32,
    /// Threads asked for; 0 for as many as there are processors.
    asked: usize,
    pool: Arc<ThreadPool>,
}

static USUAL: Mutex<Option<OwnedPool>> = Mutex::new(None);

thread_local! {
    /// Pools of the `with` blocks that are open in this thread.
    static CHOSEN: RefCell<Vec<OwnedPool>> = const { RefCell::new(Vec::new()) };
}

impl OwnedPool {
    fn new(py: Python<'_>, asked: usize) -> PyResult<Self> {
        let built = ThreadPoolBuilder::new()
            .num_threads(asked)
            .thread_name(|i| format!("geofan-{i}"))
            .build();
        let pool = built.map_err(|e| refuse(py, "threads", e.to_string()))?;
        Ok(Self {
            process: std::process::id(),
            asked,
            pool: Arc::new(pool),
        })
    }

    /// Replaces a pool of the process that this one was forked from.
    fn revive(&mut self, py: Python<'_>) -> PyResult<()> {
        if self.process == std::process::id() {
            return Ok(());
        }
        let dead = std::mem::replace(self, Self::new(py, self.asked)?);
        // Its threads are not here to be told that they may end.
        std::mem::forget(dead);
        Ok(())
    }
}

/// Returns the pool for a call from this thread.
pub fn pool(py: Python<'_>) -> PyResult<Arc<ThreadPool>> {
    let chosen = CHOSEN.with_borrow_mut(|chosen| match chosen.last_mut() {
        Some(owned) => owned.revive(py).map(|()| Some(owned.pool.clone())),
        None => Ok(None),
    })?;
    if let Some(pool) = chosen {
        return Ok(pool);
    }
    let mut usual = USUAL.lock().unwrap_or_else(PoisonError::into_inner);
    match usual.as_mut() {
        Some(owned) => owned.revive(py)?,
        None => *usual = Some(OwnedPool::new(py, 0)?),
    }
    let owned = usual.as_ref().expect("made above");
    Ok(owned.pool.clone())
}

/// Makes as many threads as calls from this thread run on, for one piece of work.
pub fn fresh(py: Python<'_>) -> PyResult<Arc<ThreadPool>> {
    let count = pool(py)?.current_num_threads();
    Ok(OwnedPool::new(py, count)?.pool)
}

/// Lets calls from this thread run on `count` threads.
#[pyfunction]
pub fn push_threads(py: Python<'_>, count: usize) -> PyResult<()> {
    if !(1..=MOST).contains(&count) {
        return Err(refuse(
            py,
            "threads",
            format!("{count} is not between 1 and {MOST}"),
        ));
    }
    let owned = OwnedPool::new(py, count)?;
    CHOSEN.with_borrow_mut(|chosen| chosen.push(owned));
    Ok(())
}

/// Ends what the last `push_threads` of this thread began.
#[pyfunction]
pub fn pop_threads() {
    CHOSEN.with_borrow_mut(|chosen| {
        if let Some(owned) = chosen.pop()
            && owned.process != std::process::id()
        {
            std::mem::forget(owned);
        }
    });
}

/// Counts the threads that calls from this thread run on.
#[pyfunction]
pub fn thread_count(py: Python<'_>) -> PyResult<usize> {
    Ok(pool(py)?.current_num_threads())
}

/// Names the exception that bad input raises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// `ManifoldError`
    Manifold,
    /// `SceneError`
    Scene,
    /// `InputError`
    Input,
}

impl About {
    /// Names the class.
    fn class(self) -> &'static str {
        match self {
            Self::Manifold => "ManifoldError",
            Self::Scene => "SceneError",
            Self::Input => "InputError",
        }
    }

    /// Makes the exception of an error.
    pub fn raise(self, py: Python<'_>, error: Error) -> PyErr {
        let made = match &error {
            Error::Source(diagnostic) => self.at_place(py, diagnostic, &error),
            Error::Input { subject, message } => self.about(py, subject, message, None),
            Error::Environment { path, source } => {
                let number = error_number(source);
                return PyOSError::new_err((number, source.to_string(), path.clone()));
            }
            Error::Interrupted { resume } => {
                let resume = keywords(resume);
                return PyKeyboardInterrupt::new_err(format!("interrupted; {resume}"));
            }
        };
        made.unwrap_or_else(|failure| failure)
    }

    /// Makes the exception of a mistake in a text.
    fn at_place(self, py: Python<'_>, found: &Diagnostic, error: &Error) -> PyResult<PyErr> {
        let (line, column) = found.source.line_column(found.span.start);
        let details = PyDict::new(py);
        details.set_item("subject", &found.source.name)?;
        details.set_item("file", &found.source.name)?;
        details.set_item("line", line)?;
        details.set_item("column", column)?;
        details.set_item("hint", found.hint.as_deref().map(keywords))?;
        details.set_item("report", error.report(false))?;
        self.make(py, keywords(&found.message), &details)
    }

    /// Makes the exception of an input that is no text.
    fn about(
        self,
        py: Python<'_>,
        subject: &str,
        message: &str,
        hint: Option<&str>,
    ) -> PyResult<PyErr> {
        // Other subjects are paths and arguments, with hyphens of their own.
        let subject = match subject.starts_with("--") {
            true => keywords(subject),
            false => subject.to_string(),
        };
        let details = PyDict::new(py);
        let message = &keywords(message);
        let message = match subject.is_empty() {
            true => message.to_string(),
            false => format!("{subject}: {message}"),
        };
        details.set_item("subject", subject)?;
        details.set_item("hint", hint.map(keywords))?;
        self.make(py, message, &details)
    }

    fn make(self, py: Python<'_>, message: String, details: &Bound<'_, PyDict>) -> PyResult<PyErr> {
        let class = py.import("geofan._errors")?.getattr(self.class())?;
        Ok(PyErr::from_value(class.call((message,), Some(details))?))
    }
}

/// Returns the system's number of an error: its own, or, of one that somebody wrapped, that of its kind.
fn error_number(error: &io::Error) -> i32 {
    error.raw_os_error().unwrap_or(match error.kind() {
        ErrorKind::NotFound => 2,
        ErrorKind::PermissionDenied => 13,
        ErrorKind::AlreadyExists => 17,
        ErrorKind::StorageFull => 28,
        _ => 0,
    })
}

/// Names the options of the command line that a message speaks of as the keywords that they are here.
fn keywords(message: &str) -> String {
    let mut pieces = message.split("--");
    let mut told = pieces.next().unwrap_or_default().to_string();
    for piece in pieces {
        let end = piece.find(|c: char| !c.is_ascii_lowercase() && c != '-');
        let (option, rest) = piece.split_at(end.unwrap_or(piece.len()));
        // Two signs inside of a formula are none.
        let begins = told.is_empty() || told.ends_with([' ', '`', '(']);
        let option = match option {
            "view" if begins => "camera".to_string(),
            "set" if begins => "parameters".to_string(),
            _ if begins && option.len() > 1 => option.replace('-', "_"),
            _ => format!("--{option}"),
        };
        told += &option;
        told += rest;
    }
    told
}

/// Makes an `InputError` about `subject`.
pub fn refuse(py: Python<'_>, subject: &str, message: impl Into<String>) -> PyErr {
    About::Input.raise(py, Error::input(subject, message))
}

/// Makes one that says what to do.
pub fn refuse_with_hint(py: Python<'_>, subject: &str, reason: String, advice: &str) -> PyErr {
    let message = format!("{reason}; {advice}");
    let made = About::Input.about(py, subject, &message, Some(advice));
    made.unwrap_or_else(|failure| failure)
}
