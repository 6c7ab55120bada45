//! Rays about to be followed: a block of them, with the rates at their starts computed at once.
//!
//! In: an iterator of [`Ray`]s. Out: [`Start`]s, one for each lane that becomes free, and the rows
//! of their states.

use super::{
    LANES, NIL, Ray, Row, Settings,
    events::Events,
    state::{Layout, rates_at},
};
use geofan_expr::{Registers, Tape, real::Real};
use glam::DVec3;

/// A ray at its start.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    /// Its number among all rays.
    pub ray: usize,
    /// Its column in the block's rows.
    pub column: usize,
    /// How far it is to be followed.
    pub length: f64,
    /// The first step to try; `None` where the metric allows none.
    pub step: Option<f64>,
}

/// The block of rays that are next.
pub(super) struct Starts<'m> {
    layout: Layout,
    flow: &'m Tape,
    registers: Registers<f64, LANES>,
    /// (number, ray) of those in the block, and how many have been handed out.
    rays: Vec<(usize, Ray)>,
    taken: usize,
    /// States, their rates, and the events' values.
    pub y: Vec<Row>,
    pub rates: Vec<Row>,
    pub events: Vec<Row>,
    /// Half the tolerance's fifth root: the share of the radius of curvature that a first step is.
    reach: f64,
}

impl<'m> Starts<'m> {
    pub fn new(flow: &'m Tape, settings: Settings) -> Self {
        let layout = Layout::of(settings);
        Self {
            layout,
            flow,
            registers: flow.registers(),
            rays: Vec::with_capacity(LANES),
            taken: 0,
            y: vec![NIL; layout.rows],
            rates: vec![NIL; layout.rows],
            events: Vec::new(),
            reach: 0.5 * Real::pow(settings.tolerance, 0.2),
        }
    }

    /// The next ray; `None` when `rays` has no more.
    pub fn next(
        &mut self,
        rays: &mut impl Iterator<Item = (usize, Ray)>,
        events: Option<&mut Events<'_>>,
    ) -> Option<Start> {
        if self.taken == self.rays.len() {
            self.refill(rays, events);
        }
        let (number, ray) = self.rays.get(self.taken)?;
        self.taken += 1;
        let column = self.taken - 1;
        Some(Start {
            ray: *number,
            column,
            length: ray.length,
            step: self.first_step(column, ray),
        })
    }

    fn refill(
        &mut self,
        rays: &mut impl Iterator<Item = (usize, Ray)>,
        events: Option<&mut Events<'_>>,
    ) {
        self.taken = 0;
        self.rays.clear();
        self.rays.extend(rays.take(LANES));
        for (column, (_, ray)) in self.rays.iter().enumerate() {
            for (row, value) in self.y.iter_mut().zip(self.layout.start(ray)) {
                row[column] = value;
            }
        }
        if self.rays.is_empty() {
            return;
        }
        rates_at(
            self.flow,
            &mut self.registers,
            self.layout,
            &self.y,
            &mut self.rates,
        );
        if let Some(events) = events {
            events.values(&self.y[..6], &mut self.events);
        }
    }

    fn first_step(&self, column: usize, ray: &Ray) -> Option<f64> {
        let acceleration = DVec3::from_array([3, 4, 5].map(|row| self.rates[row][column]));
        if !acceleration.is_finite() || !ray.v.is_finite() {
            return None;
        }
        // Curvature of the chart line against the chart's unit; the controller corrects the guess.
        let bend = acceleration.length() / ray.v.length().max(f64::MIN_POSITIVE);
        Some(self.reach / bend.max(1.0 / ray.length))
    }
}
