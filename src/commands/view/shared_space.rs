//! The space that all viewers of this process share: loaded, watched, loaded again, and worked on behind.
//!
//! In: where it comes from. Out: a [`ViewedSpace`], which stays as it is but for its skies; in its place a new one when a
//! file or a parameter changes. A change that cannot work leaves the last good one and becomes a text with the source line.
//!
//! Behind, while somebody looks around already, a table is baked into the user's cache, under the manifold's identity,
//! and from then on is in the space; and it is decoded ahead of the cameras. A space that changes ends the bake of the
//! one before; what was done is kept and gone on with when that space comes back. Half of the threads bake: the picture
//! comes first.

use crate::user_cache::{self, with_kept_results};
use geofan_bake::{BakeOptions, BakeResult, bake};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Observer, Progress, Result,
    files::make_output_folder,
    manifold::Manifold,
    reading::{noting, read_text},
};
use geofan_view::{
    Answer, DrawSpace, LoadedSpace, SessionSpace, SkyChoice, SpaceSource, Work, bundle_of_another,
};
use std::{
    collections::VecDeque,
    fs, io,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, RwLock,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, SystemTime},
};

/// A loaded space, whose skies can be changed.
pub struct ViewedSpace {
    /// What sessions are told.
    pub session: SessionSpace,
    draw: RwLock<DrawSpace>,
    /// The user's own bundle draws it: no table is baked for it.
    has_own_bundle: bool,
    /// All files that were read for it.
    files: Vec<PathBuf>,
    /// What is doubtful about the scene.
    warnings: Vec<String>,
}

impl ViewedSpace {
    /// Takes over what was loaded, with these skies, and perhaps a reason for which it will have no table. Logs what is
    /// doubtful about it, but for what was `warned` of before.
    fn new(
        loaded: LoadedSpace,
        no_table: Option<&str>,
        sky: SkyChoice,
        warned: &[String],
    ) -> Arc<Self> {
        let warnings: Vec<String> = loaded.warnings().map(String::from).collect();
        for warning in warnings.iter().filter(|warning| !warned.contains(warning)) {
            tracing::warn!("{warning}");
        }
        let mut draw = loaded.draw;
        draw.dress(sky);
        Arc::new(Self {
            has_own_bundle: loaded.has_own_bundle,
            draw: RwLock::new(draw),
            session: loaded.session.without_table(no_table),
            files: loaded.files,
            warnings,
        })
    }

    /// Refuses what was loaded in its place if the user's bundle has become another manifold's meanwhile. Where the
    /// manifold has become another one, a table that is baked stands in for the bundle.
    fn with_bundle_kept(&self, loaded: LoadedSpace) -> Result<LoadedSpace> {
        let lost = self.has_own_bundle && !loaded.has_own_bundle;
        let (before, now) = (&self.session.manifold, &loaded.session.manifold);
        match lost && now.differences_of_covers(before).is_empty() {
            true => Err(bundle_of_another()),
            false => Ok(loaded),
        }
    }

    /// Does `work`.
    pub fn answer(&self, work: &Work) -> Answer {
        let draw = self.draw.read().unwrap_or_else(PoisonError::into_inner);
        draw.answer(work)
    }
}

/// The present space, as viewers see it.
struct SpaceState {
    loaded: Arc<ViewedSpace>,
    /// Counts the spaces.
    version: u64,
    /// Parameters that are asked for, and those of the space.
    settings: Vec<(String, f64)>,
    loaded_settings: Vec<(String, f64)>,
    sky: SkyChoice,
    /// A bundle that was baked or found in the cache, under its name there: it draws a space of the same geometry, also
    /// while that space's own is baked, for other cameras or another length.
    table: Option<(String, Bundle)>,
    trouble: Option<String>,
    background: Option<String>,
    reload: bool,
    /// The space is being loaded again.
    loading: bool,
    /// Chunks of the table to be decoded: the version of the space, and the number. Viewers ask while there is none; two
    /// that do so at once both get what they asked for, because neither asks again.
    sections: VecDeque<(u64, usize)>,
    /// Somebody decodes one.
    decoding: bool,
}

