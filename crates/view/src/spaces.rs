//! A space to look around in, for the two sides of a viewer: what a session knows of it, and what draws it.
//!
//! A session must know where cameras may be, and where the scene's are: in, a scene, its manifold and perhaps a bundle;
//! out, a [`SessionSpace`]. Meshes and skies are the drawing's matter: in, a loaded scene, perhaps with its bundle, and
//! [`Work`] (blocks of pixels, rays); out, [`Answer`]s. A [`DrawSpace`] can be shared by threads; in the browser every
//! worker has its own. The fan of the last camera is kept, because a head turns more often than it moves, and blocks of
//! one picture have one camera.

use crate::{
    error_classes::{error_colour, screen_errors},
    frame_plan::Block,
    protocol::{Answer, DrawRequest, PictureKind, Pose, RayQuery, RayReport, SkyChoice, Work},
};
use geofan_bundle::{Bundle, Fan, Table};
use geofan_core::{
    Error, Result,
    geodesic::check_point,
    manifold::{Domain, Manifold},
};
use geofan_light::path_tracer::{Estimator, PathTracer, PathTracerSettings};
use geofan_render::{
    Camera, Curve, ExactGridTracer, ExactTracer, Lookup, Stage, View, camera_point,
    drawing::draw,
    frame::Paths,
    intersect::{Seen, seen_along},
    local::straight_curve,
    no_clock,
    picture::Picture,
    scene::{CameraEntry, CameraMotion, Lens, SceneFile},
    shade::Footprints,
    sky::{Pattern, Sky},
};
use glam::DVec3;
use ndarray::s;
use std::sync::{Arc, Mutex, OnceLock};

/// A loaded scene that can be drawn.
pub struct DrawSpace {
    /// The scene.
    pub stage: Stage,
    /// The table, with the lookup's knots.
    table: Option<(Bundle, Arc<[f64]>)>,
    /// Arc length over which exact paths are followed.
    length: f64,
    /// Knots of exact paths that are interpolated, chosen when first needed.
    knots: OnceLock<Arc<[f64]>>,
    fan: Mutex<Option<Fan>>,
    /// The scene's skies, while others stand in for them.
    own_skies: Option<Vec<Option<Sky>>>,
}

/// Local tolerance of exact paths, as that of `geofan render`.
const TOLERANCE: f64 = 1e-8;

/// Local tolerance of exact paths between which is interpolated: the interpolation is coarser by far.
const COARSE_TOLERANCE: f64 = 1e-6;

/// Most error of interpolation between paths, radians, as that of `geofan render`.
const BUDGET: f64 = 5e-4;

/// Points of a path that is drawn on a map.
const POINTS: usize = 128;

impl DrawSpace {
    /// Takes over a scene; exact paths are followed over `length`, or over the table's.
    pub fn new(stage: Stage, bundle: Option<Bundle>, length: f64) -> Self {
        let table = bundle.map(|bundle| {
            let lookup = Lookup::new(&bundle.table, bundle.promise(), TOLERANCE);
            let knots = lookup.knots().clone();
            (bundle, knots)
        });
        let length = table
            .as_ref()
            .map_or(length, |(bundle, _)| bundle.table.length);
        Self {
            stage,
            table,
            length,
            knots: OnceLock::new(),
            fan: Mutex::default(),
            own_skies: None,
        }
    }

    /// Shows other skies: a pattern beyond every exit that has a sky or says in which direction to look it up, but not
    /// where the scene has one plain colour (the inside of a horizon).
    pub fn dress(&mut self, sky: SkyChoice) {
        let world = &mut self.stage.world;
        if let Some(own) = self.own_skies.take() {
            world.skies = own;
        }
        let pattern = match sky {
            SkyChoice::Scene => return,
            SkyChoice::Grid => Sky::Grid,
            SkyChoice::Stars => Sky::from(Pattern::Stars),
        };
        self.own_skies = Some(world.skies.clone());
        let exits = world.manifold.exits.iter().zip(&mut world.skies);
        for (exit, sky) in exits {
            let looked_up = exit.has_direction() || sky.is_some();
            if looked_up && !matches!(sky, Some(Sky::Colour(_))) {
                *sky = Some(pattern.clone());
            }
        }
    }

    /// Returns the bundle.
    pub fn bundle(&self) -> Option<&Bundle> {
        self.table.as_ref().map(|(bundle, _)| bundle)
    }

    /// Returns how far paths are followed.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Does `work`.
    pub fn answer(&self, work: &Work) -> Answer {
        let done = match work {
            Work::Draw(request) => self.draw(request),
            Work::Ray(query) => self.ray(query),
        };
        done.unwrap_or_else(|error| work.failed(error.to_string()))
    }

