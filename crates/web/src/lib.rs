//! The viewer in a page: plain functions around a session, and around drawing, for WebAssembly.
//!
//! In and out: bytes in two buffers. The page writes into the one that [`exports::geofan_input`] makes room in,
//! calls a function, and reads the other. The page's own thread has a session; each of its workers draws. Both
//! open the same package (`geofan_view::Package`). Here is what one WebAssembly instance holds and does; [`exports`] has
//! the functions.

pub mod exports;

use geofan_core::{Error, Result};
use geofan_view::{
    Answer, DrawSpace, Package, PageAbout, PanelFeed, Patch, Session, SkyChoice, ViewerEvent, Work,
};

/// What is said while lamps light nothing.
const DARK: &str = "the light of the lamps is left out: it is of other parameters";

/// The state of one WebAssembly instance: a session or a drawing, and the package that it was opened from.
#[derive(Default)]
struct Instance {
    /// Written by the page.
    input: Vec<u8>,
    /// Read by the page.
    output: Vec<u8>,
    package: Package,
    session: Option<Session>,
    feed: PanelFeed,
    messages: Vec<String>,
    patches: Vec<Patch>,
    drawing: Option<DrawSpace>,
    sky: SkyChoice,
}

impl Instance {
    /// Opens the package in the input to draw its scene.
    fn open_drawing(&mut self) -> Result<()> {
        self.package = self.read_package()?;
        self.drawing = Some(PageAbout::open(&self.package, None)?);
        Ok(())
    }

    /// Opens the package in the input for a session.
    fn open_session(&mut self) -> Result<()> {
        self.package = self.read_package()?;
        let space = PageAbout::open_session(&self.package, None)?;
        self.session = Some(Session::new(space));
        Ok(())
    }

    /// Takes the package out of the input.
    fn read_package(&mut self) -> Result<Package> {
        Package::decode(&std::mem::take(&mut self.input))
    }

    /// Loads the scene again with the parameters in the input, or as it was packed if there are none. With others the light
    /// of lamps is left out.
    fn set(&mut self) -> Result<()> {
        let settings: Vec<(String, f64)> = serde_json::from_slice(&self.input)
            .map_err(|e| Error::input("settings", e.to_string()))?;
        let settings = Some(&settings[..]).filter(|settings| !settings.is_empty());
        if let Some(session) = &mut self.session {
            session.replace_space(PageAbout::open_session(&self.package, settings)?);
            session.set_trouble(None);
            let light = self.package.get(PageAbout::LIGHT);
            session.set_background(settings.and(light).map(|_| DARK.into()));
        } else if let Some(drawing) = &mut self.drawing {
            *drawing = PageAbout::open(&self.package, settings)?;
            drawing.dress(self.sky);
        }
        Ok(())
    }

    /// Shows the skies in the input.
    fn dress(&mut self) {
        let sky = serde_json::from_slice::<SkyChoice>(&self.input);
        if let (Some(drawing), Ok(sky)) = (&mut self.drawing, sky) {
            self.sky = sky;
            drawing.dress(sky);
        }
    }

    /// Hands the event in the input to the session.
    fn event(&mut self, now: f64) {
        let event = serde_json::from_slice::<ViewerEvent>(&self.input);
        if let (Some(session), Ok(event)) = (&mut self.session, event) {
            session.handle(now, event);
        }
    }

    /// Says that something is wrong, by the text in the input.
    fn trouble(&mut self) {
        let text = String::from_utf8_lossy(&self.input).into_owned();
        if let Some(session) = &mut self.session {
            session.set_trouble(Some(text).filter(|text| !text.is_empty()));
        }
    }

    /// Puts the next work into the output, if there is any.
    fn next(&mut self, now: f64, workers: u32) -> bool {
        let session = self.session.as_mut();
        let work = session.and_then(|session| session.next_work(now, workers as usize));
        match work {
            Some(work) => {
                self.output = work.encode();
                true
            }
            None => false,
        }
    }

    /// Does the work in the input and puts the answer into the output.
    fn work(&mut self) {
        let work = Work::decode(&self.input);
        // The page has the last answer.
        self.output = Vec::new();
        let answer = match (&self.drawing, work) {
            (Some(drawing), Some(work)) => drawing.answer(&work),
            _ => Answer::Failed {
                frame: None,
                message: "this worker has nothing to draw".into(),
            },
        };
        self.output = answer.encode();
    }

    /// Hands the answer in the input to the session.
    fn accept(&mut self, now: f64) {
        let input = std::mem::take(&mut self.input);
        let answer = Answer::decode(&input);
        drop(input);
        if let (Some(session), Some(answer)) = (&mut self.session, answer) {
            session.accept(now, answer);
        }
    }

    /// Tells the session that the work in the input comes to nothing: its worker has failed.
    fn fail(&mut self, now: f64) {
        if let (Some(session), Some(work)) = (&mut self.session, Work::decode(&self.input)) {
            session.accept(now, work.failed("a worker has failed".into()));
        }
    }

    /// Returns a section of the table to be decoded in every drawing; −1 if there is none.
    fn next_section(&mut self, now: f64) -> i32 {
        let session = self.session.as_mut();
        let section = session.and_then(|session| session.next_section(now));
        section.and_then(|c| i32::try_from(c).ok()).unwrap_or(-1)
    }

    /// Decodes a section of the drawing's table.
    fn decode(&self, section: usize) {
        let table = self.drawing.as_ref().and_then(DrawSpace::bundle);
        if let Some(section) = table.and_then(|bundle| bundle.table.section(section)) {
            // A damaged section is complained of when a camera needs it.
            let _ = section.tree();
        }
    }

    /// Takes note that all drawings have decoded a section.
    fn decoded(&mut self, section: usize) {
        if let Some(session) = &mut self.session {
            session.section_decoded(section);
        }
    }

    /// Puts the next patch into the output, if there is one.
    fn patch(&mut self) -> bool {
        if self.patches.is_empty()
            && let Some(session) = &mut self.session
        {
            self.patches = session.take_patches();
            self.patches.reverse();
        }
        match self.patches.pop() {
            Some(patch) => {
                self.output = patch.encode();
                true
            }
            None => false,
        }
    }

    /// Puts the next message for the user interface into the output, if there is one.
    fn message(&mut self, now: f64) -> bool {
        if self.messages.is_empty()
            && let Some(session) = &mut self.session
        {
            self.messages = self.feed.next(session, now);
            self.messages.reverse();
        }
        match self.messages.pop() {
            Some(message) => {
                self.output = message.into_bytes();
                true
            }
            None => false,
        }
    }
}
