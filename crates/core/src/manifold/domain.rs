//! Where the chart ends: coordinate limits, glued coordinates, conditions and exits.
//!
//! In: limits and expressions. Out: [`Domain`], whose event tape turns (u, v) into numbers that
//! become positive where a ray must end.

use geofan_expr::Tape;
use glam::DVec3;

/// The kind of end that an event stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// An exit named in the file, by index.
    Exit(usize),
    /// A coordinate limit that is not glued.
    Limit,
    /// A condition of `inside` that no longer holds.
    Inside,
}

/// The domain of the chart.
#[derive(Debug, Clone)]
pub struct Domain {
    /// Lower and upper limit of each coordinate, where given.
    pub limits: [Option<[f64; 2]>; 3],
    /// Set where the limits of a coordinate are glued.
    pub periodic: [bool; 3],
    /// The meaning of each output of the event tape.
    pub kinds: Vec<EventKind>,
    pub(super) events: Tape,
}

impl Domain {
    /// Returns whether a ray can end anywhere, at a limit or an exit.
    pub fn ends_rays(&self) -> bool {
        !self.kinds.is_empty()
    }

    /// Whether the file names a way out, besides the limits of the chart.
    pub fn has_exits(&self) -> bool {
        let named = |kind: &EventKind| matches!(kind, EventKind::Exit(_));
        self.kinds.iter().any(named)
    }

    /// The tape (u, v) -> one number for each of [`Domain::kinds`]; a ray ends where one becomes
    /// positive.
    pub fn events(&self) -> &Tape {
        &self.events
    }

    /// The representative of `u` inside the limits of the glued coordinates.
    pub fn wrap(&self, u: DVec3) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| u[k] - self.shift(k, u[k])))
    }

    /// The multiple of the period that [`Domain::wrap`] takes off coordinate `k` at value `x`.
    pub fn shift(&self, k: usize, x: f64) -> f64 {
        match self.limits[k] {
            Some([low, high]) if self.periodic[k] => {
                let period = high - low;
                period * ((x - low) / period).floor()
            }
            _ => 0.0,
        }
    }

    /// The period of coordinate `k`, if its limits are glued.
    pub fn period(&self, k: usize) -> Option<f64> {
        self.limits[k]
            .filter(|_| self.periodic[k])
            .map(|[low, high]| high - low)
    }

    /// The exit beyond which `u` lies, if any, by its index, and the value of its formula there. One that
    /// depends on the tangent counts where it is positive whichever way a ray goes.
    pub fn exit_beyond(&self, u: DVec3) -> Option<(usize, f64)> {
        let at = |v: DVec3| self.events.at(&[u.x, u.y, u.z, v.x, v.y, v.z]);
        let values = at(DVec3::ZERO);
        let any_way = |k: usize| {
            let ways = DVec3::AXES.into_iter().flat_map(|v| [v, -v]);
            ways.into_iter().all(|v| at(v)[k] > 0.0)
        };
        let beyond = |(k, kind): (usize, &EventKind)| match kind {
            EventKind::Exit(exit) if values[k] > 0.0 && any_way(k) => Some((*exit, values[k])),
            _ => None,
        };
        self.kinds.iter().enumerate().find_map(beyond)
    }

    /// The first limit or condition (not exit) violated at `u`, if any.
    pub fn violation(&self, u: DVec3) -> Option<EventKind> {
        let values = self.events.at(&[u.x, u.y, u.z, 0.0, 0.0, 0.0]);
        let mut pairs = self.kinds.iter().zip(values);
        pairs
            .find(|(kind, value)| {
                // NaN counts as violated.
                !matches!(kind, EventKind::Exit(_)) && (*value > 0.0 || value.is_nan())
            })
            .map(|(kind, _)| *kind)
    }
}
