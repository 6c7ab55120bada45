//! A file layer that fails, or loses power, at one event: loaded in front of the C library (`LD_PRELOAD`) by
//! `tests/file_faults.rs`, which compiles it.
//!
//! Events are openings for writing, writes, syncs and renames of files below the folder `GEOFAN_FAULT_FOLDER`.
//! `GEOFAN_FAULT=N:ACTION` does one of these at the N-th, from 1:
//!
//! | action | |
//! |---|---|
//! | `full` | it fails as on a full disk; so do all later writes and openings |
//! | `failing` | it fails as on a broken disk, this once |
//! | `short` | half of the bytes are written, the next write fails as on a full disk |
//! | `killed` | the process ends before it |
//! | `power` | likewise, and bytes that were never synced are lost |
//!
//! `GEOFAN_FAULT=count` does nothing, and the number of events is written to the file `GEOFAN_FAULT_COUNT` when the
//! process ends.

use std::{
    cell::Cell,
    collections::HashMap,
    env,
    ffi::{CStr, CString, c_char, c_int, c_void},
    os::unix::ffi::OsStrExt,
    path::Path,
    sync::{Mutex, OnceLock},
};

const ENOSPC: c_int = 28;
const EIO: c_int = 5;
const O_ACCMODE: c_int = 3;
const O_TRUNC: c_int = 0o1000;
const SIGKILL: c_int = 9;
const RTLD_NEXT: *mut c_void = -1_isize as *mut c_void;

unsafe extern "C" {
    fn dlsym(handle: *mut c_void, name: *const c_char) -> *mut c_void;
    fn __errno_location() -> *mut c_int;
    fn kill(process: c_int, signal: c_int) -> c_int;
    fn getpid() -> c_int;
    fn ftruncate(file: c_int, length: i64) -> c_int;
    fn lseek(file: c_int, offset: i64, whence: c_int) -> i64;
    fn readlink(path: *const c_char, buffer: *mut c_char, size: usize) -> isize;
}

/// A file that was opened for writing.
struct Written {
    /// Another opening of it, which stays.
    kept: c_int,
    /// Bytes that a sync has put on the disk.
    synced: i64,
}

#[derive(Default)]
struct Layer {
    files: HashMap<c_int, Written>,
    events: u64,
    /// Set from the fault on, where it lasts.
    full: bool,
}

struct Fault {
    folder: Vec<u8>,
    /// The number of the event, and the action; none where events are counted.
    at: Option<(u64, String)>,
}

static LAYER: Mutex<Option<Layer>> = Mutex::new(None);
static FAULT: OnceLock<Option<Fault>> = OnceLock::new();

thread_local! {
    /// Set while the layer works: what it calls itself is no event.
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

fn fault() -> Option<&'static Fault> {
    let read = || {
        let folder = env::var_os("GEOFAN_FAULT_FOLDER")?;
        let text = env::var("GEOFAN_FAULT").ok()?;
        let at = text.split_once(':').and_then(|(number, action)| Some((number.parse().ok()?, action.into())));
        Some(Fault { folder: folder.as_bytes().to_vec(), at })
    };
    FAULT.get_or_init(read).as_ref()
}

/// Finds the function that this one stands in front of.
unsafe fn next(name: &CStr) -> *mut c_void {
    unsafe { dlsym(RTLD_NEXT, name.as_ptr()) }
}

fn fail(code: c_int) {
    unsafe { *__errno_location() = code }
}

/// What becomes of an event.
enum Verdict {
    Goes,
    Half,
    Fails(c_int),
}

/// Counts an event and decides about it; `writes` if it needs room on the disk.
fn event(layer: &mut Layer, writes: bool) -> Verdict {
    layer.events += 1;
    if layer.full && writes {
        return Verdict::Fails(ENOSPC);
    }
    let Some((number, action)) = fault().and_then(|fault| fault.at.as_ref()) else {
        return Verdict::Goes;
    };
    if layer.events != *number {
        return Verdict::Goes;
    }
    match action.as_str() {
        "full" => {
            layer.full = true;
            Verdict::Fails(ENOSPC)
        }
        "short" => {
            layer.full = true;
            Verdict::Half
        }
        "failing" => Verdict::Fails(EIO),
        "power" => {
            for file in layer.files.values() {
                unsafe { ftruncate(file.kept, file.synced) };
            }
            unsafe { kill(getpid(), SIGKILL) };
            Verdict::Fails(EIO)
        }
        _ => {
            unsafe { kill(getpid(), SIGKILL) };
            Verdict::Fails(EIO)
        }
    }
}

/// Runs `work` on the layer; `None` within the layer itself, and where there is no fault.
fn layered<T>(work: impl FnOnce(&mut Layer) -> T) -> Option<T> {
    if INSIDE.get() {
        return None;
    }
    fault()?;
    INSIDE.set(true);
    let mut layer = LAYER.lock().ok()?;
    let done = work(layer.get_or_insert_default());
    drop(layer);
    INSIDE.set(false);
    Some(done)
}