/// The space that all viewers share.
pub struct SharedSpace {
    source: SpaceSource,
    /// The parameters that the command gives.
    given: Vec<(String, f64)>,
    /// When loading began.
    opened: SystemTime,
    /// The reason for which no table is baked.
    no_table: Option<&'static str>,
    state: Mutex<SpaceState>,
    ended: AtomicBool,
}

/// Time between two checks of the dates of the files.
const LOOK: Duration = Duration::from_millis(200);

/// Time between two checks of whether a parameter has changed.
const BEAT: Duration = Duration::from_millis(20);

/// A viewer's knowledge of the space.
pub struct PresentSpace {
    /// Its version.
    pub version: u64,
    /// The space.
    pub loaded: Arc<ViewedSpace>,
    /// A mistake in a file.
    pub trouble: Option<String>,
    /// Work behind.
    pub background: Option<String>,
    /// The skies that are asked for.
    pub sky: SkyChoice,
    /// Names of the parameters whose values viewers chose, for the address of every one.
    pub chosen: Vec<String>,
}

impl SharedSpace {
    /// Loads the space; no table is baked for it if there is a reason for that.
    ///
    /// # Errors
    /// As [`SpaceSource::load_with_bundle`].
    pub fn open(
        source: SpaceSource,
        settings: Vec<(String, f64)>,
        no_table: Option<&'static str>,
    ) -> Result<Arc<Self>> {
        let opened = SystemTime::now();
        let loaded = source.load_with_bundle(&settings)?;
        Ok(Arc::new(Self {
            source,
            given: settings.clone(),
            opened,
            no_table,
            state: Mutex::new(SpaceState {
                loaded: ViewedSpace::new(loaded, no_table, SkyChoice::Scene, &[]),
                version: 1,
                loaded_settings: settings.clone(),
                settings,
                sky: SkyChoice::Scene,
                table: None,
                trouble: None,
                background: None,
                reload: false,
                loading: false,
                sections: VecDeque::new(),
                decoding: false,
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
        PresentSpace {
            version: state.version,
            loaded: state.loaded.clone(),
            trouble: state.trouble.clone(),
            background: state.background.clone(),
            sky: state.sky,
            chosen: state.chosen(&self.given),
        }
    }

    /// Tells whether another space is to come: asked before [`Self::present`], no means that this is the newest.
    pub fn is_loading(&self) -> bool {
        let state = self.state();
        state.reload || state.loading
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

    /// Shows other skies.
    pub fn set_sky(&self, sky: SkyChoice) {
        loop {
            // Sessions learn of them when they are there, so that none draws others for them. The blocks that are being drawn
            // are waited for.
            let space = self.state().loaded.clone();
            let mut draw = space.draw.write().unwrap_or_else(PoisonError::into_inner);
            draw.dress(sky);
            let mut state = self.state();
            state.sky = sky;
            // A space that has come meanwhile has the skies before.
            if Arc::ptr_eq(&state.loaded, &space) {
                return;
            }
        }
    }

    /// Gives the space a table, which has this name in the cache, if it is still that space.
    fn set_table(&self, name: String, bundle: Bundle) {
        let mut state = self.state();
        state.table = Some((name, bundle));
        state.reload = true;
    }

    /// Tells whether a space waits for the table that has this name in the cache.
    fn lacks_table(&self, loaded: &ViewedSpace, name: &str) -> bool {
        let state = self.state();
        let known = state.table.as_ref().is_some_and(|(known, _)| known == name);
        !(loaded.has_own_bundle || known || loaded.session.no_table.is_some())
    }

    /// Tells whether another section of the table could be decoded behind.
    pub fn wants_section(&self) -> bool {
        let state = self.state();
        state.sections.is_empty() && !state.decoding
    }

    /// Asks for a section of the table to be decoded, in the space of this version.
    pub fn set_section(&self, version: u64, section: usize) {
        self.state().sections.push_back((version, section));
    }

    /// Decodes the section that was asked for, if there is one. Tells whether there was.
    fn decode_section(&self) -> bool {
        let (loaded, asked) = {
            let mut state = self.state();
            let Some((version, section)) = state.sections.pop_front() else {
                return false;
            };
            if version != state.version {
                return true;
            }
            state.decoding = true;
            (state.loaded.clone(), section)
        };
        // It is the one that is drawn by.
        let table = loaded.session.table.as_ref().map(|promise| &promise.table);
        if let Some(section) = table.and_then(|table| table.section(asked)) {
            // A damaged section is complained of when a camera needs it.
            let _ = section.tree();
        }
        self.state().decoding = false;
        true
    }

    /// Says what goes on behind.
    fn set_background(&self, text: Option<String>) {
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
        let mut files = WatchedFiles::since(self.opened, self.present().loaded.files.clone(), &[]);
        let mut since_look = Duration::ZERO;
        while !self.has_ended() {
            std::thread::sleep(BEAT);
            since_look += BEAT;
            let mut reload = {
                let mut state = self.state();
                state.loading = std::mem::take(&mut state.reload);
                state.loading
            };
            if since_look >= LOOK {
                since_look = Duration::ZERO;
                reload |= files.have_changed();
            }
            if reload {
                let begun = SystemTime::now();
                let before = files.stamped();
                let read = with_kept_results(|| self.reload());
                files = WatchedFiles::since(begun, read, &before);
            }
        }
    }

    /// Loads the space again; the last good one with its parameters stays if that fails. Returns the files that it is of,
    /// and of a failure those that were asked for as well: one of them is to be mended.
    fn reload(&self) -> Vec<PathBuf> {
        let (mut settings, table) = {
            let state = self.state();
            let table = state.table.as_ref().map(|(_, bundle)| bundle.clone());
            (state.settings.clone(), table)
        };
        // What somebody has just written is to be seen, not what was chosen before.
        let rewritten = self.rewritten();
        settings.retain(|(name, _)| !rewritten.contains(name));
        let (mut loaded, mut asked) = noting(|| self.source.load(&settings, table.clone()));
        if loaded.is_err()
            && let Some(known) = self.without_unknown(&settings, table.clone())
        {
            self.state().settings.clone_from(&known);
            settings = known;
            (loaded, asked) = noting(|| self.source.load(&settings, table));
        }
        let mut state = self.state();
        state.loading = false;
        match loaded.and_then(|loaded| state.loaded.with_bundle_kept(loaded)) {
            Ok(loaded) => {
                state.settings.retain(|(name, _)| !rewritten.contains(name));
                state.loaded =
                    ViewedSpace::new(loaded, self.no_table, state.sky, &state.loaded.warnings);
                state.loaded_settings = settings;
                state.version += 1;
                state.trouble = None;
                state.loaded.files.clone()
            }
            Err(error) => {
                state.trouble = Some(error.report(false));
                state.forget_refused(&settings);
                let mut files = state.loaded.files.clone();
                files.extend(asked);
                files.sort_unstable();
                files.dedup();
                files
            }
        }
    }
}

impl SharedSpace {
    /// Returns the settings without those of parameters that the manifold, as its file is now, does not have any more: a
    /// viewer's choice of them goes with them. `None` if there are none, or if the file cannot be loaded anyway.
    fn without_unknown(
        &self,
        settings: &[(String, f64)],
        table: Option<Bundle>,
    ) -> Option<Vec<(String, f64)>> {
        if settings == self.given {
            return None;
        }
        let loaded = self.source.load(&self.given, table).ok()?;
        let parameters = &loaded.session.manifold.parameters;
        let known = |(name, _): &&(String, f64)| parameters.iter().any(|(known, _)| known == name);
        let kept: Vec<_> = settings.iter().filter(known).cloned().collect();
        (kept.len() < settings.len()).then_some(kept)
    }

    /// Names the parameters to which the manifold's file gives another value now than when it was loaded.
    fn rewritten(&self) -> Vec<String> {
        let before = self.present().loaded.session.manifold.source.clone();
        let now = read_text(Path::new(&before.name)).ok();
        let Some(now) = now.filter(|now| now.text != before.text) else {
            return Vec::new();
        };
        let [old, new] = [before, now].map(|source| {
            let manifold = Manifold::from_source(source, &self.given);
            manifold.map_or_else(|_| Vec::new(), |manifold| manifold.parameters)
        });
        let changed = |(name, value): (String, f64)| {
            let differs = |(known, old): &(String, f64)| *known == name && *old != value;
            old.iter().any(differs).then_some(name)
        };
        new.into_iter().filter_map(changed).collect()
    }
}

impl SpaceState {
    /// Names the parameters of the space to which viewers have given another value than the command's and the file's.
    fn chosen(&self, given: &[(String, f64)]) -> Vec<String> {
        let all = self.loaded_settings.iter();
        let chosen = all.filter(|setting| !given.contains(setting));
        chosen.map(|(name, _)| name.clone()).collect()
    }

    /// Puts the parameters of the present space in the place of those that were `refused`; others, asked for since, stay.
    fn forget_refused(&mut self, refused: &[(String, f64)]) {
        let good = &self.loaded_settings;
        self.settings
            .retain(|asked| good.contains(asked) || !refused.contains(asked));
        for (name, value) in good {
            if self.settings.iter().all(|(known, _)| known != name) {
                self.settings.push((name.clone(), *value));
            }
        }
    }
}

/// When a file was last changed, and its length; `None` of one that is not there.
type Stamp = Option<(SystemTime, u64)>;

/// Files, and their stamps when they were read.
struct WatchedFiles {
    files: Vec<PathBuf>,
    stamps: Vec<Stamp>,
}

impl WatchedFiles {
    /// Watches `files`, which were read after `begun`: those with a stamp from `before` it by that, and others that
    /// were changed since as if they had not been there.
    fn since(begun: SystemTime, files: Vec<PathBuf>, before: &[(PathBuf, Stamp)]) -> Self {
        let stamp_of = |file: &PathBuf| {
            let known = before.iter().find(|(known, _)| known == file);
            let unchanged = |stamp: &(SystemTime, u64)| stamp.0 < begun;
            known.map_or_else(|| stamp(file).filter(unchanged), |(_, stamp)| *stamp)
        };
        let stamps = files.iter().map(stamp_of).collect();
        Self { files, stamps }
    }

    /// Returns the files with their present stamps.
    fn stamped(&self) -> Vec<(PathBuf, Stamp)> {
        let files = self.files.iter();
        files.map(|file| (file.clone(), stamp(file))).collect()
    }

    /// Tells whether one has changed since this was last asked.
    fn have_changed(&mut self) -> bool {
        let now: Vec<Stamp> = self.files.iter().map(stamp).collect();
        let changed = now != self.stamps;
        self.stamps = now;
        changed
    }
}

fn stamp(file: &PathBuf) -> Stamp {
    let about = fs::metadata(file).ok()?;
    Some((about.modified().ok()?, about.len()))
}

/// Time between two looks at whether the space is another one.
const NEXT_BAKE: Duration = Duration::from_millis(300);

/// Time between two looks at whether a section is to be decoded.
const PAUSE: Duration = Duration::from_millis(4);

/// Rays of the certificate, as for `geofan bake`.
const CERTIFY_RAYS: u64 = 20_000;

/// Bakes a table for every space that lacks its own, until the viewer ends.
pub fn bake_tables(shared: &Arc<SharedSpace>) {
    let Some(folder) = user_cache::folder("tables") else {
        return;
    };
    let threads = rayon::current_num_threads().div_ceil(2);
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else {
        return;
    };
    let mut tried = 0;
    while !shared.has_ended() {
        let PresentSpace {
            version, loaded, ..
        } = shared.present();
        let (manifold, length) = (&loaded.session.manifold, loaded.session.length);
        let changed = std::mem::replace(&mut tried, version) != version;
        if changed {
            let name = identity(manifold, length);
            let told = match shared.lacks_table(&loaded, &name) {
                false => None,
                true => {
                    let work = BehindBake { shared, version };
                    let made = pool.install(|| bake_table(&folder, &name, manifold, length, &work));
                    made.err().map(|error| match is_baked_elsewhere(&error) {
                        true => {
                            // It is there as soon as the other is done.
                            tried = 0;
                            "another viewer bakes the table".to_string()
                        }
                        false => format!("no table: {error}"),
                    })
                }
            };
            shared.set_background(told);
        }
        std::thread::sleep(NEXT_BAKE);
    }
}

/// Decodes sections of the table as viewers ask for them, ahead of their cameras, until the viewer ends.
pub fn decode_ahead(shared: &SharedSpace) {
    while !shared.has_ended() {
        if !shared.decode_section() {
            std::thread::sleep(PAUSE);
        }
    }
}

/// Finds the table of a manifold in the cache, or bakes it there, and gives it to the space.
fn bake_table(
    folder: &Path,
    name: &str,
    manifold: &Arc<Manifold>,
    length: f64,
    work: &BehindBake<'_>,
) -> Result<()> {
    let path = folder.join(format!("{name}.fan"));
    let found = Bundle::read(&path).ok();
    let found = found.filter(|bundle| {
        let differences = manifold.differences_of_covers(&bundle.manifold);
        differences.is_empty()
    });
    if let Some(bundle) = found {
        work.shared.set_table(name.into(), bundle);
        return Ok(());
    }
    make_output_folder(folder)?;
    let options = BakeOptions {
        length: Some(length),
        resume: true,
        certify_rays: CERTIFY_RAYS,
        ..BakeOptions::default()
    };
    match bake(manifold.clone(), &path, &options, work) {
        Ok(BakeResult::Bundle { bundle, .. }) => {
            work.shared.set_table(name.into(), *bundle);
            Ok(())
        }
        Ok(_) => Ok(()),
        Err(_) if work.cancelled() => Ok(()),
        Err(error) => Err(error),
    }
}

/// Tells whether a bake did not begin because another process makes the same bundle.
fn is_baked_elsewhere(error: &Error) -> bool {
    matches!(error, Error::Environment { source, .. } if source.kind() == io::ErrorKind::WouldBlock)
}

/// Returns the name of a manifold's table: equal for equal geometry, cameras and length.
fn identity(manifold: &Manifold, length: f64) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&manifold.cover().meaning_digest());
    if let Some(region) = &manifold.cameras {
        hasher.update(&region.digest());
    }
    hasher.update(&length.to_le_bytes());
    hasher.finalize().to_hex()[..32].to_string()
}

/// Watches a bake for the viewers.
struct BehindBake<'s> {
    shared: &'s SharedSpace,
    version: u64,
}

impl Observer for BehindBake<'_> {
    fn progress(&self, progress: Progress<'_>) {
        let Progress {
            work, done, total, ..
        } = progress;
        let text = match total {
            0 => format!("baking a table behind: {work}"),
            _ => format!("baking a table behind: {work} {done} of {total}"),
        };
        self.shared.set_background(Some(text));
    }

    fn cancelled(&self) -> bool {
        self.shared.has_ended() || self.shared.present().version != self.version
    }
}

#[cfg(test)]
#[path = "shared_space_tests.rs"]
mod tests;
