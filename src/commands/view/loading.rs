//! The space that all viewers of this process share: loaded, watched, loaded again.
//!
//! In: the paths of a scene or manifold file and perhaps of a bundle. Out: a [`LoadedSpace`], which stays as it
//! is; in its place a new one when a file or a parameter changes. A change that cannot work leaves the last good
//! one and becomes a text with the source line.

use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    manifold::Manifold,
    reading::{FileSource, read_text, with_source},
};
use geofan_light::cache;
use geofan_render::Stage;
use geofan_view::{DrawSpace, SessionSpace, StartScene, noting_source};
use std::{
    fs,
    path::{Path, PathBuf},
    rc::Rc,
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, SystemTime},
};

/// Where a space comes from.
#[derive(Debug, Clone)]
pub struct SpaceSource {
    /// The scene file, or a manifold file.
    pub file: PathBuf,
    /// The bundle.
    pub bundle: Option<PathBuf>,
    /// Arc length over which exact paths are followed, if the user says.
    pub length: Option<f64>,
}

/// A space in memory.
pub struct LoadedSpace {
    /// Draws it.
    pub draw: DrawSpace,
    /// Tells sessions of it.
    pub session: SessionSpace,
    /// The scene's path, which for a bare manifold is on no disk.
    pub scene: PathBuf,
    /// The files that are on no disk.
    pub made: Vec<(PathBuf, Vec<u8>)>,
    /// All files that were read for it.
    pub files: Vec<PathBuf>,
}

/// Arc length over which paths are followed where nothing says so.
const LENGTH: f64 = 10.0;

/// Local tolerance of the light's geodesics, as for `geofan render`.
const LIGHT_TOLERANCE: f64 = 1e-6;

/// Name of the scene that is made for a bare manifold.
const START_SCENE: &str = "geofan-start-scene.toml";

impl SpaceSource {
    /// Loads the space with these parameters of its manifold. A `table` stands in for the bundle's file.
    ///
    /// # Errors
    /// Whatever is wrong with any of its files.
    pub fn load(&self, settings: &[(String, f64)], table: Option<Bundle>) -> Result<LoadedSpace> {
        let (noting, noted) = noting_source();
        let made = self.start_scene(settings, &noting)?;
        let scene = made.first().map_or(&self.file, |(path, _)| path).clone();
        let known = made.clone();
        let source: FileSource = Rc::new(move |path: &Path| {
            let found = known.iter().find(|(name, _)| name == path);
            found
                .map(|(_, bytes)| bytes.clone())
                .or_else(|| noting(path))
        });
        let mut stage = with_source(source, || Stage::load(&scene, settings))?;
        let bundle = match (table, &self.bundle) {
            (Some(table), _) => Some(table),
            (None, Some(path)) => Some(Bundle::read(path)?),
            (None, None) => None,
        };
        let manifold = stage.world.manifold.clone();
        let bundle =
            bundle.filter(|b| manifold.cover().differences(&b.manifold.cover()).is_empty());
        let length = self.length.or(manifold.length).unwrap_or(LENGTH);
        let followed = bundle.as_ref().map_or(length, |b| b.table.length);
        light_up(&mut stage, followed, self.bundle.as_deref())?;
        let session = SessionSpace::new(&stage.scene, &manifold, bundle.as_ref(), length)?;
        let mut files = noted.borrow().clone();
        files.extend(self.bundle.clone());
        Ok(LoadedSpace {
            draw: DrawSpace::new(stage, bundle, length),
            session,
            scene,
            made,
            files,
        })
    }

    /// Makes the files of a first scene, the scene's first, if the file is a manifold's; else none.
    fn start_scene(
        &self,
        settings: &[(String, f64)],
        noting: &FileSource,
    ) -> Result<Vec<(PathBuf, Vec<u8>)>> {
        let text = with_source(noting.clone(), || read_text(&self.file))?;
        if !StartScene::is_manifold(&text.text) {
            return Ok(Vec::new());
        }
        let manifold = Manifold::from_source(text, settings)?;
        let length = self.length.or(manifold.length).unwrap_or(LENGTH);
        let name = self.file.file_name().unwrap_or_default().to_string_lossy();
        let scene = StartScene::new(&manifold, &name, length)?;
        let folder = self.file.parent().unwrap_or(Path::new(""));
        let all = [(START_SCENE.to_string(), scene.text)]
            .into_iter()
            .chain(scene.files);
        Ok(all
            .map(|(name, text)| (folder.join(name), text.into_bytes()))
            .collect())
    }
}

