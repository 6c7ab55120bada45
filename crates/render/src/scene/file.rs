//! The scene file: which manifold, where the cameras, objects and lights are, what the skies show.
//!
//! In: a TOML text in the fixed format of the scene file (see `assets/scenes`).
//! Out: [`SceneFile`], checked as far as the text alone allows; or a diagnostic with the place
//! underlined. Whether a position lies inside the manifold's chart is checked where both are known.
//!
//! Units: positions are chart coordinates, directions components in the standard frame at their
//! point, angles degrees, light linear.

use super::{
    Cuts, Points,
    lens::{LENS_KEYS, Lens, PLACE_KEYS, camera_entry},
    mesh::CREASE,
    named_table::{self, NamedTable, NamedValue, Span},
    trajectory::{CameraMotion, Formulas, Trajectory, trajectory},
};
use crate::sky::Pattern;
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::{Error, Result},
    reading::{self, read_text},
};
use glam::{DQuat, DVec3};
use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
    sync::Arc,
};

/// A scene as its file states it.
#[derive(Debug, Clone)]
pub struct SceneFile {
    /// The text, for complaints that arise later.
    pub source: Arc<SourceText>,
    /// The manifold file.
    pub manifold: PathBuf,
    /// Where `manifold` is named.
    pub manifold_span: Span,
    /// The main camera, from `[camera]`.
    pub camera: CameraEntry,
    /// Further named cameras, from `[[view]]`.
    pub views: Vec<CameraEntry>,
    /// Meshes and where they stand.
    pub objects: Vec<ObjectEntry>,
    /// Lights that have no shape.
    pub lights: Vec<LightEntry>,
    /// Set if light is to be weighed with what happens to its frequency on the way.
    pub redshift: bool,
    /// About how many points of all surfaces together the light of lamps is worked out at.
    pub light_points: usize,
    /// Where it is asked that light take the time of its way, so that objects that move are seen where they were when they
    /// sent it; `None` if all are seen where they are.
    pub delay: Option<Span>,
    /// Exit name, where it is named, and its sky, in the order of the file.
    pub skies: Vec<(String, Span, SkyEntry)>,
}

/// A camera.
#[derive(Debug, Clone)]
pub struct CameraEntry {
    /// The name of a `[[view]]`; none for `[camera]`.
    pub name: Option<String>,
    /// Where it is.
    pub position: CameraPosition,
    /// Where `position` is given.
    pub position_span: Span,
    /// Unit vector of the view, in the standard frame at the position.
    pub look: DVec3,
    /// Unit vector of the picture's upward direction, perpendicular to `look`.
    pub up: DVec3,
    /// Horizontal angle of view, degrees, in (0, 180); of a fisheye across its circle, up to 360.
    pub fov_degrees: f64,
    /// Projection, eyes and crop.
    pub lens: Lens,
    /// How it moves.
    pub motion: CameraMotion,
    /// Where `motion` is given.
    pub motion_span: Span,
}

/// The two ways to say where a camera is.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraPosition {
    /// Chart coordinates.
    Chart(DVec3),
    /// Values of the parameters that the manifold's `[cameras]` declares.
    Parameters(Vec<(String, f64)>),
}

/// A mesh placed in the manifold.
#[derive(Debug, Clone)]
pub struct ObjectEntry {
    /// The file of the mesh.
    pub mesh: PathBuf,
    /// Where `mesh` is named.
    pub mesh_span: Span,
    /// Chart coordinates of the mesh's origin; with a path, where that begins is filled in when it is placed.
    pub at: DVec3,
    /// Where `at` is given.
    pub at_span: Span,
    /// Length in the metric at `at` of the mesh's unit.
    pub scale: f64,
    /// Turn of the mesh in the standard frame.
    pub rotation: DQuat,
    /// The way in which mesh points become chart points.
    pub placement: Placement,
    /// Where it goes as time passes; `None` for what stands still.
    pub path: Option<Trajectory>,
    /// How its points move, `dx/dt` in chart components: what this does to the light that they send. The
    /// object stays where it is.
    pub velocity: Option<Formulas>,
    /// How hot it is, kelvin, if it glows as a black body.
    pub temperature: Option<Formulas>,
    /// Edges that turn by more than this are sharp where the mesh gives no normals, degrees.
    pub crease: f64,
    /// How its mesh is cut, where that is known from another time: it is then placed without a word about whether its
    /// placement suits it.
    pub cuts: Option<Arc<Cuts>>,
    /// The vertices of the mesh so cut, where they have been placed elsewhere.
    pub vertices: Option<Arc<Points>>,
    /// Where the entry stands.
    pub span: Span,
}

