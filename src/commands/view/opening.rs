//! Opening the browser on the viewer's address, which nobody else is to learn.
//!
//! In: an address. Out: a browser that shows it. Other users of the machine can read the command line that asks for that,
//! and a browser may keep it as its own for days. So the address in it has no token but a [`Ticket`], which leads to the
//! whole address once, and where the system tells who connects (on Linux) this user only. A private file that leads there
//! would do, too, but browsers in a sandbox can read no private file.

use std::{
    net::SocketAddr,
    process::{Command, ExitStatus, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

/// Time in which a browser that cannot be opened says so.
const SOON: Duration = Duration::from_secs(5);

/// A secret word that opens a door once.
pub struct Ticket {
    word: String,
    taken: AtomicBool,
}

impl Ticket {
    /// Makes a ticket of a secret word.
    pub fn new(word: String) -> Self {
        let taken = AtomicBool::new(false);
        Self { word, taken }
    }

    /// Returns the word.
    pub fn word(&self) -> &str {
        &self.word
    }

    /// Takes the ticket, if this is its word and nobody has.
    pub fn take(&self, word: &str) -> bool {
        is_same(word, &self.word) && !self.taken.swap(true, Ordering::Relaxed)
    }
}

/// Tells whether a word is a secret one. Hashes are compared, so that the time that it takes says nothing about that.
pub fn is_same(word: &str, secret: &str) -> bool {
    blake3::hash(word.as_bytes()) == blake3::hash(secret.as_bytes())
}

/// Tells whether the system says that a connection from `peer` to `own`, both on this machine, is another user's.
#[cfg(target_os = "linux")]
pub fn is_of_another_user(peer: SocketAddr, own: SocketAddr) -> bool {
    use std::{fs, os::unix::fs::MetadataExt};
    let table = match peer {
        SocketAddr::V4(_) => "/proc/net/tcp",
        SocketAddr::V6(_) => "/proc/net/tcp6",
    };
    let (Ok(table), Ok(this)) = (fs::read_to_string(table), fs::metadata("/proc/self")) else {
        return false;
    };
    // Who may do everything learns everything, and carries connections for others.
    is_listed(&table, [peer, own], [this.uid(), 0])
}

/// Tells whether a table of connections, as Linux writes it, has one between these ends of a user that is not `trusted`.
#[cfg(target_os = "linux")]
fn is_listed(table: &str, ends: [SocketAddr; 2], trusted: [u32; 2]) -> bool {
    let trusted = trusted.map(|user| user.to_string());
    let [from, to] = ends.map(|address| format!(":{:04X}", address.port()));
    table.lines().any(|line| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        // Number, the connection's two ends, its state, three fields about its buffers and clocks, the user.
        let [_, local, remote, _, _, _, _, user, ..] = fields[..] else {
            return false;
        };
        local.ends_with(&from) && remote.ends_with(&to) && !trusted.iter().any(|one| one == user)
    })
}

/// Tells nothing where the system does not.
#[cfg(not(target_os = "linux"))]
pub fn is_of_another_user(_: SocketAddr, _: SocketAddr) -> bool {
    false
}

/// Asks the system to open an address, and says so if it cannot.
pub fn open_browser(address: &str) {
    let (program, first): (&str, &[&str]) = match std::env::consts::OS {
        "macos" => ("open", &[]),
        "windows" => ("rundll32", &["url.dll,FileProtocolHandler"]),
        _ => ("xdg-open", &[]),
    };
    let mut command = Command::new(program);
    command.args(first).arg(address).stdin(Stdio::null());
    command.stdout(Stdio::null()).stderr(Stdio::null());
    // It may stay as long as the browser, and then its end says nothing.
    std::thread::spawn(move || {
        let began = Instant::now();
        let opened = |status: ExitStatus| status.success() || began.elapsed() > SOON;
        if !command.status().is_ok_and(opened) {
            tracing::warn!("no browser could be opened; open the address by hand");
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn a_ticket_is_taken_once_and_by_its_word_only() {
        let ticket = Ticket::new("word".into());
        assert!(!ticket.take("other") && !ticket.take(""));
        assert!(ticket.take(ticket.word()) && !ticket.take("word"));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn another_user_s_connection_is_found_in_the_table() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n   \
            0: 0100007F:1F90 0100007F:C350 01 00000000:00000000 00:00000000 00000000     0        0 1 1\n   \
            1: 0100007F:C350 0100007F:1F90 01 00000000:00000000 00:00000000 00000000  1000        0 2 1\n";
        let ends = ["127.0.0.1:50000", "127.0.0.1:8080"].map(|end| end.parse().unwrap());
        assert!(is_listed(table, ends, [1001, 0]));
        assert!(!is_listed(table, ends, [1000, 0]));
        let others = ["127.0.0.1:50001", "127.0.0.1:8080"].map(|end| end.parse().unwrap());
        assert!(!is_listed(table, others, [1001, 0]));
    }

    #[test]
    fn this_user_s_own_connections_are_no_other_user_s() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let own = listener.local_addr().unwrap();
        let stream = TcpStream::connect(own).unwrap();
        assert!(!is_of_another_user(stream.local_addr().unwrap(), own));
    }
}