    /// Draws a block.
    fn draw(&self, request: &DrawRequest) -> Result<Answer> {
        let block = request.block;
        if block.width == 0 || !block.is_within(request.size) {
            return Err(Error::input("block", "is not a part of the picture"));
        }
        let whole = View::of_camera(&request.camera(), request.fov, request.size);
        let answer = |rgb: Vec<f32>, errors: Vec<f32>| Answer::Drawn {
            frame: request.frame,
            block,
            rgb,
            errors,
        };
        if let Some(pass) = request.pass {
            return Ok(answer(self.light_pass(&whole, block, pass)?, Vec::new()));
        }
        let part = whole.cropped(block.columns(), block.rows());
        if request.kind == PictureKind::Error {
            let errors = self.errors(&part)?;
            let rgb = errors.iter().flat_map(|e| error_colour(*e)).collect();
            return Ok(answer(rgb, errors));
        }
        let (wide, (columns, rows)) = part.widened(request.margin);
        let picture = self.picture(&wide, request)?;
        let inner = picture.rgb.slice(s![rows, columns, ..]).to_owned();
        Ok(answer(inner.into_raw_vec_and_offset().0, Vec::new()))
    }

    /// Draws what `view` sees.
    fn picture(&self, view: &View, request: &DrawRequest) -> Result<Picture> {
        let world = &self.stage.world;
        let samples = usize::from(request.samples.max(1));
        let by = |paths: Paths<'_>| {
            draw(world, view, paths, samples, Footprints::Filtered, &no_clock).picture
        };
        if request.kind == PictureKind::Flat {
            return Ok(by(Paths::Straight(self.length)));
        }
        if let (PictureKind::Table, Some((bundle, knots))) = (request.kind, &self.table)
            && bundle.table.space.place(view.u).is_ok()
        {
            let lookup =
                Lookup::at_knots(&bundle.table, knots.clone(), bundle.promise(), TOLERANCE);
            let fan = self.fan(bundle, view.u)?;
            fan.prepare(&view.spread());
            return Ok(by(Paths::Lattice(&lookup.tracer(&fan), BUDGET)));
        }
        if request.each && request.kind == PictureKind::Exact {
            let tracer = ExactTracer::new(&world.manifold, view.u, self.length, TOLERANCE);
            return Ok(by(Paths::Exact(&tracer)));
        }
        let tracer = ExactGridTracer::new(
            &world.cover,
            view.u,
            self.exact_knots(view.u).clone(),
            COARSE_TOLERANCE,
        );
        Ok(by(Paths::Lattice(&tracer, BUDGET)))
    }

    /// Follows light at random: one sample of each pixel of a block of `view`, those of `geofan render --tracer path`.
    fn light_pass(&self, view: &View, block: Block, pass: u64) -> Result<Vec<f32>> {
        let world = &self.stage.world;
        let settings = PathTracerSettings {
            seed: 0,
            length: self.length,
            tolerance: TOLERANCE,
            bounces: u32::MAX,
            estimator: Estimator::Connected,
        };
        let row = |y: usize| block.columns().map(move |x| y * view.size.0 + x);
        let pixels: Vec<usize> = block.rows().flat_map(row).collect();
        let light = PathTracer::new(world, view, settings).part(&pixels, pass, || false);
        let light = light.into_iter().flatten();
        Ok(light.flat_map(|x| x.to_array()).map(|x| x as f32).collect())
    }

    /// Returns the knots of exact paths.
    fn exact_knots(&self, u: DVec3) -> &Arc<[f64]> {
        let manifold = &self.stage.world.cover;
        let choose = || ExactGridTracer::choose_knots(manifold, u, self.length, COARSE_TOLERANCE);
        match self.knots.get() {
            Some(knots) => knots,
            // Not within `get_or_init`: a thread that waits there may take up work that needs the knots.
            None => {
                let knots = choose();
                self.knots.get_or_init(|| knots)
            }
        }
    }

    /// Returns all paths from `u`.
    fn fan(&self, bundle: &Bundle, u: DVec3) -> Result<Fan> {
        let known = self.fan.lock().unwrap_or_else(|e| e.into_inner()).clone();
        if let Some(fan) = known.filter(|fan| fan.place.u == u) {
            return Ok(fan);
        }
        let fan = bundle.fan(u)?;
        *self.fan.lock().unwrap_or_else(|e| e.into_inner()) = Some(fan.clone());
        Ok(fan)
    }

    fn errors(&self, view: &View) -> Result<Vec<f32>> {
        let Some((bundle, _)) = &self.table else {
            return Err(Error::input("errors", "there is no table yet"));
        };
        let fan = self.fan(bundle, view.u)?;
        Ok(screen_errors(&fan, view, self.length))
    }

    /// Follows a ray to what it meets.
    fn ray(&self, query: &RayQuery) -> Result<Answer> {
        let world = &self.stage.world;
        let (u, direction) = (
            DVec3::from_array(query.u),
            DVec3::from_array(query.direction),
        );
        let Some(direction) = direction.try_normalize().filter(|_| u.is_finite()) else {
            return Err(Error::input("ray", "has no direction"));
        };
        let curve = match query.kind {
            PictureKind::Flat => Some(straight_curve(world, u, direction, self.length)),
            _ => {
                let tracer = ExactTracer::new(&world.manifold, u, self.length, TOLERANCE);
                tracer.trace(&[direction]).pop()
            }
        };
        let Some(curve) = curve else {
            return Err(Error::input("ray", "cannot be followed"));
        };
        let reached = curve.s.last().copied().unwrap_or_default();
        let (length, end, object) = match seen_along(world, &curve) {
            Seen::Surface(hit) => {
                let object = world.faces[hit.triangle as usize].object as usize;
                (f64::from(hit.s), self.object_name(object), true)
            }
            Seen::Sky { exit, s, .. } => (
                f64::from(s),
                world.manifold.exits[exit as usize].name.clone(),
                false,
            ),
            Seen::Singular => (reached, "singular".into(), false),
            Seen::Length | Seen::Nothing => (reached, "length".into(), false),
        };
        let (points, jumps) = on_map(&curve, length.min(reached), &world.manifold.domain);
        let report = RayReport {
            points,
            jumps,
            length,
            end,
            object,
        };
        let number = query.number;
        Ok(Answer::Ray { number, report })
    }

    /// Names an object of the scene by its mesh.
    fn object_name(&self, index: usize) -> String {
        let object = self.stage.scene.objects.get(index);
        let stem = object.and_then(|object| object.mesh.file_stem());
        let name = stem.map_or_else(|| "object".into(), |stem| stem.to_string_lossy());
        format!("{name} ({})", index + 1)
    }
}

