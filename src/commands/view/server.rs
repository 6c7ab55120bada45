//! The viewer's little server: static files and the doors to sessions, for this machine's own browser only.
//!
//! In: connections to a loopback address. Out: the user interface's files, and WebSocket connections handed to
//! [`super::driver`]. Any page in the browser, and any process of the machine, can connect; so whatever
//! does must know the token of this run, which is in the address; must name this very server as its host (a
//! name that was bound to 127.0.0.1 afterwards does not); and a WebSocket must come from a page of this server.
//! Heads, messages, connections and waiting are bounded.

use super::{
    driver::{self, is_nothing_yet},
    opening::{Ticket, is_of_another_user, is_same},
    shared_space::SharedSpace,
};
use geofan_core::{Error, Result};
use geofan_view::ui;
use std::{
    io::{self, Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use tungstenite::handshake::derive_accept_key;

/// Most bytes of a request's head.
const MOST_OF_A_HEAD: usize = 8 << 10;

/// Most connections at once, and most of them sessions: a session draws with all threads.
const MOST_CONNECTIONS: usize = 32;
const MOST_SESSIONS: usize = 4;

/// The time in which a head must have come, and one write must go.
const PATIENCE: Duration = Duration::from_secs(5);

/// Time between two looks at whether the viewer ends while a head is waited for.
const LOOK: Duration = Duration::from_millis(100);

/// A server of the viewer.
pub struct Server {
    listener: TcpListener,
    port: SocketAddr,
    token: String,
    /// Leads a browser to the token.
    ticket: Ticket,
    shared: Arc<SharedSpace>,
    connections: AtomicUsize,
    sessions: AtomicUsize,
}

/// A request as far as it matters here.
#[derive(Debug, PartialEq)]
struct Request {
    path: String,
    /// Names in small letters.
    headers: Vec<(String, String)>,
    /// Bytes that came after the head.
    rest: Vec<u8>,
}

impl Request {
    /// Returns the value of a header that stands there once.
    fn header(&self, name: &str) -> Option<&str> {
        let mut found = self.headers.iter().filter(|(known, _)| known == name);
        let value = found.next().map(|(_, value)| value.as_str());
        value.filter(|_| found.next().is_none())
    }

    /// Tells whether a header lists a word.
    fn lists(&self, name: &str, word: &str) -> bool {
        let value = self.header(name).unwrap_or_default();
        value
            .split(',')
            .any(|part| part.trim().eq_ignore_ascii_case(word))
    }
}

/// An answer to a request: status, type, content.
type Reply = (&'static str, &'static str, String);

impl Server {
    /// Begins to listen.
    ///
    /// # Errors
    /// The address is taken, or the machine gives no random numbers.
    pub fn bind(address: SocketAddr, shared: Arc<SharedSpace>) -> Result<Self> {
        let failed = |source: io::Error| Error::Environment {
            path: address.to_string(),
            source,
        };
        let listener = TcpListener::bind(address).map_err(failed)?;
        Ok(Self {
            port: listener.local_addr().map_err(failed)?,
            listener,
            token: secret().map_err(failed)?,
            ticket: Ticket::new(secret().map_err(failed)?),
            shared,
            connections: AtomicUsize::new(0),
            sessions: AtomicUsize::new(0),
        })
    }

    /// Returns the address of the user interface, with the token.
    pub fn address(&self) -> String {
        format!("http://{}/{}/", self.port, self.token)
    }

    /// Returns an address that leads to the user interface once, and does not have the token.
    pub fn opening_address(&self) -> String {
        format!("http://{}/{}", self.port, self.ticket.word())
    }

    /// Makes [`Server::serve`] look whether it is to end.
    pub fn wake(&self) {
        let _ = TcpStream::connect_timeout(&self.port, PATIENCE);
    }

    /// Serves until the viewer ends.
    pub fn serve(&self) {
        std::thread::scope(|threads| {
            for stream in self.listener.incoming() {
                if self.shared.has_ended() {
                    break;
                }
                let Ok(stream) = stream else { continue };
                if self.connections.load(Ordering::Relaxed) >= MOST_CONNECTIONS {
                    let _ = stream.shutdown(Shutdown::Both);
                    continue;
                }
                self.connections.fetch_add(1, Ordering::Relaxed);
                threads.spawn(move || {
                    let _guard = Counted(&self.connections);
                    // What goes wrong on a connection is its client's matter.
                    let _ = self.answer(stream);
                });
            }
        });
    }

    /// Answers one connection.
    fn answer(&self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        let Some(request) = read_request(&mut stream, || self.shared.has_ended())? else {
            return reply(
                &mut stream,
                ("400 Bad Request", TEXT, "bad request".into()),
                "",
            );
        };
        match self.check(&request, stream.peer_addr()?) {
            Err(refusal) => reply(&mut stream, refusal, ""),
            Ok(None) => self.lead_on(&mut stream),
            Ok(Some("socket")) => self.open_session(stream, &request),
            Ok(Some(name)) => reply(&mut stream, file(name), &self.policy()),
        }
    }

    /// Checks who asks; returns what is asked for, without the token, or nothing where no slash is behind that.
    fn check<'r>(&self, request: &'r Request, peer: SocketAddr) -> Result<Option<&'r str>, Reply> {
        let refuse = |why: &str| Err(("403 Forbidden", TEXT, why.to_string()));
        let host = request.header("host").unwrap_or_default();
        let hosts = names_of(self.port);
        if !hosts.iter().any(|known| known == host) {
            return refuse("this address is served under its own name only");
        }
        let path = request.path.strip_prefix('/').unwrap_or_default();
        let (token, name) = match path.split_once('/') {
            Some((token, name)) => (token, Some(name)),
            None => (path, None),
        };
        if let Some(origin) = request.header("origin") {
            let from = origin.strip_prefix("http://").unwrap_or_default();
            if !hosts.iter().any(|known| known == from) {
                return refuse("another site's page has no business here");
            }
        } else if name == Some("socket") {
            return refuse("a page must say where it comes from");
        }
        // Last: what is refused for another reason takes no ticket.
        let comes_by_ticket = || name.is_none() && self.takes_ticket(token, peer);
        match is_same(token, &self.token) || comes_by_ticket() {
            true => Ok(name),
            false => refuse("open the address that geofan printed"),
        }
    }

    /// Tells whether this is the word of the ticket, which is taken then; it is for this user only.
    fn takes_ticket(&self, word: &str, peer: SocketAddr) -> bool {
        !is_of_another_user(peer, self.port) && self.ticket.take(word)
    }

    /// Leads to the user interface, whose files would be looked for without the token if the address lacked its last
    /// slash.
    fn lead_on(&self, stream: &mut TcpStream) -> io::Result<()> {
        let there = format!("Location: /{}/\r\n", self.token);
        let moved = ("308 Permanent Redirect", TEXT, String::new());
        reply_with(stream, moved, "", &there)
    }

    /// Returns what the user interface's pages may do: nothing but talk to this server.
    fn policy(&self) -> String {
        let sockets = names_of(self.port).into_iter();
        let sockets: String = sockets.map(|host| format!(" ws://{host}")).collect();
        format!(
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'{sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
    }

    /// Turns a connection into a session.
    fn open_session(&self, mut stream: TcpStream, request: &Request) -> io::Result<()> {
        let key = request
            .header("sec-websocket-key")
            .filter(|key| key.len() == 24);
        let asked = request.lists("upgrade", "websocket")
            && request.lists("connection", "upgrade")
            && request.header("sec-websocket-version") == Some("13");
        let Some(key) = key.filter(|_| asked) else {
            return reply(
                &mut stream,
                ("400 Bad Request", TEXT, "no WebSocket".into()),
                "",
            );
        };
        if self.sessions.fetch_add(1, Ordering::Relaxed) >= MOST_SESSIONS {
            let _guard = Counted(&self.sessions);
            let busy = "too many viewers are open: close one".to_string();
            return reply(&mut stream, ("503 Service Unavailable", TEXT, busy), "");
        }
        let _guard = Counted(&self.sessions);
        write!(
            stream,
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {}\r\n\r\n",
            derive_accept_key(key.as_bytes())
        )?;
        driver::run(stream, request.rest.clone(), &self.shared);
        Ok(())
    }
}

/// Makes a word that nobody can guess.
fn secret() -> io::Result<String> {
    let mut random = [0; 16];
    getrandom::fill(&mut random).map_err(|e| io::Error::other(e.to_string()))?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Lists the names under which a server at `address` may be asked.
fn names_of(address: SocketAddr) -> Vec<String> {
    let whole = [address.to_string(), format!("localhost:{}", address.port())];
    // Browsers leave the port of HTTP out.
    let short = whole.iter().filter_map(|name| name.strip_suffix(":80"));
    let short: Vec<String> = short.map(String::from).collect();
    whole.into_iter().chain(short).collect()
}

/// Counts a connection down when it ends.
struct Counted<'c>(&'c AtomicUsize);

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Reads the head of a request; `None` if it is none, or if it has not come when the viewer has `ended`.
fn read_request(stream: &mut TcpStream, ended: impl Fn() -> bool) -> io::Result<Option<Request>> {
    let began = Instant::now();
    let mut bytes = Vec::new();
    let mut part = [0; 1024];
    stream.set_read_timeout(Some(LOOK))?;
    loop {
        if ended() || began.elapsed() >= PATIENCE || bytes.len() > MOST_OF_A_HEAD {
            return Ok(None);
        }
        let count = match stream.read(&mut part) {
            Err(error) if is_nothing_yet(&error) => continue,
            read => read?,
        };
        if count == 0 {
            return Ok(None);
        }
        bytes.extend_from_slice(&part[..count]);
        if let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") {
            let rest = bytes[end + 4..].to_vec();
            return Ok(parse_request(&bytes[..end], rest));
        }
    }
}

