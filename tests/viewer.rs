//! `geofan view` as browsers and hostile programs meet it.

use assert_cmd::cargo::cargo_bin;
use serde_json::{Value, json};
use std::{
    fs,
    io::{BufRead, BufReader, ErrorKind, Read, Write},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, client::IntoClientRequest, http::HeaderValue};

const FLAT: &str = r#"name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "n" }
[parameters]
n = 1.0
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 100"
[cameras]
parameters = { c = [-1, 1] }
at = ["c", "0", "0"]
length = 20.0
"#;

/// A viewer that ends with the test.
struct Viewer {
    child: Child,
    folder: TempDir,
    /// `127.0.0.1:port` and the token.
    host: String,
    token: String,
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Viewer {
    fn start() -> Self {
        let folder = TempDir::new().unwrap();
        fs::write(folder.path().join("m.toml"), FLAT).unwrap();
        let mut child = Command::new(cargo_bin!("geofan"))
            .args(["view", "m.toml", "--no-open", "--no-bake"])
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = child.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").unwrap();
        let (host, token) = address.trim_end_matches('/').split_once('/').unwrap();
        Self {
            child,
            folder,
            host: host.into(),
            token: token.into(),
        }
    }

    /// Sends a request head and returns the whole answer.
    fn ask(&self, head: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let _ = stream.write_all(head.as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn get(&self, path: &str, host: &str) -> String {
        self.ask(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"))
    }

    /// Opens a session.
    fn open(&self, origin: Option<&str>) -> Result<Client, String> {
        let address = format!("ws://{}/{}/socket", self.host, self.token);
        let mut request = address.into_client_request().unwrap();
        if let Some(origin) = origin {
            let value = HeaderValue::from_str(origin).unwrap();
            request.headers_mut().insert("Origin", value);
        }
        let stream = TcpStream::connect(&self.host).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Client { socket }),
            Err(error) => Err(error.to_string()),
        }
    }

    fn origin(&self) -> String {
        format!("http://{}", self.host)
    }

    /// Checks that the viewer still gives pictures to its user.
    fn lives(&self) {
        self.open(Some(&self.origin())).unwrap().is_shown_pictures();
    }
}

struct Client {
    socket: WebSocket<TcpStream>,
}

impl Client {
    /// Checks that pictures come.
    fn is_shown_pictures(&mut self) {
        self.send(&json!({ "type": "resize", "width": 64, "height": 40 }));
        let patch = self.patch();
        assert!(patch.len() > 32);
    }

    fn send(&mut self, event: &Value) {
        self.socket
            .send(Message::Text(event.to_string().into()))
            .unwrap();
    }

    /// Reads the next message; a system call that a stopped and continued process did not end is made again.
    fn read(&mut self) -> tungstenite::Result<Message> {
        loop {
            match self.socket.read() {
                Err(tungstenite::Error::Io(e)) if e.kind() == ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }

    fn patch(&mut self) -> Vec<u8> {
        loop {
            if let Message::Binary(bytes) = self.read().unwrap() {
                return bytes.to_vec();
            }
        }
    }

    /// Waits for a panel that `holds`; shows frames on the way.
    fn panel(&mut self, holds: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            assert!(
                began.elapsed() < Duration::from_secs(60),
                "no such panel comes"
            );
            match self.read().unwrap() {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    if message["type"] == "panel" && holds(&message["panel"]) {
                        return message["panel"].clone();
                    }
                }
                Message::Binary(bytes) => {
                    let frame = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
                    self.send(&json!({ "type": "shown", "frame": frame }));
                }
                _ => {}
            }
        }
    }
}

#[test]
fn the_user_interface_comes_to_who_knows_the_token_and_to_nobody_else() {
    let viewer = Viewer::start();
    let own = format!("/{}/", viewer.token);
    let page = viewer.get(&own, &viewer.host);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<canvas id=\"picture\""));
    assert!(page.contains("default-src 'none'") && page.contains("no-referrer"));
    let script = viewer.get(&format!("{own}viewer.js"), &viewer.host);
    assert!(script.starts_with("HTTP/1.1 200") && script.contains("text/javascript"));
    assert!(
        viewer
            .get(&format!("{own}../Cargo.toml"), &viewer.host)
            .starts_with("HTTP/1.1 404")
    );
    for path in [
        "/",
        "/0123456789abcdef0123456789abcdef/",
        "/viewer.js",
        "//",
        &own[..own.len() - 2],
    ] {
        let refused = viewer.get(path, &viewer.host);
        assert!(refused.starts_with("HTTP/1.1 403"), "{path}: {refused}");
        assert!(!refused.contains(&viewer.token));
    }
    // A name of an attacker that was bound to this machine afterwards.
    for host in ["evil.example", "evil.example:80", "127.0.0.1", ""] {
        assert!(viewer.get(&own, host).starts_with("HTTP/1.1 403"), "{host}");
    }
    let foreign = format!(
        "GET {own} HTTP/1.1\r\nHost: {}\r\nOrigin: http://evil.example\r\n\r\n",
        viewer.host
    );
    assert!(viewer.ask(&foreign).starts_with("HTTP/1.1 403"));
    viewer.lives();
}

