//! A session in the program: it decides, all threads draw, and what it shows is taken away; and one viewer, which has
//! a session behind a WebSocket.
//!
//! In: the space that all viewers share, and events. Out: one turn after another, each with at most one piece of work;
//! between them patches and the panel. While a picture is drawn only its skies are held as they are.
//!
//! In: messages of the user interface. Out: pixels and panels. One thread reads, lets the session decide, draws
//! with all threads, and writes. Messages are bounded, and a client that sends nonsense again and again is left.

use super::shared_space::{PresentSpace, SharedSpace};
use geofan_view::{PanelFeed, Session, ViewerEvent};
use std::{
    io,
    net::TcpStream,
    sync::Arc,
    time::{Duration, Instant},
};
use tungstenite::{
    Error, Message, WebSocket,
    protocol::{Role, WebSocketConfig},
};

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
        let present = shared.present();
        let mut session = Session::new(present.loaded.session.clone());
        session.set_sky(present.sky);
        Self {
            session,
            version: present.version,
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
        let PresentSpace {
            version,
            loaded,
            trouble,
            background,
            sky,
            chosen,
        } = shared.present();
        if version != self.version {
            self.version = version;
            self.session.replace_space(loaded.session.clone());
        }
        self.session.set_loading(loading);
        self.session.set_trouble(trouble);
        self.session.set_background(background);
        self.session.set_sky(sky);
        self.session.set_chosen(chosen);
        let now = self.now();
        if shared.wants_section()
            && let Some(section) = self.session.next_section(now)
        {
            shared.set_section(version, section);
        }
        let Some(work) = self.session.next_work(now, 1) else {
            return false;
        };
        let answer = loaded.answer(&work);
        let now = self.now();
        self.session.accept(now, answer);
        true
    }
}

/// Most bytes of a message: a camera path of an hour is below three megabytes.
const MOST_OF_A_MESSAGE: usize = 4 << 20;

/// Messages taken before the session goes on.
const MOST_AT_ONCE: usize = 256;

/// Messages that are not events, after which a client is left.
const MOST_NONSENSE: usize = 100;

/// The time that is waited for a message when there is nothing to do.
const PAUSE: Duration = Duration::from_millis(5);

/// Runs a session until its client goes or the viewer ends; `part` was read from the stream already.
pub fn run(stream: TcpStream, part: Vec<u8>, shared: &Arc<SharedSpace>) {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MOST_OF_A_MESSAGE))
        .max_frame_size(Some(MOST_OF_A_MESSAGE));
    let socket = WebSocket::from_partially_read(stream, part, Role::Server, Some(config));
    let mut connection = ViewerConnection {
        socket,
        driver: Driver::new(shared),
        feed: PanelFeed::default(),
        nonsense: 0,
    };
    while !shared.has_ended() {
        match connection.turn(shared) {
            Ok(true) => {}
            Ok(false) | Err(_) => return,
        }
    }
    let _ = connection.socket.close(None);
    let _ = connection.socket.flush();
}

struct ViewerConnection {
    socket: WebSocket<TcpStream>,
    driver: Driver,
    feed: PanelFeed,
    nonsense: usize,
}

impl ViewerConnection {
    /// Does one turn: events, one piece of work, what it gave. Tells whether to go on.
    fn turn(&mut self, shared: &SharedSpace) -> Result<bool, Error> {
        if !self.read(shared)? {
            return Ok(false);
        }
        let worked = self.driver.turn(shared);
        for patch in self.driver.session.take_patches() {
            self.socket.send(Message::Binary(patch.encode().into()))?;
        }
        let now = self.driver.now();
        for text in self.feed.next(&mut self.driver.session, now) {
            self.socket.send(Message::Text(text.into()))?;
        }
        if !worked {
            return self.wait(shared);
        }
        Ok(true)
    }

    /// Reads what has come. Tells whether the client is still there.
    fn read(&mut self, shared: &SharedSpace) -> Result<bool, Error> {
        self.socket.get_ref().set_nonblocking(true)?;
        let mut here = true;
        for _ in 0..MOST_AT_ONCE {
            match self.socket.read() {
                Ok(message) => here = self.take(message, shared),
                Err(Error::Io(error)) if is_nothing_yet(&error) => break,
                Err(error) => return Err(error),
            }
            if !here {
                break;
            }
        }
        self.socket.get_ref().set_nonblocking(false)?;
        Ok(here)
    }

    /// Waits for a message.
    fn wait(&mut self, shared: &SharedSpace) -> Result<bool, Error> {
        self.socket.get_ref().set_read_timeout(Some(PAUSE))?;
        match self.socket.read() {
            Ok(message) => Ok(self.take(message, shared)),
            Err(Error::Io(error)) if is_nothing_yet(&error) => Ok(true),
            Err(error) => Err(error),
        }
    }

    /// Takes a message. Tells whether the client is still there.
    fn take(&mut self, message: Message, shared: &SharedSpace) -> bool {
        match message {
            Message::Text(text) => match serde_json::from_str(text.as_str()) {
                Ok(event) => self.driver.handle(event, shared),
                Err(_) => self.nonsense += 1,
            },
            Message::Close(_) => return false,
            Message::Binary(_) => self.nonsense += 1,
            Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => {}
        }
        self.nonsense < MOST_NONSENSE
    }
}

/// Tells whether there is only nothing to be read yet.
pub fn is_nothing_yet(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}
