//! Frequencies of light between those who send it and the camera, and colours by them.
//!
//! In: outcomes of samples, and what the scene says of motion and heat. Out: the ratio
//! `g = ν_camera/ν_emitter`, and colours in which radiance is weighed with g⁴ and glowing bodies, whose
//! light of temperature T is seen as that of `g T`, have the colours of black bodies. Who follows light from surface to
//! surface asks for the [`SurfaceState`] of each.
//!
//! Surfaces send with the velocity that the scene gives them, else at rest in the chart, and where nothing
//! can be at rest as the normal observer. Skies are infinitely far: what is at rest there has the clock of
//! the chart's time, and the frequency of its light is the energy that paths conserve, 1.

use crate::{
    frame::Outcomes,
    intersect::{Hit, Seen},
    scene::{Formulas, ObjectEntry, Points},
    shade::Colours,
    starts::{RayStart, starts},
    view::View,
    world::World,
};
use geofan_core::parallel::*;
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::Result,
    manifold::{Frequencies, LocalFrame, Manifold, PointFunctions},
};
use glam::{DMat3, DVec2, DVec3};
use ndarray::{Array2, Axis};
use std::{
    collections::BTreeMap,
    sync::{Arc, LazyLock},
};

/// Tells how an object moves and how hot it is.
#[derive(Debug, Clone, Default)]
pub struct ObjectState {
    /// `dx/dt`, chart components.
    velocity: Option<PointFunctions>,
    /// Kelvin; objects that have one glow as black bodies and reflect nothing.
    temperature: Option<PointFunctions>,
}

impl ObjectState {
    /// Compiles what the scene says of an object.
    ///
    /// # Errors
    /// An expression that means nothing, at its place in `source`.
    pub(crate) fn new(
        object: &ObjectEntry,
        manifold: &Manifold,
        source: &Arc<SourceText>,
    ) -> Result<Self> {
        let compiled = |formulas: &Option<Formulas>| {
            let compile = |f: &Formulas| f.compile(manifold, source);
            formulas.as_ref().map(compile).transpose()
        };
        Ok(Self {
            velocity: compiled(&object.velocity)?,
            temperature: compiled(&object.temperature)?,
        })
    }

    /// Returns `dx/dt` at `u`, if the scene gives it.
    fn velocity(&self, u: DVec3) -> Option<DVec3> {
        let velocity = self.velocity.as_ref()?.at(u);
        Some(DVec3::from_slice(&velocity))
    }

    /// Refuses an object of which a vertex would be as fast as light, or of no temperature, at the place in `source` that
    /// says so.
    pub(crate) fn check(
        &self,
        object: &ObjectEntry,
        manifold: &Manifold,
        source: &Arc<SourceText>,
        vertices: &Points,
    ) -> Result<()> {
        let first = |is_bad: &dyn Fn(DVec3) -> bool| {
            let mut points = vertices.iter().map(|(u, _)| *u);
            points.find(|u| is_bad(*u))
        };
        let too_fast = first(&|u| {
            let velocity = self.velocity(u);
            velocity.is_some_and(|velocity| !manifold.is_slower_than_light(u, velocity))
        });
        let no_temperature = first(&|u| {
            let kelvin = self.temperature(u);
            kelvin.is_some_and(|kelvin| !(kelvin >= 0.0 && kelvin.is_finite()))
        });
        let refusals = [
            (
                too_fast.zip(object.velocity.as_ref()),
                "this velocity is not below that of light",
                "it is dx/dt in chart components, with the time of the spacetime",
            ),
            (
                no_temperature.zip(object.temperature.as_ref()),
                "this is no temperature",
                "it is in kelvin: a number, 0 or more, at every point of the object",
            ),
        ];
        for (place, what, hint) in refusals {
            if let Some((u, formulas)) = place {
                let complaint =
                    Diagnostic::new(source, formulas.span.clone(), format!("{what} at {u}"));
                return Err(complaint.with_hint(hint).into());
            }
        }
        Ok(())
    }

