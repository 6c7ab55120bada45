//! Rays about to be followed: a block of them, with the rates at their starts computed at once.
//!
//! In: an iterator of [`Ray`]s. Out: [`LaneStart`]s, one for each lane that becomes free, and the rows
//! of their states.

use super::{
    LANES, NIL, Ray, Row, Settings,
    events::Events,
    state::{Rest, StateLayout, rates_at},
};
use crate::manifold::{Manifold, around};
use geofan_expr::{Registers, Tape, Wide, real::Real};
use glam::DVec3;

/// A ray at its start.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneStart {
    /// Its number among all rays.
    pub ray: usize,
    /// Its column in the block's rows.
    pub column: usize,
    /// Arc length to follow it to.
    pub length: f64,
    /// The first step to try; `None` where the metric allows none.
    pub step: Option<f64>,
}

/// The block of rays that are next.
pub(super) struct Starts<'m> {
    layout: StateLayout,
    flow: &'m Tape,
    rest: Rest,
    pulled_back: bool,
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
    pub fn new(manifold: &'m Manifold, settings: Settings) -> Self {
        let layout = StateLayout::of(settings);
        let flow = manifold.flow(settings.carried);
        Self {
            layout,
            flow,
            rest: Rest::of(manifold, flow),
            pulled_back: manifold.is_pulled_back(),
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
    ) -> Option<LaneStart> {
        if self.taken == self.rays.len() {
            self.refill(rays, events);
        }
        let (number, ray) = self.rays.get(self.taken)?;
        self.taken += 1;
        let column = self.taken - 1;
        Some(LaneStart {
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
        if self.pulled_back {
            self.mend();
        }
        if self.rest.has_wind() {
            self.flow.run_rest(&mut self.registers);
        }
        if let Some(events) = events {
            events.values(&self.y[..6], &mut self.events);
        }
    }

    /// Gives rays that start on the axis of textbook coordinates the rates that those around it tend to.
    fn mend(&mut self) {
        for column in 0..self.rays.len() {
            if self.rates.iter().all(|row| row[column].is_finite()) {
                continue;
            }
            let mut y: Vec<Wide<f64, 1>> = self.y.iter().map(|row| Wide([row[column]])).collect();
            let mut registers = self.flow.registers();
            let mended = around(self.rays[column].1.u, |u| {
                let mut rates = vec![Wide([0.0]); y.len()];
                for k in 0..3 {
                    y[k][0] = u[k];
                }
                rates_at(self.flow, &mut registers, self.layout, &y, &mut rates);
                rates.iter().map(|rate| rate[0]).collect()
            });
            for (row, rate) in self.rates.iter_mut().zip(mended) {
                row[column] = rate;
            }
        }
    }

    fn first_step(&self, column: usize, ray: &Ray) -> Option<f64> {
        let acceleration = DVec3::from_array([3, 4, 5].map(|row| self.rates[row][column]));
        if !acceleration.is_finite() || !ray.v.is_finite() {
            return None;
        }
        // Curvature of the chart line against the chart's unit; the controller corrects the guess.
        let speed = match self.rest.wind(&self.registers) {
            None => ray.v.length(),
            Some(wind) => (ray.v - DVec3::from_array(wind.map(|w| w[column]))).length(),
        };
        let bend = acceleration.length() / speed.max(f64::MIN_POSITIVE);
        Some(self.reach / bend.max(1.0 / ray.length))
    }
}