/// Puts the light of the scene's point lights on its surfaces, kept beside the bundle.
fn light_up(stage: &mut Stage, length: f64, bundle: Option<&Path>) -> Result<()> {
    if stage.world.lights.is_empty() || stage.world.faces.is_empty() {
        return Ok(());
    }
    let path = bundle.map(|bundle| {
        let mut name = bundle.as_os_str().to_owned();
        name.push(".light");
        PathBuf::from(name)
    });
    let world = &stage.world;
    let (light, _) = cache::light(world, length, LIGHT_TOLERANCE, path.as_deref(), |_, _| {})?;
    stage.world.light = Some(light);
    Ok(())
}

/// The present space, as viewers see it.
struct SpaceState {
    loaded: Arc<LoadedSpace>,
    /// Counts the spaces.
    version: u64,
    settings: Vec<(String, f64)>,
    /// A bundle that was baked or found in the cache.
    table: Option<Bundle>,
    trouble: Option<String>,
    background: Option<String>,
    reload: bool,
}

/// The space that all viewers share.
pub struct SharedSpace {
    source: SpaceSource,
    state: Mutex<SpaceState>,
    ended: AtomicBool,
}

/// Seconds between two looks at the files.
const LOOK: Duration = Duration::from_millis(200);

/// Seconds between two looks at whether a parameter has changed.
const BEAT: Duration = Duration::from_millis(20);

/// A viewer's knowledge of the space: its version, the space, the trouble and the work behind.
pub type PresentSpace = (u64, Arc<LoadedSpace>, Option<String>, Option<String>);

impl SharedSpace {
    /// Loads the space.
    ///
    /// # Errors
    /// As [`SpaceSource::load`]; also if the bundle is of another manifold.
    pub fn open(source: SpaceSource, settings: Vec<(String, f64)>) -> Result<Arc<Self>> {
        let loaded = source.load(&settings, None)?;
        if source.bundle.is_some() && loaded.draw.bundle().is_none() {
            let message = "it was baked from another manifold than the scene's; bake again, or give the same --set";
            return Err(Error::input("--bundle", message));
        }
        for warning in &loaded.draw.stage.world.warnings {
            tracing::warn!("{warning}");
        }
        Ok(Arc::new(Self {
            source,
            state: Mutex::new(SpaceState {
                loaded: Arc::new(loaded),
                version: 1,
                settings,
                table: None,
                trouble: None,
                background: None,
                reload: false,
            }),
            ended: AtomicBool::new(false),
        }))
    }

    fn state(&self) -> MutexGuard<'_, SpaceState> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Returns the present space.
    pub fn present(&self) -> PresentSpace {
        let state = self.state();
        let (trouble, background) = (state.trouble.clone(), state.background.clone());
        (state.version, state.loaded.clone(), trouble, background)
    }

    /// Asks for the space with another value of a parameter.
    pub fn set_parameter(&self, name: &str, value: f64) {
        let mut state = self.state();
        let known = state.loaded.session.manifold.parameters.iter();
        if value.is_finite() && known.clone().any(|(known, _)| known == name) {
            state.settings.retain(|(known, _)| known != name);
            state.settings.push((name.into(), value));
            state.reload = true;
        }
    }

    /// Gives the space a table, if it is still that space.
    pub fn set_table(&self, bundle: Bundle) {
        let mut state = self.state();
        state.table = Some(bundle);
        state.reload = true;
    }

    /// Says what goes on behind.
    pub fn set_background(&self, text: Option<String>) {
        self.state().background = text;
    }

    /// Ends all that watches and bakes.
    pub fn end(&self) {
        self.ended.store(true, Ordering::Relaxed);
    }

    /// Tells whether the viewer ends.
    pub fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    /// Loads the space again whenever a file or a parameter has changed, until the viewer ends.
    pub fn watch(&self) {
        let mut known = times(&self.present().1.files);
        let mut since_look = Duration::ZERO;
        while !self.has_ended() {
            std::thread::sleep(BEAT);
            since_look += BEAT;
            let mut reload = std::mem::take(&mut self.state().reload);
            if since_look >= LOOK {
                since_look = Duration::ZERO;
                let now = times(&self.present().1.files);
                reload |= now != known;
                known = now;
            }
            if reload {
                self.reload();
                known = times(&self.present().1.files);
            }
        }
    }

    /// Loads the space again; the last good one stays if that fails.
    fn reload(&self) {
        let (settings, table) = {
            let state = self.state();
            (state.settings.clone(), state.table.clone())
        };
        let loaded = self.source.load(&settings, table);
        let mut state = self.state();
        match loaded {
            Ok(loaded) => {
                state.loaded = Arc::new(loaded);
                state.version += 1;
                state.trouble = None;
            }
            Err(error) => state.trouble = Some(error.report(false)),
        }
    }
}

/// Returns when files were last changed, and their lengths.
fn times(files: &[PathBuf]) -> Vec<Option<(SystemTime, u64)>> {
    let time = |path: &PathBuf| {
        let about = fs::metadata(path).ok()?;
        Some((about.modified().ok()?, about.len()))
    };
    files.iter().map(time).collect()
}