    /// Returns its temperature (kelvin) at `u`, if the scene gives it.
    fn temperature(&self, u: DVec3) -> Option<f64> {
        self.temperature.as_ref()?.at(u).first().copied()
    }

    /// Tells whether the object glows.
    pub fn glows(&self) -> bool {
        self.temperature.is_some()
    }

    /// Tells whether the scene gives it a velocity.
    fn moves(&self) -> bool {
        self.velocity.is_some()
    }
}

/// The frame of a surface where light meets it.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceFrame {
    /// That of those at rest in coordinates that move with it.
    pub frame: DMat3,
    /// How far it moves (chart components) for each unit of arc length of lines of sight.
    pub pace: DVec3,
    /// The drift there, chart components of a covector.
    drift: DVec3,
}

impl SurfaceFrame {
    /// Describes a surface at rest in the chart, by the frame of those who are at rest there.
    pub fn at_rest(frame: DMat3) -> Self {
        Self {
            frame,
            pace: DVec3::ZERO,
            drift: DVec3::ZERO,
        }
    }

    /// Returns the unit normal in the frame of the surface that has the normal `covector` in the chart at one of its times.
    pub fn normal(&self, covector: DVec3) -> DVec3 {
        let covector = tilted(covector, self.pace, self.drift);
        (self.frame.transpose() * covector).normalize_or_zero()
    }
}

/// Turns the normal covector `N` of a surface at one time of the chart into that at one time of the lines of sight. With
/// `t = s + b·x` the points `N·(x − u t) = 0` have the covector `N − (N·u) b` for one s, and the velocity `u` is the pace
/// over `1 + b·pace`.
fn tilted(covector: DVec3, pace: DVec3, drift: DVec3) -> DVec3 {
    covector - drift * (covector.dot(pace) / (1.0 + drift.dot(pace)))
}

/// Tells how a surface moves where light meets it, and how hot it is there.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceState {
    frequencies: Frequencies,
    /// `dx/dt`, chart components, of what is slower than light; else the surface sends as the normal observer.
    velocity: Option<DVec3>,
    /// Kelvin, of what glows.
    temperature: Option<f64>,
}

impl SurfaceState {
    /// Describes a surface that has the `velocity` and the `temperature` that its scene gives, if it does.
    fn new(frequencies: Frequencies, velocity: Option<[f64; 3]>, temperature: Option<f64>) -> Self {
        let velocity = velocity.map_or(DVec3::ZERO, DVec3::from);
        let slower = frequencies.is_slower_than_light(velocity);
        Self {
            frequencies,
            velocity: slower.then_some(velocity),
            temperature,
        }
    }

    /// Returns the frequency that the surface measures of light of energy 1 on a path with the tangent `v` (chart
    /// components, any length).
    pub fn frequency(&self, v: DVec3) -> f64 {
        let n = self.frequencies.sight(v);
        match self.velocity {
            Some(velocity) => self.frequencies.moving(n, velocity),
            None => self.frequencies.normal(n),
        }
    }

    /// Returns the frame of the surface, of which `local` is the normal observer there.
    fn frame(&self, local: LocalFrame) -> SurfaceFrame {
        let moving = local.moving(self.pace());
        SurfaceFrame {
            frame: moving.rest_frame(self.frequencies.metric()),
            pace: self.pace(),
            drift: self.frequencies.drift(),
        }
    }

    /// Returns the normal covector at one time of the lines of sight of a surface that has `covector` at one time of the
    /// chart.
    pub fn tilted(&self, covector: DVec3) -> DVec3 {
        tilted(covector, self.pace(), self.frequencies.drift())
    }

    /// Undoes [`SurfaceState::tilted`].
    pub fn untilted(&self, covector: DVec3) -> DVec3 {
        covector + self.frequencies.drift() * covector.dot(self.pace())
    }

    /// Returns the lapse there.
    pub fn lapse(&self) -> f64 {
        self.frequencies.lapse()
    }

