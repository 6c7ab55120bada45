//! A scene with everything it names, ready for pictures.
//!
//! In: the path of a scene file, and settings of its manifold. Out: a [`Stage`]: the file and its [`World`], and the
//! views of its cameras; and a warning for each exit without a `direction` of its own that rays from a camera leave
//! through where the chart is far from Cartesian: its sky is looked up by components of the tangent that are no
//! directions.

use super::{
    camera_place::{camera_point, camera_velocity},
    panels::{Part, PicturePanels},
    scene::{CameraEntry, SceneFile},
    view::View,
    world::World,
};
use geofan_bundle::{
    Bundle, Contents, Table,
    container::{MAGIC, MOST_BYTES},
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    geodesic::{self, End, Ray, Settings, check_point, paths},
    manifold::{Form, Manifold},
    reading::read_file,
};
use glam::{DMat3, DVec3};
use std::{path::Path, sync::Arc};

/// Loads the manifold of a file, which may be a bundle: it has the text of its manifold in it.
///
/// # Errors
/// The file cannot be read, or is no manifold and no bundle.
pub fn load_manifold(path: &Path, settings: &[(String, f64)]) -> Result<Manifold> {
    // Of another file this reads the first bytes only.
    match read_file(path, MAGIC, MOST_BYTES) {
        Ok(bytes) if bytes.starts_with(MAGIC) => {
            let name = path.display().to_string();
            let contents = Contents::decode(&name, &bytes).map_err(|e| e.about(path))?;
            contents.manifold_with(&name, settings)
        }
        _ => Manifold::load(path, settings),
    }
}

/// A scene with everything it names.
pub struct Stage {
    /// The file.
    pub scene: SceneFile,
    /// Everything that can be seen.
    pub world: World,
}

impl Stage {
    /// Loads the scene at `path` as it is at the time 0; `settings` replace parameters of its manifold.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(path: &Path, settings: &[(String, f64)]) -> Result<Self> {
        Self::of_scene(SceneFile::load(path)?, settings, 0.0, None)
    }

    /// Loads all that `scene` names, as it is at `time`; `settings` replace parameters of its manifold. Meshes are there as far
    /// as paths of its length go, or of `length`, if they are followed so far.
    ///
    /// # Errors
    /// As [`Stage::load`].
    pub fn of_scene(
        scene: SceneFile,
        settings: &[(String, f64)],
        time: f64,
        length: Option<f64>,
    ) -> Result<Self> {
        let mut manifold = load_manifold(&scene.manifold, settings).map_err(|e| match e {
            // A missing file is the scene's fault, and the scene says where it is named.
            Error::Input { message, .. } if !scene.manifold.exists() => Diagnostic::new(
                &scene.source,
                scene.manifold_span.clone(),
                format!("{}: {message}", scene.manifold.display()),
            )
            .with_hint("paths are relative to the scene file")
            .into(),
            other => other,
        })?;
        manifold.length = manifold.length.map(|own| own.max(length.unwrap_or(own)));
        let mut world = World::new(&scene, Arc::new(manifold), time)?;
        // In a page nobody is told; whoever made it was.
        if !cfg!(target_family = "wasm")
            && let Ok(u) = camera_point(&world.manifold, &scene.source, &scene.camera)
        {
            world.warnings.extend(sky_warnings(&world, u));
        }
        Ok(Self { scene, world })
    }

    /// Moves objects to where they are at `time`.
    ///
    /// # Errors
    /// As [`World::set_time`].
    pub fn set_time(&mut self, time: f64) -> Result<()> {
        self.world.set_time(&self.scene, time)
    }

    /// Returns the camera called `name`, or the main one.
    ///
    /// # Errors
    /// There is no such camera.
    pub fn camera(&self, name: Option<&str>) -> Result<&CameraEntry> {
        self.scene.camera_called(name)
    }

    /// Refuses a bundle that was baked from another manifold than the scene's.
    ///
    /// # Errors
    /// Says what differs.
    pub fn check_bundle(&self, bundle: &Bundle) -> Result<()> {
        let own = &self.world.manifold;
        let differences = own.differences_of_covers(&bundle.manifold);
        if differences.is_empty() {
            return Ok(());
        }
        let message = format!(
            "it was baked from another manifold (`{}`) than the scene's (`{}`): {} (the scene's first); bake again, or give the same --set",
            bundle.manifold.name,
            self.world.manifold.name,
            differences.join(", ")
        );
        Err(Error::input("--bundle", message))
    }

    /// Refuses a camera of this scene of which a view is outside of the region that `table` knows; where each ray has a
    /// place of its own, only the camera's counts.
    ///
    /// # Errors
    /// Says where, at the camera's place in the scene.
    pub fn check_region<'v>(
        &self,
        table: &Table,
        camera: &CameraEntry,
        views: impl IntoIterator<Item = &'v View>,
    ) -> Result<()> {
        let source = &self.scene.source;
        let own = camera_point(&self.world.manifold, source, camera)?;
        for view in views {
            let Err(fault) = table.space.place(view.u) else {
                continue;
            };
            let complaint =
                Diagnostic::new(source, camera.position_span.clone(), fault.to_string());
            let complaint = match (view.u - own).length() > 0.0 && camera.lens.stereo.is_some() {
                true => complaint.with_label("an eye of its `stereo` pair"),
                false => complaint,
            };
            return Err(complaint
                .with_hint("draw it with --tracer exact, move the camera, or bake a larger region (`[cameras]` in the manifold file)")
                .into());
        }
        Ok(())
    }

    /// Returns the view of the camera called `name`, or of the main one, where a path can start.
    ///
    /// # Errors
    /// There is no such camera, or it is where the metric breaks down, of which the domain need not tell.
    pub fn view_of(&self, name: Option<&str>, size: (usize, usize)) -> Result<View> {
        let camera = self.camera(name)?;
        let view = self.view(camera, size)?;
        match check_point(&self.world.manifold, "the camera", view.u) {
            Err(fault) => {
                let (source, span) = (&self.scene.source, camera.position_span.clone());
                Err(Diagnostic::new(source, span, fault.to_string()).into())
            }
            Ok(()) => Ok(view),
        }
    }

    /// Returns the view of a camera of this scene.
    ///
    /// # Errors
    /// The camera is outside the domain, or draws several pictures.
    pub fn view(&self, camera: &CameraEntry, size: (usize, usize)) -> Result<View> {
        self.panels(camera, size, None)?.single()
    }

    /// Returns the parts of the picture of a camera of this scene; of `crop` alone, if there is one.
    ///
    /// # Errors
    /// The camera is outside the domain, or the picture cannot be divided as its lens asks.
    pub fn panels(
        &self,
        camera: &CameraEntry,
        size: (usize, usize),
        crop: Option<Part>,
    ) -> Result<PicturePanels> {
        let u = camera_point(&self.world.manifold, &self.scene.source, camera)?;
        let velocity = camera_velocity(&self.world.manifold, &self.scene.source, camera, u)?;
        let panels = PicturePanels::new(&self.world.manifold, (camera, u), size, crop)?;
        Ok(panels.with_velocity(velocity))
    }
}

