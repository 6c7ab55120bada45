//! Many geodesics at once: adaptive Dormand–Prince over lanes of rays.
//!
//! In: rays (chart point, unit tangent, length). Out: their [`Step`]s in order and how each ended,
//! given to a [`Sink`]. Every lane has its own step size; a lane whose ray has ended takes the next
//! ray at once, so no lane idles while rays are left. A ray's result does not depend on the lanes
//! beside it, and nothing is allocated once the lanes are set up.

mod report;

use super::{
    End, LANES, NIL, Ray, Row, Settings, Sink,
    domain_events::Events,
    dormand_prince::{A, Control, ERROR, LOOK, STAGES},
    each,
    face_crossing::{FaceCrossings, Leaving},
    state::{
        LaneStart, Rest, Starts, StateLayout, larger, multiply, norm2, rates_at, take_where, vector,
    },
    step::{Curves, Trial},
    switching::{Meeting, SwitchingSurfaces},
    weighted,
};
use crate::manifold::{Carried, Manifold};
use geofan_expr::{Registers, Tape, vectorised};
use glam::DVec3;

/// Squared length of a deviation from which on it is not followed exactly any more: it soon leaves all numbers.
const OVERFLOWING: f64 = 1e280;

/// Follows all `rays`, telling `sink`.
pub fn follow<S: Sink>(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
    sink: &mut S,
) {
    let mut rays = rays.into_iter().enumerate().peekable();
    if rays.peek().is_none() {
        return;
    }
    let mut lanes = RayLanes::new(manifold, settings, sink.region());
    loop {
        lanes.refill(&mut rays, sink);
        if lanes.ray.iter().all(Option::is_none) {
            return;
        }
        lanes.attempt();
        lanes.meet_surfaces();
        lanes.meet_faces(sink);
        lanes.report(sink);
        lanes.commit();
        lanes.cross_faces(sink);
    }
}

struct RayLanes<'m> {
    layout: StateLayout,
    flow: &'m Tape,
    registers: Registers<f64, LANES>,
    rest: Rest,
    /// The rates of a path that carries nothing.
    bare: (&'m Tape, Registers<f64, LANES>, Rest),
    events: Option<Events<'m>>,
    surfaces: Option<SwitchingSurfaces<'m>>,
    faces: Option<FaceCrossings<'m>>,
    starts: Starts<'m>,
    /// The number of the ray that a lane follows.
    ray: [Option<usize>; LANES],
    curves: Curves,
    /// Where steps are of interest, and 1 where the trial may come there, else 0.
    region: Option<(DVec3, DVec3)>,
    near: Row,
    control: Control,
    /// The present state, the state tried, and the stages' rates.
    y: Vec<Row>,
    trial: Vec<Row>,
    k: [Vec<Row>; STAGES],
}

impl<'m> RayLanes<'m> {
    fn new(manifold: &'m Manifold, settings: Settings, region: Option<(DVec3, DVec3)>) -> Self {
        let flow = manifold.flow(settings.carried);
        let bare = manifold.flow(Carried::default());
        let layout = StateLayout::of(settings);
        let rows = || vec![NIL; layout.rows];
        Self {
            layout,
            flow,
            registers: flow.registers(),
            rest: Rest::of(manifold, flow),
            bare: (bare, bare.registers(), Rest::of(manifold, bare)),
            events: match settings.events {
                true => Events::new(&manifold.domain),
                false => None,
            },
            surfaces: SwitchingSurfaces::new(manifold, settings),
            faces: FaceCrossings::new(manifold, settings),
            starts: Starts::new(manifold, settings),
            ray: [None; LANES],
            curves: Curves::new(layout),
            region,
            near: each(|_| 1.0),
            control: Control::new(settings.tolerance),
            y: rows(),
            trial: rows(),
            k: std::array::from_fn(|_| rows()),
        }
    }

    /// Gives every free lane a ray, if any are left.
    fn refill(&mut self, rays: &mut impl Iterator<Item = (usize, Ray)>, sink: &mut impl Sink) {
        for lane in 0..LANES {
            while self.ray[lane].is_none() {
                let Some(start) = self.starts.next(rays, self.events.as_mut()) else {
                    return;
                };
                match start.step {
                    _ if start.length <= 0.0 => sink.end(start.ray, End::Length, 0.0, 0),
                    None => sink.end(start.ray, End::Singular, 0.0, 0),
                    Some(step) => self.start(lane, &start, step),
                }
            }
        }
    }