/// Returns points of a curve up to an arc length, evenly spaced and on both sides of each jump, in the domain; and before which
/// of them the curve goes on elsewhere: behind a glued face or a whole period.
fn on_map(curve: &Curve, length: f64, domain: &Domain) -> (Vec<[f64; 3]>, Vec<usize>) {
    let even = (0..POINTS).map(|i| length * i as f64 / (POINTS - 1) as f64);
    let mut at: Vec<(f64, DVec3)> = even.filter_map(|s| Some((s, curve.state(s)?.0))).collect();
    let doubled = (1..curve.s.len()).filter(|k| curve.s[*k] == curve.s[k - 1]);
    let doubled: Vec<usize> = doubled.take_while(|k| curve.s[*k] < length).collect();
    let sides = doubled.iter().flat_map(|k| [k - 1, *k]);
    at.extend(sides.map(|k| (curve.s[k], curve.u[k])));
    // Of equal lengths those on the two sides stay in order.
    at.sort_by(|a, b| a.0.total_cmp(&b.0));
    let is_doubled = |s: f64| doubled.iter().any(|k| curve.s[*k] == s);
    let jumps = (1..at.len()).filter(|i| {
        let [(s, a), (t, b)] = [at[i - 1], at[*i]];
        let periods = [a, b].map(|u| domain.wrap(u) - u);
        s == t && is_doubled(s) || periods[0].distance(periods[1]) > 1e-9 * b.length()
    });
    let jumps = jumps.collect();
    (
        at.iter().map(|(_, u)| domain.wrap(*u).to_array()).collect(),
        jumps,
    )
}

/// A table and what it promises.
#[derive(Debug, Clone)]
pub struct TablePromise {
    /// The table.
    pub table: Table,
    /// Its promise in mrad.
    pub mrad: f64,
    /// Its certificate, in words.
    pub certificate: Option<String>,
}

impl TablePromise {
    /// Takes it from a bundle.
    pub fn of(bundle: &Bundle) -> Self {
        let certificate = bundle.header.certificate.as_ref();
        Self {
            table: bundle.table.clone(),
            mrad: bundle.header.plan.max_error,
            certificate: certificate.map(|certificate| certificate.lines()),
        }
    }
}

/// A camera of a scene, as a viewer has it.
#[derive(Debug, Clone)]
pub struct SceneCamera {
    /// Its name; none of the main one.
    pub name: String,
    /// Where it is.
    pub pose: Pose,
    /// What the scene asks for there that a viewer does not do, in words.
    pub unshown: Option<String>,
}