/// The map from a mesh point `Δx` to a chart point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Placement {
    /// `u0 + S R Δx`: right to first order, for small objects.
    #[default]
    Linear,
    /// `exp(S R Δx)` at `u0`: exact along rays from the origin, for larger objects.
    Exponential,
    /// `u0 + R Δx`: the mesh is a shape of the chart, whatever the metric.
    Chart,
}

/// A light without extent, equal in all directions.
#[derive(Debug, Clone)]
pub struct LightEntry {
    /// Chart coordinates.
    pub at: DVec3,
    /// Where `at` is given.
    pub at_span: Span,
    /// Linear red, green, blue per unit solid angle.
    pub intensity: [f32; 3],
}

/// The sky seen through an exit.
#[derive(Debug, Clone, PartialEq)]
pub enum SkyEntry {
    /// An equirectangular picture.
    Image(PathBuf),
    /// A built-in pattern.
    Pattern(Pattern),
}

const ROOT_KEYS: &[&str] = &[
    "manifold",
    "redshift",
    "delay",
    "light_points",
    "camera",
    "view",
    "object",
    "light",
    "sky",
];
const OBJECT_KEYS: &[&str] = &[
    "mesh",
    "at",
    "scale",
    "rotate",
    "placement",
    "crease",
    "velocity",
    "temperature",
    "path",
    "during",
    "turning",
];
const LIGHT_KEYS: &[&str] = &["kind", "at", "intensity"];
const AN_ARRAY_OF_TABLES: &str = "an array of tables, each under its own double-bracket header";

/// Refuses the file of a manifold, which has no `manifold` but `coordinates`.
fn refuse_manifold(root: &NamedTable<'_>) -> Result<()> {
    match (root.optional("manifold"), root.optional("coordinates")) {
        (None, Some(coordinates)) => Err(coordinates
            .complain("this is a manifold, not a scene".into())
            .with_hint("a scene names its manifold: manifold = \"…\"; `geofan view` shows manifolds without one")
            .into()),
        _ => Ok(()),
    }
}