    /// Returns how far (chart components) it moves for each unit of arc length of lines of sight.
    pub fn pace(&self) -> DVec3 {
        let velocity = self.velocity.unwrap_or(DVec3::ZERO);
        self.frequencies.along_paths(velocity)
    }

    /// Returns the light that it gives off at `g` times its frequencies: that of a black body if it glows, which then
    /// reflects nothing, else `radiance`.
    pub fn sent(&self, radiance: [f32; 3], g: f64) -> [f32; 3] {
        match self.temperature {
            Some(kelvin) => blackbody(g * kelvin),
            None => radiance.map(|light| light * brighter(g) as f32),
        }
    }

    /// Tells whether it glows.
    pub fn glows(&self) -> bool {
        self.temperature.is_some()
    }
}

/// Returns `g` of samples at points of a picture and of what they see, in order; not a number where nothing
/// is seen. `states` are those of the surfaces that they see.
fn compared(
    world: &World,
    view: &View,
    samples: &[(DVec2, Seen)],
    states: &[SurfaceState],
) -> Vec<f64> {
    let manifold = &world.manifold;
    let starts = starts(manifold, view, samples.iter().map(|(at, _)| *at));
    // Most pictures are taken from one place.
    let mut place: Option<(DVec3, DMat3, Frequencies)> = None;
    let mut states = states.iter();
    let g = |(start, (_, seen)): (Option<RayStart>, &(DVec2, Seen))| {
        // Tangents are kept in single precision.
        let sent = surface(seen).and_then(|hit| Some(states.next()?.frequency(hit.v.as_dvec3())));
        let Some(RayStart { u, direction, .. }) = start else {
            return f64::NAN;
        };
        let (_, frame, frequencies) = match place.take() {
            Some(known) if known.0 == u => place.insert(known),
            _ => place.insert((u, manifold.standard_frame(u), manifold.frequencies(u))),
        };
        let camera = frequencies.normal(*frame * direction) * view.blueshift(direction);
        match seen {
            Seen::Surface(_) => camera / sent.unwrap_or(f64::NAN),
            Seen::Sky { .. } => camera,
            Seen::Nothing | Seen::Length | Seen::Singular => f64::NAN,
        }
    };
    starts.into_iter().zip(samples).map(g).collect()
}

/// Returns the hit of a sample that sees a surface.
fn surface(seen: &Seen) -> Option<Hit> {
    match seen {
        Seen::Surface(hit) => Some(*hit),
        _ => None,
    }
}

/// Returns the states of the surfaces that samples see, in order.
fn states_seen(world: &World, samples: &[(DVec2, Seen)]) -> Vec<SurfaceState> {
    let hits = samples.iter().filter_map(|(_, seen)| surface(seen));
    let places = hits.map(|hit| (world.point(&hit), hit.triangle));
    surface_states(world, places)
}

/// Returns the states of surfaces at chart points of triangles.
fn surface_states(world: &World, places: impl Iterator<Item = (DVec3, u32)>) -> Vec<SurfaceState> {
    let (points, triangles): (Vec<DVec3>, Vec<u32>) = places.unzip();
    let velocities = told(world, (&points, &triangles), |state| {
        state.velocity.as_ref()
    });
    let temperatures = told(world, (&points, &triangles), |state| {
        state.temperature.as_ref()
    });
    let told = velocities.into_iter().zip(temperatures);
    let each = world.manifold.frequencies_at(&points);
    let state = |(at, (velocity, kelvin)): (_, (_, Option<[f64; 3]>))| {
        SurfaceState::new(at, velocity, kelvin.map(|[kelvin, ..]| kelvin))
    };
    each.into_iter().zip(told).map(state).collect()
}