/// A space to look around in.
#[derive(Debug, Clone)]
pub struct SessionSpace {
    /// The manifold.
    pub manifold: Arc<Manifold>,
    /// Its table, if there is one.
    pub table: Option<TablePromise>,
    /// The reason for which there will be none.
    pub no_table: Option<String>,
    /// The scene's cameras: the main one, then those with names.
    pub cameras: Vec<SceneCamera>,
    /// Arc length over which paths are followed.
    pub length: f64,
    /// Objects of the scene move, which a viewer does not show.
    pub objects_move: bool,
}

impl SessionSpace {
    /// Takes it from a scene.
    ///
    /// # Errors
    /// A camera of the scene is where none can be.
    pub fn new(
        scene: &SceneFile,
        manifold: &Arc<Manifold>,
        bundle: Option<&Bundle>,
        length: f64,
    ) -> Result<Self> {
        let objects_move = scene.objects.iter().any(|object| object.path.is_some());
        let exact = manifold.needs_exact_paths();
        let as_viewed = |entry: &CameraEntry| -> Result<SceneCamera> {
            let u = camera_point(manifold, &scene.source, entry)?;
            check_point(manifold, "the camera", u)?;
            let camera = Camera::looking(u, entry.look, entry.up);
            Ok(SceneCamera {
                name: entry.name.clone().unwrap_or_default(),
                pose: Pose::of(&camera, entry.fov_degrees),
                unshown: unshown(entry, objects_move),
            })
        };
        let cameras = std::iter::once(&scene.camera).chain(&scene.views);
        Ok(Self {
            manifold: manifold.clone(),
            table: bundle.filter(|_| !exact).map(TablePromise::of),
            no_table: exact.then(|| NO_TABLE_SERVES.into()),
            cameras: cameras.map(as_viewed).collect::<Result<_>>()?,
            length,
            objects_move,
        })
    }

    /// Gives the reason for which there will be no table, unless there is one, or a better reason.
    #[must_use]
    pub fn without_table(mut self, reason: Option<&str>) -> Self {
        if self.table.is_none() && self.no_table.is_none() {
            self.no_table = reason.map(String::from);
        }
        self
    }

    /// Returns the scene's main camera and its angle of view in a viewer.
    pub(crate) fn home(&self) -> (Camera, f64) {
        let home = self.cameras.first().map(|camera| camera.pose);
        let camera = home.and_then(|pose| Some((pose.camera()?, on_plane(pose.fov))));
        camera.unwrap_or((Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z), 90.0))
    }

    /// Tells whether the table knows all paths from `u`.
    pub(crate) fn knows(&self, u: DVec3) -> bool {
        let table = self.table.as_ref();
        table.is_some_and(|promise| promise.table.space.place(u).is_ok())
    }
}

/// Why a table does not serve a space of which all pictures are exact.
const NO_TABLE_SERVES: &str = "all pictures are exact: no table knows how paths go on at portals and mirrors, or leave a glued space";

/// Angles of view that zooming leads to, degrees: outside them a picture on a plane shows little that can be recognised.
const ZOOMED: [f64; 2] = [2.0, 150.0];

/// Angles of view that a picture on a plane can have, degrees.
const ON_PLANE: [f64; 2] = [1e-3, 179.9];

/// Returns the angle of view, degrees, that a picture on a plane has for one that is asked for, perhaps of a fisheye.
pub(crate) fn on_plane(fov: f64) -> f64 {
    match fov < 180.0 {
        true => fov.clamp(ON_PLANE[0], ON_PLANE[1]),
        false => ZOOMED[1],
    }
}

/// Returns `factor` times an angle of view, not farther beyond those of zooming than it is already.
pub(crate) fn zoomed(fov: f64, factor: f64) -> f64 {
    (fov * factor).clamp(fov.min(ZOOMED[0]), fov.max(ZOOMED[1]))
}

/// What a viewer, in which no time passes for the scene, shows as it is at the beginning.
pub(crate) const MOVING: &str = "objects of the scene move";

/// Says what `camera` asks for that a viewer's camera, which is the normal observer's and sees in perspective, does not do,
/// and that objects move.
fn unshown(camera: &CameraEntry, objects_move: bool) -> Option<String> {
    let moves = camera.motion != CameraMotion::Normal;
    let all = [
        (moves, "this camera of the scene has `rest` or `velocity`"),
        (
            camera.lens != Lens::default(),
            "this camera of the scene has `projection`, `stereo` or `crop`",
        ),
        (objects_move, MOVING),
    ];
    let told: Vec<&str> = all
        .iter()
        .filter(|(is, _)| *is)
        .map(|(_, what)| *what)
        .collect();
    (!told.is_empty()).then(|| not_shown(&told.join(", and ")))
}

/// Says of something that it is not done here.
pub(crate) fn not_shown(what: &str) -> String {
    format!("{what}, which `geofan render` shows and a viewer does not")
}