fn ours(path: &CStr) -> bool {
    let Some(fault) = fault() else { return false };
    let path = Path::new(std::ffi::OsStr::from_bytes(path.to_bytes()));
    let whole = match path.is_absolute() {
        true => path.to_path_buf(),
        false => env::current_dir().unwrap_or_default().join(path),
    };
    whole.as_os_str().as_bytes().starts_with(&fault.folder)
}

/// Tells whether an open file is below the folder.
fn ours_open(file: c_int) -> bool {
    let link = CString::new(format!("/proc/self/fd/{file}")).unwrap_or_default();
    let mut buffer = [0 as c_char; 4096];
    let length = unsafe { readlink(link.as_ptr(), buffer.as_mut_ptr(), buffer.len() - 1) };
    length > 0 && ours(unsafe { CStr::from_ptr(buffer.as_ptr()) })
}

type Open = unsafe extern "C" fn(*const c_char, c_int, c_int) -> c_int;

unsafe fn opened(name: &CStr, path: *const c_char, flags: c_int, mode: c_int) -> c_int {
    let real: Open = unsafe { std::mem::transmute(next(name)) };
    let writes = flags & O_ACCMODE != 0;
    let verdict = layered(|layer| match writes && ours(unsafe { CStr::from_ptr(path) }) {
        true => Some(event(layer, true)),
        false => None,
    });
    let Some(Some(verdict)) = verdict else {
        return unsafe { real(path, flags, mode) };
    };
    if let Verdict::Fails(code) = verdict {
        fail(code);
        return -1;
    }
    let file = unsafe { real(path, flags, mode) };
    if file >= 0 {
        layered(|layer| {
            let again = CString::new(format!("/proc/self/fd/{file}")).unwrap_or_default();
            let kept = unsafe { real(again.as_ptr(), 1, 0) };
            let length = if flags & O_TRUNC != 0 { 0 } else { unsafe { lseek(kept, 0, 2) } };
            layer.files.insert(file, Written { kept, synced: length.max(0) });
        });
    }
    file
}

#[unsafe(no_mangle)]
unsafe extern "C" fn open64(path: *const c_char, flags: c_int, mode: c_int) -> c_int {
    unsafe { opened(c"open64", path, flags, mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn open(path: *const c_char, flags: c_int, mode: c_int) -> c_int {
    unsafe { opened(c"open", path, flags, mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn write(file: c_int, bytes: *const c_void, count: usize) -> isize {
    type Write = unsafe extern "C" fn(c_int, *const c_void, usize) -> isize;
    let real: Write = unsafe { std::mem::transmute(next(c"write")) };
    let verdict = layered(|layer| match layer.files.contains_key(&file) && ours_open(file) {
        true => event(layer, true),
        false => Verdict::Goes,
    });
    match verdict {
        None | Some(Verdict::Goes) => unsafe { real(file, bytes, count) },
        Some(Verdict::Half) => unsafe { real(file, bytes, count.div_ceil(2)) },
        Some(Verdict::Fails(code)) => {
            fail(code);
            -1
        }
    }
}

unsafe fn synced(name: &CStr, file: c_int) -> c_int {
    type Sync = unsafe extern "C" fn(c_int) -> c_int;
    let real: Sync = unsafe { std::mem::transmute(next(name)) };
    let verdict = layered(|layer| {
        if !ours_open(file) {
            return Verdict::Goes;
        }
        let verdict = event(layer, false);
        if let (Verdict::Goes, Some(known)) = (&verdict, layer.files.get_mut(&file)) {
            known.synced = unsafe { lseek(known.kept, 0, 2) };
        }
        verdict
    });
    match verdict {
        Some(Verdict::Fails(code)) => {
            fail(code);
            -1
        }
        _ => unsafe { real(file) },
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fsync(file: c_int) -> c_int {
    unsafe { synced(c"fsync", file) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fdatasync(file: c_int) -> c_int {
    unsafe { synced(c"fdatasync", file) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn rename(from: *const c_char, to: *const c_char) -> c_int {
    type Rename = unsafe extern "C" fn(*const c_char, *const c_char) -> c_int;
    let real: Rename = unsafe { std::mem::transmute(next(c"rename")) };
    let verdict = layered(|layer| match ours(unsafe { CStr::from_ptr(to) }) {
        true => event(layer, false),
        false => Verdict::Goes,
    });
    match verdict {
        Some(Verdict::Fails(code)) => {
            fail(code);
            -1
        }
        _ => unsafe { real(from, to) },
    }
}

/// Tells how many events there were.
extern "C" fn tell() {
    let Some(path) = env::var_os("GEOFAN_FAULT_COUNT") else { return };
    INSIDE.set(true);
    let events = LAYER.lock().ok().and_then(|layer| layer.as_ref().map(|layer| layer.events));
    let _ = std::fs::write(path, events.unwrap_or(0).to_string());
}

#[used]
#[unsafe(link_section = ".fini_array")]
static TELL: extern "C" fn() = tell;
