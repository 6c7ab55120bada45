//! A camera that lives in the space: it moves along geodesics and takes its axes with it.
//!
//! In: a camera (chart point `u`, rotation `R`), and a move or a turn in its own axes. Out: the
//! camera afterwards. Its axes in the chart are the columns of `S(u) R`: x to the right, y up, z
//! backwards, so that it looks along −z. Moves are lengths in the metric.
//!
//! `R` obeys `Ṙ = −Ω R` and is a unit quaternion, so it never stops being a rotation. A closed way
//! brings the camera back turned by the holonomy of the loop.

use geofan_bundle::Table;
use geofan_core::{
    error::Result,
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::{DeckTransformation, Gluing, Manifold},
};
use glam::{DMat3, DQuat, DVec3};

/// Where a camera is and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Chart point.
    pub u: DVec3,
    /// Its axes in the standard frame, as a unit quaternion.
    pub rotation: DQuat,
}

/// A camera after a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The camera where it is now.
    pub camera: Camera,
    /// Arc length that it came: less than asked for if the space ended, or right and left would change places.
    pub length: f64,
}

/// Local tolerance of the geodesics along which a camera moves. Errors of single moves add up: at
/// this one, 100,000 of them stay below 1e-7 of the way; a coarser one saves nothing that can be
/// noticed beside drawing a picture.
const TOLERANCE: f64 = 1e-12;

/// The ray of a move is longer than the move by this factor and given up when the move is done: the
/// integrator's steps are limited to a share (1/16) of the ray, and a small move should be one step.
const ROOM: f64 = 32.0;

/// Keeps the step on which the wanted length is reached, or the last before right and left change places.
struct Way {
    wanted: f64,
    last: Option<Step>,
    reversed: bool,
}

impl Sink for Way {
    fn step(&mut self, _: usize, step: &Step) {
        match step.reversed {
            true => self.reversed = true,
            false => self.last = Some(step.clone()),
        }
    }

    fn wants_more(&self, _: usize) -> bool {
        !self.reversed && self.last.as_ref().is_none_or(|step| step.end < self.wanted)
    }

    fn end(&mut self, _: usize, _: End, _: f64, _: usize) {}
}

impl Camera {
    /// A camera at `u` that looks along `look` with `up` upwards: unit and perpendicular, or at
    /// least not parallel, in the standard frame.
    pub fn looking(u: DVec3, look: DVec3, up: DVec3) -> Self {
        let back = -look.normalize();
        let right = up.cross(back).normalize();
        let axes = DMat3::from_cols(right, back.cross(right), back);
        Self {
            u,
            rotation: DQuat::from_mat3(&axes).normalize(),
        }
    }

    /// Its axes in the chart: the columns of `S(u) R`.
    pub fn axes(&self, manifold: &Manifold) -> DMat3 {
        manifold.standard_frame(self.u) * DMat3::from_quat(self.rotation)
    }

    /// The camera turned by `turn`, which is given in its own axes.
    #[must_use]
    pub fn turned(&self, turn: DQuat) -> Self {
        Self {
            u: self.u,
            rotation: (self.rotation * turn).normalize(),
        }
    }

    /// The camera moved by `by` (in its own axes, length in the metric): along the geodesic in that
    /// direction, its axes transported in parallel, also through portals. It stops where the geodesic leaves the
    /// domain, meets an exit or a mirror; glued coordinates are brought back between their limits.
    pub fn moved(&self, manifold: &Manifold, by: DVec3) -> Moved {
        let stay = Moved {
            camera: *self,
            length: 0.0,
        };
        let Some(direction) = (self.rotation * by).try_normalize() else {
            return stay;
        };
        let settings = Settings::bare(TOLERANCE).with_frame().with_events();
        let wanted = by.length();
        // A wind blows light, and no camera.
        let developed = manifold.developed();
        let still = developed.still();
        let ray = Ray::new(&still, self.u, direction, ROOM * wanted);
        let mut way = Way {
            wanted,
            last: None,
            reversed: false,
        };
        follow(&still, settings, [ray], &mut way);
        let Some(step) = way.last else { return stay };
        let length = wanted.min(step.end);
        let turn = step.rotation(length).unwrap_or(DQuat::IDENTITY);
        let camera = Self {
            u: manifold.domain.wrap(step.position(length)),
            rotation: (turn * self.rotation).normalize(),
        };
        Moved {
            camera: camera.brought_in(manifold),
            length,
        }
    }

    /// Brings the camera into the domain of a glued space, turned by the maps of the faces between. A camera cannot
    /// be mirrored: where an odd number of faces turns right into left, it stays before the last of these.
    #[must_use]
    pub fn brought_in(&self, manifold: &Manifold) -> Self {
        let Some(gluing) = manifold.gluing() else {
            return *self;
        };
        let word = gluing.locate(self.u).map_or(Vec::new(), |(_, word)| word);
        let proper = |n: &usize| !gluing.reverses(&word[..*n]);
        let word = &word[..(0..=word.len()).rev().find(proper).unwrap_or(0)];
        if word.is_empty() {
            return *self;
        }
        let axes = gluing.carried(word, self.u, self.axes(manifold));
        let carry = |u: DVec3, k: &usize| gluing.faces()[*k].carry(u).map_or(u, |(u, _)| u);
        let u = word.iter().fold(self.u, carry);
        let own = manifold.standard_frame(u).inverse() * axes;
        Self {
            u,
            rotation: DQuat::from_mat3(&own).normalize(),
        }
    }

    /// Returns the camera as a deck transformation carries it, turned by its differential.
    #[must_use]
    pub fn carried_by(&self, manifold: &Manifold, deck: &DeckTransformation) -> Self {
        let (u, d) = deck.apply(self.u);
        let own = manifold.standard_frame(u).inverse() * (d * self.axes(manifold));
        Self {
            u,
            rotation: DQuat::from_mat3(&own).normalize(),
        }
    }

    /// Moves it by table: point and transported rotation are read from the path that starts at the
    /// camera, as exact as the table's certificate says, and nothing is integrated but the turning
    /// along that path. Where the table gives up before the end of the move, does not promise
    /// tangents, has paths of light in a wind, or knows nothing of portals and mirrors, it is [`Camera::moved`].
    ///
    /// # Errors
    /// The camera is not in the table's region, or the table is damaged there.
    pub fn moved_by(&self, table: &Table, by: DVec3) -> Result<Moved> {
        let glued = table.space.manifold().glued();
        let manifold = &*glued;
        let by_cover = manifold.gluing().is_none_or(Gluing::follows_cover);
        if manifold.has_wind() || !by_cover {
            return Ok(self.moved(manifold, by));
        }
        let fan = table.fan(self.u)?;
        let Some(direction) = (self.rotation * by).try_normalize() else {
            return Ok(self.moved(manifold, by));
        };
        let path = fan.path(direction);
        let wanted = by.length();
        let event = path.first_event(wanted.min(table.length));
        let length = event.map_or(wanted, |(_, s)| s);
        let turn = path.rotation(length).filter(|_| length <= table.length);
        let Some((turn, (u, _))) = turn.zip(path.at(length)) else {
            return Ok(self.moved(manifold, by));
        };
        let camera = Self {
            u: manifold.domain.wrap(u),
            rotation: (turn * self.rotation).normalize(),
        };
        Ok(Moved {
            camera: camera.brought_in(manifold),
            length,
        })
    }
}