    fn start(&mut self, lane: usize, start: &LaneStart, step: f64) {
        self.ray[lane] = Some(start.ray);
        let lengths = [start.length, start.straight_end];
        self.control.start(lane, lengths, step);
        for row in 0..self.layout.rows {
            self.y[row][lane] = self.starts.y[row][start.column];
            self.k[0][row][lane] = self.starts.rates[row][start.column];
        }
        if let Some(events) = &mut self.events {
            events.start(lane, &self.starts.events, start.column);
        }
        if let Some(surfaces) = &mut self.surfaces {
            surfaces.start(lane);
        }
        if let Some(faces) = &mut self.faces {
            faces.start(lane);
        }
    }

    /// One trial step of every lane: stages, new state, error, judgement. Lanes without a ray compute
    /// what is left in them; nobody looks at it.
    fn attempt(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                self.stage::<1>();
                self.stage::<2>();
                self.stage::<3>();
                self.stage::<4>();
                self.stage::<5>();
                self.stage::<6>();
                self.flow.run_rest(&mut self.registers);
                self.measure();
                self.restore_speed();
                let (curves, trial) = self.trial();
                curves.make_path(trial);
                if self.control.any_is_long() {
                    self.probe();
                }
                self.control.judge();
                if let Some(region) = self.region {
                    self.near = self.curves.near(region);
                }
                if let Some(events) = &mut self.events {
                    events.look(&self.curves, &self.control, &self.trial);
                }
                self.look_for_surfaces();
                if let Some(faces) = &mut self.faces {
                    faces.look(&self.curves);
                }
            },
        );
    }

    /// The state at which stage `N` is evaluated, and the rates there; the state of the last is the
    /// trial's end.
    // A function for each stage: sums of as many terms as there are, without a loop over them.
    #[inline(always)]
    fn stage<const N: usize>(&mut self) {
        let h = &self.control.h;
        for (row, (trial, y)) in self.trial.iter_mut().zip(&self.y).enumerate() {
            let k: [&Row; N] = std::array::from_fn(|stage| &self.k[stage][row]);
            *trial = each(|l| {
                let mut sum = A[N - 1][0] * k[0][l];
                for stage in 1..N {
                    if A[N - 1][stage] != 0.0 {
                        sum += A[N - 1][stage] * k[stage][l];
                    }
                }
                y[l] + h[l] * sum
            });
        }
        rates_at(
            self.flow,
            &mut self.registers,
            self.layout,
            &self.trial,
            &mut self.k[N],
        );
    }

    /// Looks at the acceleration between the stages: how far it bends the tangent over a step, beside
    /// what the quintic through the step's ends does.
    #[inline(always)]
    fn probe(&mut self) {
        let h = &self.control.h;
        let inverse = each(|l| 1.0 / h[l]);
        for c in 0..3 {
            *self.bare.1.input(c) = *self.curves.point(c, LOOK);
            *self.bare.1.input(3 + c) = *self.curves.tangent(c, &inverse, LOOK);
        }
        self.bare.0.run(&mut self.bare.1);
        let mut surprise = [NIL; 3];
        for (c, surprise) in surprise.iter_mut().enumerate() {
            let (known, a) = (
                self.curves.acceleration(c, &inverse, LOOK),
                self.bare.1.output(c),
            );
            *surprise = each(|l| (a[l] - known[l]) * h[l]);
        }
        let metric = self.bare.2.metric(&self.bare.1);
        self.control.unforeseen2 = norm2(metric, vector(&surprise, 0));
    }

    /// Looks where the trial steps meet surfaces across which the metric is not smooth.
    #[inline(always)]
    fn look_for_surfaces(&mut self) {
        if let Some(surfaces) = &mut self.surfaces {
            let (mut middle, mut tangent) = ([NIL; 3], [NIL; 3]);
            let inverse = each(|l| 1.0 / self.control.h[l]);
            for c in 0..3 {
                middle[c] = self.curves.point(c, 0.5);
                tangent[c] = self.curves.tangent(c, &inverse, 0.5);
            }
            surfaces.look([
                (vector(&self.y, 0), vector(&self.y, 3)),
                (vector(&middle, 0), vector(&tangent, 0)),
                (vector(&self.trial, 0), vector(&self.trial, 3)),
            ]);
        }
    }

    /// Tries steps that end at a surface instead of those that meet one, and moves rays that are there
    /// across it.
    fn meet_surfaces(&mut self) {
        let Some(surfaces) = &mut self.surfaces else {
            return;
        };
        for lane in 0..LANES {
            if self.ray[lane].is_none() || !self.control.may_go_on(lane) {
                continue;
            }
            let (s, h) = (self.control.s[lane], self.control.h[lane]);
            let straight = self.control.looks_straight(lane);
            let meeting = match surfaces.is_crossed(lane) {
                true => surfaces.meeting(&self.curves.step(lane, s, h), straight),
                false => None,
            };
            if let Some(meeting) = meeting {
                let instead = surfaces.instead(lane, meeting, h);
                self.control.try_instead(lane, instead);
                match meeting {
                    Meeting::Ahead(_) => {}
                    Meeting::Here(crossing) => {
                        let state = (&mut self.y[..], &mut self.k[0][..]);
                        surfaces.cross(lane, s, crossing, state);
                    }
                    Meeting::Grazing => self.control.end_here(lane),
                }
            } else if self.control.accepted[lane] > 0.0
                && let Some(step) = surfaces.go_on_with(lane)
            {
                self.control.go_on_with(lane, step);
            }
        }
    }

    /// Tries steps that end at a face of a glued domain instead of those that leave it, and moves rays that start
    /// on one across it.
    fn meet_faces(&mut self, sink: &mut impl Sink) {
        let Some(faces) = &mut self.faces else {
            return;
        };
        for lane in 0..LANES {
            let accepted = self.control.accepted[lane] > 0.0 && self.control.may_go_on(lane);
            let Some(ray) = self.ray[lane].filter(|_| accepted && faces.may_leave(lane)) else {
                continue;
            };
            let (s, h) = (self.control.s[lane], self.control.h[lane]);
            match faces.leaving(lane, &self.curves.path(lane, s, h)) {
                None => {}
                Some(Leaving::Ahead(length)) => self.control.try_instead(lane, length),
                Some(Leaving::Behind(usual)) => self.control.go_on_with(lane, usual),
                Some(Leaving::Here(face)) => {
                    self.control.try_instead(lane, h);
                    let state = (&mut self.y[..], &mut self.k[0][..]);
                    faces.cross((lane, ray), face, state, sink);
                    restart(lane, &self.y, &mut self.events, &mut self.surfaces);
                }
            }
        }
    }

    /// Moves rays whose steps have ended at a face across it.
    fn cross_faces(&mut self, sink: &mut impl Sink) {
        let Some(faces) = &mut self.faces else {
            return;
        };
        for lane in 0..LANES {
            // A step that is tried shorter after all has not come there.
            let due = faces
                .due(lane)
                .filter(|_| self.control.accepted[lane] > 0.0);
            if let Some((ray, face)) = self.ray[lane].zip(due) {
                let state = (&mut self.y[..], &mut self.k[0][..]);
                faces.cross((lane, ray), face, state, sink);
                restart(lane, &self.y, &mut self.events, &mut self.surfaces);
            }
        }
    }

    /// The error of the trial in the metric at the trial's end: an angle for the tangent and the
    /// frame, position over arc length for the point, and the same relative to their size for
    /// deviations.
    #[inline(always)]
    fn measure(&mut self) {
        let metric = self.rest.metric(&self.registers);
        let (s, h, k, trial) = (&self.control.s, &self.control.h, &self.k, &self.trial);
        let (point, tangent) = (vector_error(metric, k, h, 0), vector_error(metric, k, h, 3));
        let inverse2 = each(|l| 1.0 / ((s[l] + h[l]) * (s[l] + h[l])));
        let mut worst = each(|l| larger(point[l] * inverse2[l], tangent[l]));
        if let Some(at) = self.layout.turn {
            for row in at..at + 4 {
                let e = error(k, h, row);
                worst = each(|l| larger(worst[l], e[l] * e[l]));
            }
        }
        if let Some(at) = self.layout.deviation {
            for column in [at, at + 6] {
                let du = vector_error(metric, k, h, column);
                let dv = vector_error(metric, k, h, column + 3);
                let size = norm2(metric, vector(trial, column + 3));
                worst = each(|l| {
                    let e = larger(du[l] * inverse2[l], dv[l]);
                    // Beyond all numbers the path itself goes on.
                    let e = if size[l] < OVERFLOWING {
                        e / larger(1.0, size[l])
                    } else {
                        0.0
                    };
                    larger(worst[l], e)
                });
            }
        }
        self.control.speed2 = match self.rest.wind(&self.registers) {
            None => norm2(metric, vector(trial, 3)),
            Some(wind) => {
                let [x, y, z] = against(wind, vector(trial, 3));
                norm2(metric, [&x, &y, &z])
            }
        };
        self.control.error2 = worst;
        let (place2, bend2) = (
            norm2(metric, vector(trial, 0)),
            norm2(metric, vector(&self.k[STAGES - 1], 3)),
        );
        self.control.moved2 = each(|l| place2[l] * bend2[l]);
    }

    /// Restores unit speed at the new point.
    #[inline(always)]
    fn restore_speed(&mut self) {
        match self.rest.wind(&self.registers) {
            None => self.scale_tangent(),
            Some(wind) => {
                let sights = against(wind, vector(&self.trial, 3));
                self.replace_tangent(&sights);
            }
        }
    }

    /// Brings what is left of the new tangent against the wind to unit length. The acceleration is no
    /// power of it, and stays that of the tangent as integrated: wrong by the error of a step, it moves
    /// the next one by that error times its length, which is of an order higher.
    #[inline(always)]
    fn replace_tangent(&mut self, sights: &[Row; 3]) {
        let speed2 = &self.control.speed2;
        let excess = each(|l| 1.0 / speed2[l].sqrt() - 1.0);
        let rates = &mut self.k[STAGES - 1];
        for (c, n) in sights.iter().enumerate() {
            let v = &self.trial[3 + c];
            let restored = each(|l| v[l] + n[l] * excess[l]);
            self.trial[3 + c] = restored;
            rates[c] = restored;
        }
        self.restore_turn(&each(|_| 1.0));
    }

    /// Scales the new tangent to unit length; the acceleration is quadratic and the turning rate
    /// linear in it, so the rates at the new point follow without another evaluation.
    #[inline(always)]
    fn scale_tangent(&mut self) {
        let speed2 = &self.control.speed2;
        let scale = each(|l| 1.0 / speed2[l].sqrt());
        let scale2 = each(|l| scale[l] * scale[l]);
        let rates = &mut self.k[STAGES - 1];
        for c in 0..3 {
            multiply(&mut self.trial[3 + c], &scale);
            multiply(&mut rates[c], &scale);
            multiply(&mut rates[3 + c], &scale2);
        }
        self.restore_turn(&scale);
    }

    /// Brings the new quaternion to unit length; its rate is `scale` times what it was besides.
    #[inline(always)]
    fn restore_turn(&mut self, scale: &Row) {
        let rates = &mut self.k[STAGES - 1];
        if let Some(turn) = self.layout.turn {
            let [x, y, z, w] = [0, 1, 2, 3].map(|c| &self.trial[turn + c]);
            let unit =
                each(|l| 1.0 / (x[l] * x[l] + y[l] * y[l] + z[l] * z[l] + w[l] * w[l]).sqrt());
            let rate = each(|l| unit[l] * scale[l]);
            for c in turn..turn + 4 {
                multiply(&mut self.trial[c], &unit);
                multiply(&mut rates[c], &rate);
            }
        }
    }

    /// Makes the ends of accepted trials the present states.
    fn commit(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                let accepted = &self.control.accepted;
                let (first, rest) = self.k.split_at_mut(1);
                take_where(accepted, &self.trial, &mut self.y);
                take_where(accepted, &rest[STAGES - 2], &mut first[0]);
                if let Some(events) = &mut self.events {
                    events.commit(accepted);
                }
                self.control.commit();
            },
        );
    }

    /// The trial steps, to be made into curves.
    #[inline(always)]
    fn trial(&mut self) -> (&mut Curves, Trial<'_>) {
        let trial = Trial {
            layout: self.layout,
            h: &self.control.h,
            y: &self.y,
            end: &self.trial,
            k: &self.k,
        };
        (&mut self.curves, trial)
    }
}

