//! How long work takes: by the clock, and of processors.
//!
//! In: the beginning of some work. Out: the [`Spent`] time. Processor time of all threads together
//! does not count what other programs on the same machine take away, so figures from a busy machine
//! can be compared.

use cpu_time::ProcessTime;
use serde::{Deserialize, Serialize};
use std::{ops::Add, time::Instant};

/// Time that work took, seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    /// By the clock on the wall.
    pub wall_s: f64,
    /// Of processors, all threads together.
    pub cpu_s: f64,
}

impl Add for Spent {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            wall_s: self.wall_s + other.wall_s,
            cpu_s: self.cpu_s + other.cpu_s,
        }
    }
}

/// The beginning of some work.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    wall: Instant,
    cpu: ProcessTime,
}

impl Clock {
    /// Work begins now.
    pub fn start() -> Self {
        Self {
            wall: Instant::now(),
            cpu: ProcessTime::now(),
        }
    }

    /// What it has taken so far.
    pub fn spent(&self) -> Spent {
        Spent {
            wall_s: self.wall.elapsed().as_secs_f64(),
            cpu_s: self.cpu.elapsed().as_secs_f64(),
        }
    }
}