/// Computes what `functions` of objects tell at chart points of their triangles, up to three numbers for each; `None`
/// for objects that have none.
fn told<'w>(
    world: &'w World,
    (points, triangles): (&[DVec3], &[u32]),
    functions: impl Fn(&'w ObjectState) -> Option<&'w PointFunctions>,
) -> Vec<Option<[f64; 3]>> {
    let mut by_object: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (i, triangle) in triangles.iter().enumerate() {
        let object = world.faces[*triangle as usize].object;
        by_object.entry(object).or_default().push(i);
    }
    let mut found = vec![None; points.len()];
    for (object, members) in by_object {
        let Some(functions) = functions(&world.states[object as usize]) else {
            continue;
        };
        let rows = functions.at_each(members.iter().map(|i| points[*i]));
        let width = rows.len() / members.len();
        for (i, row) in members.into_iter().zip(rows.chunks_exact(width)) {
            let mut numbers = [0.0; 3];
            numbers[..width].copy_from_slice(row);
            found[i] = Some(numbers);
        }
    }
    found
}

impl World {
    /// Tells whether the scene asks for colours that depend on frequencies.
    pub fn is_coloured_by_frequency(&self) -> bool {
        self.redshift || self.states.iter().any(ObjectState::glows)
    }

    /// Tells whether a triangle is of an object that glows.
    pub fn glows(&self, triangle: u32) -> bool {
        self.states[self.faces[triangle as usize].object as usize].glows()
    }

    /// Returns the states of surfaces at chart points of triangles; `None` if the scene says nothing of frequencies, heat
    /// or motion.
    pub fn surface_states(&self, places: &[(DVec3, u32)]) -> Option<Vec<SurfaceState>> {
        let states = || surface_states(self, places.iter().copied());
        self.has_surface_states().then(states)
    }

    /// Returns the frames of surfaces in these `states` at chart points of triangles; of those at rest if there are no
    /// states.
    pub fn surface_frames(
        &self,
        places: &[(DVec3, u32)],
        states: Option<&[SurfaceState]>,
    ) -> Vec<SurfaceFrame> {
        let points: Vec<DVec3> = places.iter().map(|(u, _)| *u).collect();
        let Some(states) = states else {
            let frames = self.manifold.rest_frames(&points).into_iter();
            return frames.map(SurfaceFrame::at_rest).collect();
        };
        let locals = self.manifold.local_frames(&points).into_iter();
        let moving = |(local, state): (_, &SurfaceState)| state.frame(local);
        locals.zip(states).map(moving).collect()
    }

    /// Tells whether the scene says anything of frequencies, heat or motion.
    fn has_surface_states(&self) -> bool {
        self.is_coloured_by_frequency() || self.states.iter().any(ObjectState::moves)
    }

    /// Writes down all that the scene says of frequencies, heat and motion, to be hashed; `None` if that is nothing.
    pub fn said_of_frequencies(&self) -> Option<String> {
        let told = || format!("{:?}", (self.redshift, &self.states));
        self.has_surface_states().then(told)
    }

    /// Tells whether light may reach the camera of `view` at other frequencies than it was sent with, or the scene asks.
    pub fn has_redshift(&self, view: &View) -> bool {
        self.is_coloured_by_frequency()
            || self.manifold.has_redshift()
            || view.velocity() != DVec3::ZERO
            || self.states.iter().any(ObjectState::moves)
    }
}

/// Weighs `colours` of samples at `offsets` with their frequencies, as far as the scene asks for it, and
/// colours what glows.
pub(crate) fn shift_colours(
    world: &World,
    view: &View,
    outcomes: &Outcomes,
    offsets: &[DVec2],
    colours: &mut Colours,
) {
    if !world.is_coloured_by_frequency() {
        return;
    }
    let rows = colours.axis_iter_mut(Axis(0)).into_par_iter();
    rows.zip(outcomes.axis_iter(Axis(0)).into_par_iter())
        .enumerate()
        .for_each(|(y, (mut row, seen))| {
            let at = |(x, k): (usize, usize)| DVec2::new(x as f64, y as f64) + offsets[k];
            let samples = seen.indexed_iter().map(|(place, seen)| (at(place), *seen));
            let samples: Vec<_> = samples.collect();
            let states = states_seen(world, &samples);
            let g = match world.redshift {
                true => compared(world, view, &samples, &states),
                false => vec![1.0; samples.len()],
            };
            let mut states = states.iter();
            let samples = samples.iter().zip(g);
            for (mut colour, ((_, seen), g)) in row.lanes_mut(Axis(2)).into_iter().zip(samples) {
                let state = surface(seen).and_then(|_| states.next());
                let light = shifted(seen, state, g, [0, 1, 2].map(|c| colour[c]));
                for (c, light) in light.into_iter().enumerate() {
                    colour[c] = light;
                }
            }
        });
}

