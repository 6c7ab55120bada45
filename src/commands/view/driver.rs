//! A session in the program: it decides, all threads draw, and what it shows is taken away.
//!
//! In: the space that all viewers share, and events. Out: one turn after another, each with at most one piece of work;
//! between them patches and the panel. Nothing is locked while a picture is drawn.

use super::loading::SharedSpace;
use geofan_view::{Session, ViewerEvent};
use std::time::Instant;

/// A session and its clock.
pub struct Driver {
    /// The session.
    pub session: Session,
    /// The space's version that the session knows.
    version: u64,
    began: Instant,
}

impl Driver {
    /// Begins a session in the present space.
    pub fn new(shared: &SharedSpace) -> Self {
        let (version, loaded, ..) = shared.present();
        Self {
            session: Session::new(loaded.session.clone()),
            version,
            began: Instant::now(),
        }
    }

    /// Returns the seconds since it began.
    pub fn now(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Takes an event: what concerns the space is for all viewers.
    pub fn handle(&mut self, event: ViewerEvent, shared: &SharedSpace) {
        if let ViewerEvent::Parameter { name, value } = &event {
            return shared.set_parameter(name, *value);
        }
        if let ViewerEvent::Sky { sky } = event {
            shared.set_sky(sky);
        }
        let now = self.now();
        self.session.handle(now, event);
    }

    /// Does the next piece of work. Tells whether there was any.
    pub fn turn(&mut self, shared: &SharedSpace) -> bool {
        let loading = shared.is_loading();
        let (version, loaded, trouble, background) = shared.present();
        if version != self.version {
            self.version = version;
            self.session.replace_space(loaded.session.clone());
        }
        self.session.set_loading(loading);
        self.session.set_trouble(trouble);
        self.session.set_background(background);
        let now = self.now();
        if shared.wants_chunk()
            && let Some(chunk) = self.session.next_chunk(now)
        {
            shared.set_chunk(version, chunk);
        }
        let Some(work) = self.session.next_work(now, 1) else {
            return false;
        };
        let answer = loaded.draw.answer(&work);
        let now = self.now();
        self.session.accept(now, answer);
        true
    }
}