#[test]
fn the_address_without_its_last_slash_leads_to_the_whole_one_whoever_may_see_it() {
    let viewer = Viewer::start();
    let short = format!("/{}", viewer.token);
    let location = format!("\r\nLocation: {short}/\r\n");
    let led = viewer.get(&short, &viewer.host);
    assert!(led.starts_with("HTTP/1.1 308") && led.contains(&location));
    assert!(led.contains("default-src 'none'") && led.contains("no-store"));
    let page = viewer.get(&format!("{short}/"), &viewer.host);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    let asked_by = |origin: &str| {
        let host = &viewer.host;
        viewer.ask(&format!(
            "GET {short} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n\r\n"
        ))
    };
    assert!(asked_by(&viewer.origin()).starts_with("HTTP/1.1 308"));
    for refused in [
        viewer.get(&short, "evil.example"),
        viewer.get(&short[..short.len() - 1], &viewer.host),
        viewer.get("/0123456789abcdef0123456789abcdef", &viewer.host),
        asked_by("http://evil.example"),
    ] {
        assert!(refused.starts_with("HTTP/1.1 403"), "{refused}");
        assert!(!refused.contains("Location") && !refused.contains(&viewer.token));
    }
    viewer.lives();
}

#[test]
fn sessions_are_opened_by_the_viewer_s_own_page_only() {
    let viewer = Viewer::start();
    for origin in [
        None,
        Some("http://evil.example"),
        Some("null"),
        Some("https://localhost"),
    ] {
        let error = viewer
            .open(origin)
            .err()
            .unwrap_or_else(|| panic!("{origin:?} was let in"));
        assert!(error.contains("403"), "{error}");
    }
    viewer.lives();
}

#[test]
fn nonsense_and_floods_end_the_connection_and_not_the_viewer() {
    let viewer = Viewer::start();
    for head in [
        String::from("\r\n\r\n"),
        String::from("POST / HTTP/1.1\r\n\r\n"),
        format!(
            "GET /{} HTTP/1.1\r\nHost: {}\r\n\r\n",
            "a".repeat(100_000),
            viewer.host
        ),
        String::from_utf8_lossy(&[0xff, 0xfe, 0, 13, 10, 13, 10]).into_owned(),
    ] {
        let answer = viewer.ask(&head);
        assert!(
            answer.is_empty() || answer.starts_with("HTTP/1.1 4"),
            "{answer}"
        );
    }
    // Messages that are no events.
    let mut client = viewer.open(Some(&viewer.origin())).unwrap();
    let deep = "[".repeat(100_000);
    for text in [
        "",
        "{",
        "null",
        r#"{"type":"resize","width":-1,"height":1e99}"#,
        &deep,
    ] {
        client
            .socket
            .send(Message::Text(text.to_string().into()))
            .unwrap();
    }
    client
        .socket
        .send(Message::Binary(vec![0; 1000].into()))
        .unwrap();
    client.send(&json!({ "type": "resize", "width": 4_000_000_000_u32, "height": 1 }));
    client.send(&json!({ "type": "capture", "width": 4_000_000_000_u32, "height": 4_000_000_000_u32, "samples": 9 }));
    client.panel(|panel| panel["hint"].is_string());
    // And without end.
    let mut refused = false;
    for _ in 0..2000 {
        refused |= client
            .socket
            .send(Message::Text("nonsense".into()))
            .is_err();
    }
    refused |= (0..2000).any(|_| client.read().is_err());
    assert!(refused, "a client that sends nonsense is left");
    // One message that is too large.
    let mut client = viewer.open(Some(&viewer.origin())).unwrap();
    let _ = client
        .socket
        .send(Message::Text(" ".repeat(20 << 20).into()));
    assert!((0..2000).any(|_| client.read().is_err()));
    viewer.lives();
}