/// Makes what looks along steps forget the state before, in a lane whose ray has moved to `y`.
fn restart(
    lane: usize,
    y: &[Row],
    events: &mut Option<Events<'_>>,
    surfaces: &mut Option<SwitchingSurfaces<'_>>,
) {
    if let Some(events) = events {
        let state = std::array::from_fn(|row| y[row][lane]);
        events.restart(lane, state);
    }
    if let Some(surfaces) = surfaces {
        surfaces.start(lane);
    }
}

/// `v − W`
#[inline(always)]
fn against(wind: [&[f64; LANES]; 3], [x, y, z]: [&Row; 3]) -> [Row; 3] {
    [
        each(|l| x[l] - wind[0][l]),
        each(|l| y[l] - wind[1][l]),
        each(|l| z[l] - wind[2][l]),
    ]
}

/// The error of one row of the trial.
#[inline(always)]
fn error(k: &[Vec<Row>; STAGES], h: &Row, row: usize) -> Row {
    let mut error = weighted(&ERROR, k, row);
    multiply(&mut error, h);
    error
}

/// The squared length of the error of the vector that begins at row `at`.
#[inline(always)]
fn vector_error(metric: [&[f64; LANES]; 6], k: &[Vec<Row>; STAGES], h: &Row, at: usize) -> Row {
    let (x, y, z) = (error(k, h, at), error(k, h, at + 1), error(k, h, at + 2));
    norm2(metric, [&x, &y, &z])
}