/// Returns a sample's colour at frequencies that are `g` times those sent by what it sees, a surface in this `state`.
fn shifted(seen: &Seen, state: Option<&SurfaceState>, g: f64, colour: [f32; 3]) -> [f32; 3] {
    match (seen, state) {
        (Seen::Nothing | Seen::Length | Seen::Singular, _) => colour,
        (_, Some(state)) => state.sent(colour, g),
        (_, None) => colour.map(|light| light * brighter(g) as f32),
    }
}

/// Returns the factor by which radiance grows where frequencies are `g` times as high. Behind what no light can leave,
/// nothing is seen.
pub fn brighter(g: f64) -> f64 {
    if g > 0.0 { g.powi(4) } else { 0.0 }
}

/// Computes `g` of the first sample of every pixel; not a number where nothing is seen.
pub fn redshifts(world: &World, view: &View, outcomes: &Outcomes, offset: DVec2) -> Array2<f32> {
    let first = outcomes.index_axis(Axis(2), 0);
    let mut found = Array2::from_elem(first.dim(), f32::NAN);
    let rows = found.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
    rows.for_each(|(y, mut row)| {
        let at = |x: usize| DVec2::new(x as f64, y as f64) + offset;
        let samples = first.row(y).into_iter().enumerate();
        let samples: Vec<_> = samples.map(|(x, seen)| (at(x), *seen)).collect();
        let g = compared(world, view, &samples, &states_seen(world, &samples));
        for (slot, g) in row.iter_mut().zip(g) {
            *slot = g as f32;
        }
    });
    found
}

/// The temperature (kelvin) of the black body whose luminance is 1: daylight.
const UNIT_TEMPERATURE: f64 = 6500.0;

/// hc/k, nanometres times kelvin.
const SECOND_RADIATION_CONSTANT: f64 = 1.438_776_877e7;

/// Returns linear red, green and blue of a black body at `kelvin`, in units in which that of 6500 K has the
/// luminance 1. What lies outside of the colours of screens is moved to their edge.
pub fn blackbody(kelvin: f64) -> [f32; 3] {
    static UNIT: LazyLock<f64> = LazyLock::new(|| 1.0 / tristimulus(UNIT_TEMPERATURE).y);
    if !(kelvin > 0.0) {
        return [0.0; 3];
    }
    let DVec3 { x, y, z } = tabulated_tristimulus(kelvin) * *UNIT;
    // IEC 61966-2-1.
    let rgb = [
        3.2406 * x - 1.5372 * y - 0.4986 * z,
        -0.9689 * x + 1.8758 * y + 0.0415 * z,
        0.0557 * x - 0.2040 * y + 1.0570 * z,
    ];
    rgb.map(|light| light.max(0.0) as f32)
}

/// Temperatures (kelvin) between which the light of black bodies is tabulated, and how often: logarithms of it are linear
/// from entry to entry to 1e-4.
const TABULATED: [f64; 2] = [500.0, 200_000.0];
const ENTRIES: usize = 2048;