#[test]
fn a_hundred_connections_are_cut_down_and_leave_room_afterwards() {
    let viewer = Viewer::start();
    let idle: Vec<TcpStream> = (0..100)
        .map(|_| TcpStream::connect(&viewer.host).unwrap())
        .collect();
    let closed = |stream: &TcpStream| {
        stream
            .set_read_timeout(Some(Duration::from_millis(10)))
            .unwrap();
        matches!((&mut &*stream).read(&mut [0]), Ok(0))
    };
    let refused = || idle.iter().filter(|stream| closed(stream)).count();
    let refused = (0..60).map(|_| refused()).find(|&n| n >= 60).unwrap();
    assert!(refused <= 80, "{refused}");
    drop(idle);
    // Room is made when the viewer notices that they have gone.
    let patient = || {
        (0..200).find_map(|_| {
            std::thread::sleep(Duration::from_millis(100));
            viewer.open(Some(&viewer.origin())).ok()
        })
    };
    let open: Vec<Client> = (0..4).map(|_| patient().unwrap()).collect();
    for _ in 0..2 {
        let error = viewer.open(Some(&viewer.origin())).err().unwrap();
        assert!(error.contains("503"), "{error}");
    }
    drop(open);
    // One more might come before the viewer has noticed that the others have gone.
    patient().unwrap().is_shown_pictures();
}

#[test]
fn a_bare_manifold_is_flown_through_and_its_file_s_mistakes_are_shown_until_they_are_mended() {
    let viewer = Viewer::start();
    let mut client = viewer.open(Some(&viewer.origin())).unwrap();
    client.send(&json!({ "type": "resize", "width": 160, "height": 90 }));
    let number =
        |patch: &[u8], i: usize| u32::from_le_bytes(std::array::from_fn(|k| patch[4 * i + k]));
    // Pictures of the size before may be on their way.
    let asked = |patch: &Vec<u8>| number(patch, 2) <= 160 && number(patch, 3) <= 90;
    let patch = (0..1000).map(|_| client.patch()).find(asked).unwrap();
    assert_eq!(
        patch.len() as u32,
        32 + 4 * number(&patch, 6) * number(&patch, 7)
    );
    let start = client.panel(|panel| panel["seconds"].is_number());
    assert_eq!(start["kind"], "exact");
    // Forwards for a while.
    let hold = |forwards: f64| json!({ "type": "hold", "go": [0, 0, forwards], "turn": [0, 0], "roll": 0, "fast": false });
    client.send(&hold(1.0));
    client.panel(|panel| panel["pose"]["at"] != start["pose"]["at"]);
    client.send(&hold(0.0));
    // What is in the middle of the picture.
    client.send(&json!({ "type": "pick", "x": 0.5, "y": 0.5 }));
    let picked = client.panel(|panel| panel["picked"].is_object());
    assert!(picked["picked"]["points"].as_array().unwrap().len() > 10);
    // A mistake and its mending.
    let file = viewer.folder.path().join("m.toml");
    std::thread::sleep(Duration::from_millis(50));
    fs::write(
        &file,
        FLAT.replace("conformal = \"n\"", "conformal = \"oops\""),
    )
    .unwrap();
    let broken = client.panel(|panel| panel["trouble"].is_string());
    let trouble = broken["trouble"].as_str().unwrap();
    assert!(
        trouble.contains("m.toml:3") && trouble.contains("oops"),
        "{trouble}"
    );
    fs::write(&file, FLAT.replace("\"flat\"", "\"flat again\"")).unwrap();
    let mended = client.panel(|panel| panel["trouble"].is_null());
    assert_eq!(mended["manifold"], "flat again");
    // Another parameter.
    client.send(&json!({ "type": "parameter", "name": "n", "value": 2.0 }));
    client.panel(|panel| panel["parameters"] == json!([["n", 2.0]]));
}

/// Runs `geofan view` to its end; returns exit code and stderr.
fn refused(arguments: &[&str], folder: &Path) -> (i32, String) {
    let output = Command::new(cargo_bin!("geofan"))
        .arg("view")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code().unwrap(), text)
}