impl SceneFile {
    /// Reads and checks the scene file at `path`; paths in it are relative to its folder.
    pub fn load(path: &Path) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let scene = Self::parse(read_text(path)?, folder)?;
        scene.check_files(&[])?;
        Ok(scene)
    }

    /// Refuses meshes and pictures that are neither on the disk nor `made` already, at the place where they are
    /// named.
    pub fn check_files(&self, made: &[PathBuf]) -> Result<()> {
        let meshes = self.objects.iter().map(|o| (&o.mesh, &o.mesh_span));
        let pictures = self.skies.iter().filter_map(|(_, span, sky)| match sky {
            SkyEntry::Image(path) => Some((path, span)),
            SkyEntry::Pattern(_) => None,
        });
        let mut missing = meshes.chain(pictures);
        let missing = missing.find(|(path, _)| !made.contains(path) && !reading::exists(path));
        let Some((path, span)) = missing else {
            return Ok(());
        };
        let message = format!("{}: no such file or folder", path.display());
        Err(Diagnostic::new(&self.source, span.clone(), message)
            .with_hint("paths are relative to the scene file")
            .into())
    }

    /// Checks the scene file `source`; paths in it are relative to `folder`.
    pub fn parse(source: Arc<SourceText>, folder: &Path) -> Result<Self> {
        let document = named_table::parse(&source)?;
        let root = NamedTable::root("the scene file", &source, &document);
        refuse_manifold(&root)?;
        root.allow_only(ROOT_KEYS)?;
        let manifold = root.required("manifold", "manifold = \"../manifolds/flat.toml\"")?;
        let scene = Self {
            manifold: folder.join(manifold.string()?),
            manifold_span: manifold.span(),
            camera: camera(&root)?,
            views: views(&root)?,
            objects: each(&root, "object", |t| object(&t, folder))?,
            lights: each(&root, "light", |t| light(&t))?,
            redshift: root.optional("redshift").map_or(Ok(false), |v| v.truth())?,
            light_points: light_points(&root)?,
            delay: delay(&root)?,
            skies: skies(&root, folder)?,
            source: source.clone(),
        };
        Ok(scene)
    }

    /// Tells whether any object moves.
    pub fn moves(&self) -> bool {
        self.objects.iter().any(|object| object.path.is_some())
    }

    /// The `[[view]]` named `name`.
    pub fn view(&self, name: &str) -> Option<&CameraEntry> {
        let called = |view: &&CameraEntry| view.name.as_deref() == Some(name);
        self.views.iter().find(called)
    }

    /// Returns the camera called `name`, or the main one.
    ///
    /// # Errors
    /// There is no such camera.
    pub fn camera_called(&self, name: Option<&str>) -> Result<&CameraEntry> {
        let Some(name) = name else {
            return Ok(&self.camera);
        };
        self.view(name).ok_or_else(|| {
            let known = self.views.iter().filter_map(|view| view.name.as_deref());
            let known = match known.collect::<Vec<&str>>() {
                known if known.is_empty() => "none".into(),
                known => known.join(", "),
            };
            let message = format!("the scene has no view `{name}`; it has: {known}");
            Error::input("--view", message)
        })
    }
}

/// Reads every table of the array of tables `key`.
pub(super) fn each<'a, T>(
    root: &NamedTable<'a>,
    key: &str,
    read: impl Fn(NamedTable<'a>) -> Result<T>,
) -> Result<Vec<T>> {
    let Some(array) = root.optional(key) else {
        return Ok(Vec::new());
    };
    let items = array.array(AN_ARRAY_OF_TABLES)?;
    let table = |v: NamedValue<'a>| read(v.table(format!("[[{key}]]"), "a table")?);
    items.into_iter().map(table).collect()
}

/// Points that the light of lamps is worked out at when the scene asks for no other number: on a floor that fills the picture
/// those that are spread evenly are four or five pixels of a thousand apart, and smaller things cast no shadow.
const USUAL_LIGHT_POINTS: usize = 40_000;

/// Numbers of points that a scene may ask for.
const LIGHT_POINTS: RangeInclusive<f64> = 1_000.0..=4_000_000.0;

fn light_points(root: &NamedTable) -> Result<usize> {
    let Some(value) = root.optional("light_points") else {
        return Ok(USUAL_LIGHT_POINTS);
    };
    match value.number()? {
        number if LIGHT_POINTS.contains(&number) && number.fract() == 0.0 => Ok(number as usize),
        _ => Err(value
            .complain("`light_points` is not a whole number from 1,000 to 4,000,000".to_owned())
            .with_hint("without it, there are 40,000")
            .into()),
    }
}

fn delay(root: &NamedTable) -> Result<Option<Span>> {
    let Some(delay) = root.optional("delay") else {
        return Ok(None);
    };
    Ok(delay.truth()?.then(|| delay.span()))
}

fn camera(root: &NamedTable) -> Result<CameraEntry> {
    let example = "[camera]` with `at = [3.0, 0.0, 0.0]";
    let value = root.required("camera", example)?;
    let table = value.table(String::from("[camera]"), "a table")?;
    table.allow_only(&[&PLACE_KEYS[..], &LENS_KEYS].concat())?;
    camera_entry(&table)
}

