//! One viewer: a session behind a WebSocket.
//!
//! In: messages of the user interface. Out: pixels and panels. One thread reads, lets the session decide, draws
//! with all threads, and writes; so nothing is locked while a picture is drawn. Messages are bounded, and a
//! client that sends nonsense again and again is left.

use super::loading::SharedSpace;
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

/// Most bytes of a message: a camera path of an hour is below two megabytes.
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
    let (version, loaded, ..) = shared.present();
    let mut connection = Connection {
        socket,
        session: Session::new(loaded.session.clone()),
        feed: PanelFeed::default(),
        version,
        nonsense: 0,
        began: Instant::now(),
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

struct Connection {
    socket: WebSocket<TcpStream>,
    session: Session,
    feed: PanelFeed,
    /// The space's version that the session knows.
    version: u64,
    nonsense: usize,
    began: Instant,
}

impl Connection {
    fn now(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Does one turn: events, one piece of work, what it gave. Tells whether to go on.
    fn turn(&mut self, shared: &SharedSpace) -> Result<bool, Error> {
        if !self.read(shared)? {
            return Ok(false);
        }
        let (version, loaded, trouble, background) = shared.present();
        if version != self.version {
            self.version = version;
            self.session.replace_space(loaded.session.clone());
        }
        self.session.set_trouble(trouble);
        self.session.set_background(background);
        let now = self.now();
        let work = self.session.next_work(now, 1);
        if let Some(work) = &work {
            let answer = loaded.draw.answer(work);
            let now = self.now();
            self.session.accept(now, answer);
        }
        for patch in self.session.take_patches() {
            self.socket.send(Message::Binary(patch.encode().into()))?;
        }
        let now = self.now();
        for text in self.feed.next(&mut self.session, now) {
            self.socket.send(Message::Text(text.into()))?;
        }
        if work.is_none() {
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
                Err(error) if is_nothing_yet(&error) => break,
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
            Err(error) if is_nothing_yet(&error) => Ok(true),
            Err(error) => Err(error),
        }
    }

    /// Takes a message. Tells whether the client is still there.
    fn take(&mut self, message: Message, shared: &SharedSpace) -> bool {
        let now = self.now();
        match message {
            Message::Text(text) => match serde_json::from_str(text.as_str()) {
                Ok(ViewerEvent::Parameter { name, value }) => shared.set_parameter(&name, value),
                Ok(event) => {
                    if let ViewerEvent::Sky { sky } = event {
                        shared.set_sky(sky);
                    }
                    self.session.handle(now, event);
                }
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
fn is_nothing_yet(error: &Error) -> bool {
    matches!(error, Error::Io(e)
        if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted))
}