#[test]
fn what_cannot_be_viewed_is_refused_with_what_to_do() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), FLAT).unwrap();
    let (code, text) = refused(
        &["m.toml", "--no-open", "--listen", "0.0.0.0:0"],
        folder.path(),
    );
    assert!(code == 2 && text.contains("this machine only"), "{text}");
    let (code, text) = refused(&["missing.toml", "--no-open"], folder.path());
    assert!(code == 2 && text.contains("missing.toml"), "{text}");
    let missing = ["m.toml", "--page", "out.html", "--wasm", "none.wasm"];
    let (code, text) = refused(&missing, folder.path());
    assert!(code == 2 && text.contains("none.wasm"), "{text}");
    fs::write(folder.path().join("no.wasm"), "text").unwrap();
    let wrong = ["m.toml", "--page", "out.html", "--wasm", "no.wasm"];
    let (code, text) = refused(&wrong, folder.path());
    assert!(code == 2 && text.contains("not WebAssembly"), "{text}");
    let idle = ["m.toml", "--page", "out.html", "--no-bake"];
    let (code, text) = refused(&idle, folder.path());
    assert!(code == 2 && text.contains("--no-bake"), "{text}");
}

#[test]
fn a_page_takes_the_place_of_no_file_that_it_is_made_of_and_comes_with_the_scene_s_warnings() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
    // Named like the page itself.
    write("m.html", FLAT.as_bytes());
    write("any.wasm", b"\0asm\x01\0\0\0");
    write(
        "t.obj",
        b"mtllib missing.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    );
    write(
        "s.toml",
        b"manifold = 'm.html'\ncamera = { at = [0, 0, 0], look = [1, 0, 0], up = [0, 0, 1] }\n[[object]]\nmesh = 't.obj'\nat = [3, 0, 0]\n",
    );
    let arguments = ["s.toml", "--page", "s.html", "--wasm", "any.wasm"];
    let (code, text) = refused(&arguments, folder.path());
    assert!(code == 0 && text.contains("missing.mtl"), "{text}");
    let arguments = ["m.html", "--page", "m.html", "--wasm", "any.wasm"];
    let (code, text) = refused(&arguments, folder.path());
    assert!(code == 2 && text.contains("would be replaced"), "{text}");
    assert_eq!(
        fs::read(folder.path().join("m.html")).unwrap(),
        FLAT.as_bytes()
    );
}

#[test]
fn a_page_is_one_file_or_a_folder_that_asks_nobody_and_tells_nothing_of_the_disk() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), FLAT).unwrap();
    // Not a viewer, but it begins like one: a page is written, whatever it is.
    fs::write(folder.path().join("any.wasm"), b"\0asm\x01\0\0\0").unwrap();
    for output in ["out.html", "OUT.HTM", "site"] {
        let arguments = ["m.toml", "--page", output, "--wasm", "any.wasm"];
        let (code, text) = refused(&arguments, folder.path());
        assert_eq!(code, 0, "{text}");
    }
    let bytes = fs::read(folder.path().join("out.html")).unwrap();
    assert_eq!(fs::read(folder.path().join("OUT.HTM")).unwrap(), bytes);
    assert!(bytes.starts_with(&[0xFF, 0xFE]) && bytes.len().is_multiple_of(2));
    let units = bytes[2..]
        .chunks(2)
        .map(|two| u16::from_le_bytes([two[0], two[1]]));
    let page = String::from_utf16(&units.collect::<Vec<_>>()).unwrap();
    assert!(page.contains("connect-src 'none'") && page.contains("id=\"geofan-space\""));
    let named = page.replace("href=\"data:,\"", "");
    assert!(!named.contains("src=\"") && !named.contains("href=\""));
    assert!(!page.contains("\nimport ") && !page.contains("\nexport "));
    for file in [
        "index.html",
        "viewer.js",
        "worker.js",
        "style.css",
        "space.lzma",
    ] {
        assert!(folder.path().join("site").join(file).is_file(), "{file}");
    }
    // A page takes the place of one before it, and of nothing else.
    let site = ["m.toml", "--page", "site", "--wasm", "any.wasm"];
    assert_eq!(refused(&site, folder.path()).0, 0);
    fs::remove_file(folder.path().join("site/space.lzma")).unwrap();
    fs::write(folder.path().join("site/index.html"), "own").unwrap();
    let (code, text) = refused(&site, folder.path());
    assert!(code == 2 && text.contains("is no page of geofan"), "{text}");
    let index = fs::read(folder.path().join("site/index.html")).unwrap();
    assert_eq!(index, b"own");
}