/// The `[[view]]`s, whose names must differ.
fn views<'a>(root: &NamedTable<'a>) -> Result<Vec<CameraEntry>> {
    let views = each(root, "view", |table: NamedTable<'a>| {
        table.allow_only(&[&["name"], &PLACE_KEYS[..], &LENS_KEYS].concat())?;
        let name = table.required("name", "name = \"near\"")?;
        let mut camera = camera_entry(&table)?;
        camera.name = Some(name.string()?.to_owned());
        Ok((camera, name.span(), table))
    })?;
    for (i, (camera, span, table)) in views.iter().enumerate() {
        if views[..i]
            .iter()
            .any(|(other, ..)| other.name == camera.name)
        {
            let mut twice = table.complain(String::from("two views have the same name"));
            twice.span = span.clone();
            return Err(twice.with_label("taken by an earlier view").into());
        }
    }
    Ok(views.into_iter().map(|(camera, ..)| camera).collect())
}

/// `at` or `parameters`, exactly one.
pub(super) fn position(table: &NamedTable) -> Result<(CameraPosition, Span)> {
    let hint = "give either `at = [x, y, z]` or `parameters = { c = 3.0 }`";
    match (table.optional("at"), table.optional("parameters")) {
        (Some(at), None) => Ok((CameraPosition::Chart(at.vector()?), at.span())),
        (None, Some(value)) => {
            let given = value.table(String::from("parameters"), "a table such as { c = 3.0 }")?;
            let number = |(name, _, value): (String, Span, NamedValue)| Ok((name, value.number()?));
            let values = given.entries().map(number).collect::<Result<_>>()?;
            Ok((CameraPosition::Parameters(values), value.span()))
        }
        (Some(_), Some(second)) => Err(second
            .complain(String::from("a camera has both `at` and `parameters`"))
            .with_label("the position is given twice")
            .with_hint(hint)
            .into()),
        (None, None) => Err(table
            .complain(String::from("a camera has neither `at` nor `parameters`"))
            .with_label("no position")
            .with_hint(hint)
            .into()),
    }
}

fn object(table: &NamedTable, folder: &Path) -> Result<ObjectEntry> {
    table.allow_only(OBJECT_KEYS)?;
    let mesh = table.required("mesh", "mesh = \"../meshes/teapot.obj\"")?;
    let path = trajectory(table, folder)?;
    let (at, at_span) = object_place(table, path.as_ref())?;
    let placements = [
        ("linear", Placement::Linear),
        ("exponential", Placement::Exponential),
        ("chart", Placement::Chart),
    ];
    let placement = table.optional("placement").map(|v| v.choice(&placements));
    Ok(ObjectEntry {
        mesh: folder.join(mesh.string()?),
        mesh_span: mesh.span(),
        at,
        at_span,
        path,
        scale: table.optional("scale").map_or(Ok(1.0), |v| scale(&v))?,
        rotation: table
            .optional("rotate")
            .map_or(Ok(DQuat::IDENTITY), |v| rotation(&v))?,
        placement: placement.transpose()?.unwrap_or_default(),
        velocity: table
            .optional("velocity")
            .map(|v| Formulas::three(&v))
            .transpose()?,
        temperature: table
            .optional("temperature")
            .map(|v| Formulas::one(&v))
            .transpose()?,
        crease: table
            .optional("crease")
            .map_or(Ok(CREASE), |v| crease(&v))?,
        cuts: None,
        vertices: None,
        span: table.span(),
    })
}

/// `at`, which an object with a path does not have.
fn object_place(table: &NamedTable, path: Option<&Trajectory>) -> Result<(DVec3, Span)> {
    match (path, table.optional("at")) {
        (None, _) => {
            let at = table.required("at", "at = [0.0, 0.0, 0.0]")?;
            Ok((at.vector()?, at.span()))
        }
        (Some(path), None) => Ok((DVec3::ZERO, path.span.clone())),
        (Some(_), Some(at)) => Err(at
            .complain(String::from("an object has both `at` and `path`"))
            .with_label("the path says where it is")
            .with_hint("take `at` away")
            .into()),
    }
}