/// Returns [`tristimulus`], interpolated where it is tabulated.
fn tabulated_tristimulus(kelvin: f64) -> DVec3 {
    static LOGARITHMS: LazyLock<Vec<DVec3>> = LazyLock::new(|| {
        let [low, high] = TABULATED;
        let at = |k: usize| low * (high / low).powf(k as f64 / (ENTRIES - 1) as f64);
        (0..ENTRIES)
            .map(|k| tristimulus(at(k)).map(f64::ln))
            .collect()
    });
    let [low, high] = TABULATED;
    let place = (kelvin / low).ln() / (high / low).ln() * (ENTRIES - 1) as f64;
    let first = place.floor();
    match LOGARITHMS.get(first.max(0.0) as usize..) {
        Some([a, b, ..]) if first >= 0.0 => a.lerp(*b, place - first).map(f64::exp),
        _ => tristimulus(kelvin),
    }
}

/// Integrates Planck's law at `kelvin` with the eye's sensitivities, up to a factor.
fn tristimulus(kelvin: f64) -> DVec3 {
    static SENSITIVITIES: LazyLock<Vec<(f64, DVec3)>> = LazyLock::new(|| {
        let wavelengths = (0..=90).map(|k| 380.0 + 5.0 * f64::from(k));
        wavelengths.map(|nm| (nm, sensitivity(nm))).collect()
    });
    let radiance = |nm: f64| {
        // Overflows to no light.
        let occupied = 1.0 / (SECOND_RADIATION_CONSTANT / (nm * kelvin)).exp_m1();
        occupied * (500.0 / nm).powi(5)
    };
    let light = SENSITIVITIES.iter().map(|(nm, eye)| *eye * radiance(*nm));
    light.sum()
}

/// Returns the sensitivities x̄, ȳ, z̄ of the standard observer of 1931 at a wavelength, by the lobes of C.
/// Wyman, P.-P. Sloan, P. Shirley, *Simple analytic approximations to the CIE XYZ color matching
/// functions* (2013).
fn sensitivity(nm: f64) -> DVec3 {
    let lobe = |weight: f64, middle: f64, [left, right]: [f64; 2]| {
        let width = if nm < middle { left } else { right };
        weight * (-0.5 * ((nm - middle) / width).powi(2)).exp()
    };
    DVec3::new(
        lobe(1.056, 599.8, [37.9, 31.0])
            + lobe(0.362, 442.0, [16.0, 26.7])
            + lobe(-0.065, 501.1, [20.4, 26.2]),
        lobe(0.821, 568.8, [46.9, 40.5]) + lobe(0.286, 530.9, [16.3, 31.1]),
        lobe(1.217, 437.0, [11.8, 36.0]) + lobe(0.681, 459.0, [26.0, 13.8]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chromaticities_of_black_bodies_are_those_of_the_planckian_locus() {
        // x, y of the Planckian locus (CIE 15).
        for (kelvin, x, y) in [
            (2856.0, 0.4476, 0.4075),
            (5000.0, 0.3451, 0.3516),
            (6504.0, 0.3135, 0.3237),
            (10_000.0, 0.2807, 0.2884),
        ] {
            let found = tabulated_tristimulus(kelvin);
            assert!((found / tristimulus(kelvin) - 1.0).abs().max_element() < 1e-4);
            let found = found / (found.x + found.y + found.z);
            let off = (found.x - x).abs().max((found.y - y).abs());
            assert!(off < 3e-3, "{kelvin}: {found}");
        }
    }

    #[test]
    fn hot_is_blue_cold_is_red_and_absolute_zero_is_dark() {
        let [r, _, b] = blackbody(2500.0);
        assert!(r > 5.0 * b);
        let [r, _, b] = blackbody(20_000.0);
        assert!(b > 1.3 * r);
        assert_eq!(blackbody(0.0), [0.0; 3]);
        assert_eq!(blackbody(f64::NAN), [0.0; 3]);
        let [r, g, b] = blackbody(UNIT_TEMPERATURE).map(f64::from);
        assert!((0.2126 * r + 0.7152 * g + 0.0722 * b - 1.0).abs() < 1e-3);
    }
}
