//! The threads that work runs on: as many as there are processors, or as a `with geofan.threads(n)` says.
//!
//! Threads do not survive a fork, so that a pool is used by the process that made it alone: a worker of
//! `multiprocessing`, Dask or Ray makes its own on its first call.

use crate::errors::refuse;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::{
    cell::RefCell,
    sync::{Arc, Mutex, PoisonError},
};

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