fn scale(value: &NamedValue) -> Result<f64> {
    let scale = value.number()?;
    if scale > 0.0 {
        return Ok(scale);
    }
    Err(value
        .complain(String::from("`scale` must be greater than 0"))
        .with_label("would leave nothing to see, or turn the mesh inside out")
        .into())
}

fn crease(value: &NamedValue) -> Result<f64> {
    let degrees = value.number()?;
    if (0.0..=180.0).contains(&degrees) {
        return Ok(degrees);
    }
    Err(value
        .complain(String::from("`crease` must lie between 0 and 180 degrees"))
        .with_label("the angle between neighbouring faces above which an edge is sharp")
        .with_hint("30 is usual, 0 shows every face flat, 180 smooths everything")
        .into())
}

fn rotation(value: &NamedValue) -> Result<DQuat> {
    let expected = "a table such as { axis = [0, 0, 1], degrees = 30 }";
    let table = value.table(String::from("rotate"), expected)?;
    table.allow_only(&["axis", "degrees"])?;
    let axis = table.required("axis", "axis = [0, 0, 1]")?.direction()?;
    let degrees = table.required("degrees", "degrees = 30")?.number()?;
    Ok(DQuat::from_axis_angle(axis, degrees.to_radians()))
}

fn light(table: &NamedTable) -> Result<LightEntry> {
    table.allow_only(LIGHT_KEYS)?;
    let kind = table.required("kind", "kind = \"point\"")?;
    let at = table.required("at", "at = [0.0, 2.0, 0.0]")?;
    kind.choice(&[("point", ())])?;
    Ok(LightEntry {
        at: at.vector()?,
        at_span: at.span(),
        intensity: table
            .required("intensity", "intensity = [10, 10, 10]")?
            .light()?,
    })
}

fn skies(root: &NamedTable, folder: &Path) -> Result<Vec<(String, Span, SkyEntry)>> {
    let Some(value) = root.optional("sky") else {
        return Ok(Vec::new());
    };
    let table = value.table(String::from("[sky]"), "a table of exit names")?;
    let read =
        |(name, span, value): (String, Span, NamedValue)| Ok((name, span, sky(&value, folder)?));
    table.entries().map(read).collect()
}

/// `{ image = … }`, `{ pattern = … }` or `{ color = … }`; a colour may also stand under `pattern`.
fn sky(value: &NamedValue, folder: &Path) -> Result<SkyEntry> {
    let table = value.table(
        String::from("a sky"),
        "a table under the name of an exit, such as NAME = { pattern = \"grid\" }",
    )?;
    table.allow_only(&["image", "pattern", "color"])?;
    let mut given: Vec<(String, Span, NamedValue)> = table.entries().collect();
    let (Some((key, _, value)), true) = (given.pop(), given.is_empty()) else {
        return Err(table
            .complain(String::from(
                "a sky needs exactly one of `image`, `pattern`, `color`",
            ))
            .with_label("what is seen through this exit")
            .with_hint(
                "write { image = \"sky.png\" }, { pattern = \"stars\" } or { color = [0, 0, 0] }",
            )
            .into());
    };
    match key.as_str() {
        "image" => Ok(SkyEntry::Image(folder.join(value.string()?))),
        "color" => Ok(SkyEntry::Pattern(Pattern::Colour(value.light()?))),
        _ => Ok(SkyEntry::Pattern(pattern(&value)?)),
    }
}

fn pattern(value: &NamedValue) -> Result<Pattern> {
    if value.is_string() {
        return value.choice(&[("grid", Pattern::Grid), ("stars", Pattern::Stars)]);
    }
    let expected = "\"grid\", \"stars\" or { color = [r, g, b] }";
    let table = value.table(String::from("pattern"), expected)?;
    table.allow_only(&["color"])?;
    let colour = table.required("color", "color = [0.1, 0.1, 0.2]")?;
    Ok(Pattern::Colour(colour.light()?))
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