/// A unit step along one coordinate may be so many times longer than along another before the components of
/// a tangent are taken for no direction. Asymptotically flat charts that are far enough out stay below 1.2;
/// polar ones are beyond a radius of 10.
const MOST_STRETCHED: f64 = 10.0;

/// Local tolerance of the rays: they only tell where exits are.
const TOLERANCE: f64 = 1e-4;

/// Warns of exits whose sky a scene seen from `u` would look up by components that are no directions.
pub(crate) fn sky_warnings(world: &World, u: DVec3) -> Vec<String> {
    let manifold = &*world.manifold;
    // Axes of textbook coordinates stretch nothing: the chart is another.
    if manifold.form == Form::Embedding || manifold.is_pulled_back() {
        return Vec::new();
    }
    let mut warned = vec![false; manifold.exits.len()];
    let mut warnings = Vec::new();
    for (exit, at) in ends(manifold, u) {
        let stretch = stretch(manifold.metric(at));
        let is_right = world.skies[exit].is_none() || manifold.exits[exit].has_direction();
        if warned[exit] || is_right || !(stretch > MOST_STRETCHED) {
            continue;
        }
        warned[exit] = true;
        warnings.push(told(manifold, exit, stretch));
    }
    warnings
}

/// Finds exits and the points at which rays from `u`, along all axes and diagonals, leave through them.
fn ends(manifold: &Manifold, u: DVec3) -> Vec<(usize, DVec3)> {
    let Ok(length) = manifold.length_or(None) else {
        return Vec::new();
    };
    let sides = [-1.0, 0.0, 1.0];
    let directions = sides.iter().flat_map(|x| {
        let rest = sides
            .iter()
            .flat_map(|y| sides.iter().map(move |z| (*y, *z)));
        rest.map(|(y, z)| DVec3::new(*x, y, z))
    });
    let rays = directions.filter_map(|d| Some(Ray::new(manifold, u, d.try_normalize()?, length)));
    let settings = Settings::bare(TOLERANCE).with_events();
    let end = |path: geodesic::Path| match path.end {
        End::Exit(exit) => Some((exit, path.steps.last()?.position(path.length))),
        _ => None,
    };
    paths(manifold, settings, rays)
        .into_iter()
        .filter_map(end)
        .collect()
}

/// Returns how many times longer a unit step along one coordinate is than along another.
fn stretch(g: DMat3) -> f64 {
    let lengths = [g.x_axis.x, g.y_axis.y, g.z_axis.z].map(f64::sqrt);
    let [least, most] = [f64::min, f64::max].map(|of| lengths.into_iter().reduce(of));
    most.unwrap_or(1.0) / least.unwrap_or(1.0)
}

/// Words the warning.
fn told(manifold: &Manifold, exit: usize, stretch: f64) -> String {
    let (name, [r, t, f]) = (&manifold.exits[exit].name, &manifold.coordinates);
    format!(
        "the sky of the exit `{name}` is looked up by the components of the tangent along {r}, {t}, {f}, and there a step along one of them is {stretch:.0} times as long as along another, so they are no direction. Give the exit its `direction`: if {r}, {t}, {f} are a radius, the angle to an axis and the angle about it, `direction = [\"v{r}*sin({t})*cos({f}) + {r}*(v{t}*cos({t})*cos({f}) - v{f}*sin({t})*sin({f}))\", \"v{r}*sin({t})*sin({f}) + {r}*(v{t}*cos({t})*sin({f}) + v{f}*sin({t})*cos({f}))\", \"v{r}*cos({t}) - {r}*v{t}*sin({t})\"]`; or write the space in Cartesian coordinates with [pullback]"
    )
}