/// Reads a head's text; `None` if it is no request for something to be read.
fn parse_request(head: &[u8], rest: Vec<u8>) -> Option<Request> {
    let text = str::from_utf8(head).ok()?;
    let mut lines = text.split("\r\n");
    let mut first = lines.next()?.split(' ');
    let (method, path, version) = (first.next()?, first.next()?, first.next()?);
    if method != "GET" || first.next().is_some() || !version.starts_with("HTTP/1.") {
        return None;
    }
    let header = |line: &str| {
        let (name, value) = line.split_once(':')?;
        Some((name.to_ascii_lowercase(), value.trim().to_string()))
    };
    Some(Request {
        path: path.split(['?', '#']).next().unwrap_or_default().into(),
        headers: lines.map(header).collect::<Option<_>>()?,
        rest,
    })
}

const TEXT: &str = "text/plain; charset=utf-8";

/// Finds a file of the user interface.
fn file(name: &str) -> Reply {
    let script = "text/javascript; charset=utf-8";
    let modules = ui::MODULES.iter().chain([&ui::SERVED_MAIN]);
    match name {
        "" => ("200 OK", "text/html; charset=utf-8", ui::HTML.into()),
        "style.css" => ("200 OK", "text/css; charset=utf-8", ui::STYLE.into()),
        name => match modules.into_iter().find(|(known, _)| *known == name) {
            Some((_, text)) => ("200 OK", script, (*text).into()),
            None => ("404 Not Found", TEXT, "there is no such file".into()),
        },
    }
}

/// Writes an answer and ends the connection.
fn reply(stream: &mut TcpStream, reply: Reply, policy: &str) -> io::Result<()> {
    reply_with(stream, reply, policy, "")
}

/// Does so with more lines in its head.
fn reply_with(
    stream: &mut TcpStream,
    (status, kind, content): Reply,
    policy: &str,
    more: &str,
) -> io::Result<()> {
    let policy = if policy.is_empty() {
        "default-src 'none'"
    } else {
        policy
    };
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nContent-Security-Policy: {policy}\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Resource-Policy: same-origin\r\nCache-Control: no-store\r\nConnection: close\r\n{more}\r\n{content}",
        content.len()
    )?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_port_of_http_may_be_left_out_and_no_other() {
        let names = |address: &str| names_of(address.parse().unwrap());
        let all = ["127.0.0.1:80", "localhost:80", "127.0.0.1", "localhost"];
        assert_eq!(names("127.0.0.1:80"), all);
        assert_eq!(names("[::1]:80")[2], "[::1]");
        assert_eq!(
            names("127.0.0.1:8080"),
            ["127.0.0.1:8080", "localhost:8080"]
        );
    }

    #[test]
    fn a_silent_connection_does_not_outlive_the_viewer() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let _silent = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (mut stream, _) = listener.accept().unwrap();
        let began = Instant::now();
        let ended = || began.elapsed() > 2 * LOOK;
        assert_eq!(read_request(&mut stream, ended).unwrap(), None);
        assert!(began.elapsed() < PATIENCE / 2);
    }

    #[test]
    fn only_plain_requests_to_read_are_requests() {
        let parse = |head: &str| parse_request(head.as_bytes(), Vec::new());
        let request = parse("GET /t/a.js?x=1 HTTP/1.1\r\nHost: 127.0.0.1:80\r\nX: a: b").unwrap();
        assert_eq!(request.path, "/t/a.js");
        assert_eq!(request.header("host"), Some("127.0.0.1:80"));
        assert_eq!(request.header("x"), Some("a: b"));
        for wrong in [
            "",
            "POST / HTTP/1.1",
            "GET /",
            "GET / HTTP/2",
            "GET / a HTTP/1.1",
            "GET / HTTP/1.1\r\nno header",
        ] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
        let twice = parse("GET / HTTP/1.1\r\nHost: a\r\nHost: b").unwrap();
        assert_eq!(
            twice.header("host"),
            None,
            "which of them is not ours to choose"
        );
    }
}
