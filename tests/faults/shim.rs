//! A file layer that fails, or loses power, at one event: loaded in front of the C library (`LD_PRELOAD`) by
//! `tests/file_faults.rs`, which compiles it.
//!
//! Events are openings for writing, writes, syncs and renames of files below the folder `GEOFAN_FAULT_FOLDER`; apart
//! from these, openings for reading and reads there; and allocations of [`LARGE`] bytes or more.
//! `GEOFAN_FAULT=N:ACTION` does one of these at the N-th of its kind, from 1:
//!
//! | action | kind | |
//! |---|---|---|
//! | `full` | write | it fails as on a full disk; so do all later writes and openings |
//! | `failing` | write | it fails as on a broken disk, this once |
//! | `short` | write | half of the bytes are written, the next write fails as on a full disk |
//! | `killed` | write | the process ends before it |
//! | `power` | write | likewise, and bytes that were never synced are lost |
//! | `undone` | write | likewise, and renames into a folder that was not synced behind them are undone |
//! | `unreadable` | read | it fails as on a broken disk, this once |
//! | `memory` | allocation | it fails, and so do all later ones of this size |
//!
//! `GEOFAN_FAULT=count` does nothing, and the numbers of events of the three kinds are written to the file
//! `GEOFAN_FAULT_COUNT` when the process ends.

use std::{
    cell::Cell,
    collections::HashMap,
    env,
    ffi::{CStr, CString, c_char, c_int, c_void},
    os::unix::ffi::{OsStrExt, OsStringExt},
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

const ENOSPC: c_int = 28;
const EIO: c_int = 5;
const ENOMEM: c_int = 12;
const O_ACCMODE: c_int = 3;
const O_TRUNC: c_int = 0o1000;
const O_DIRECTORY: c_int = 0o200000;
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
    fn __libc_malloc(bytes: usize) -> *mut c_void;
    fn __libc_calloc(count: usize, bytes: usize) -> *mut c_void;
    fn __libc_realloc(old: *mut c_void, bytes: usize) -> *mut c_void;
    fn __libc_memalign(alignment: usize, bytes: usize) -> *mut c_void;
}

/// A file that was opened for writing.
struct Written {
    /// Another opening of it, which stays.
    kept: c_int,
    /// Bytes that a sync has put on the disk.
    synced: i64,
}

/// A rename that its folder does not know yet for good.
struct Renamed {
    from: PathBuf,
    to: PathBuf,
    /// What was there before, under another name beside the folder.
    before: Option<PathBuf>,
}

#[derive(Default)]
struct Layer {
    files: HashMap<c_int, Written>,
    renames: Vec<Renamed>,
    events: u64,
    reads: u64,
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
        "power" | "undone" => {
            for file in layer.files.values() {
                unsafe { ftruncate(file.kept, file.synced) };
            }
            if action == "undone" {
                layer.undo_renames();
            }
            unsafe { kill(getpid(), SIGKILL) };
            Verdict::Fails(EIO)
        }
        // Of another kind.
        "unreadable" | "memory" => Verdict::Goes,
        _ => {
            unsafe { kill(getpid(), SIGKILL) };
            Verdict::Fails(EIO)
        }
    }
}

impl Layer {
    /// Puts names back to where they were before the renames that no sync has followed, the last first.
    fn undo_renames(&mut self) {
        for Renamed { from, to, before } in self.renames.drain(..).rev() {
            let _ = std::fs::rename(&to, &from);
            if let Some(before) = before {
                let _ = std::fs::rename(before, &to);
            }
        }
    }

    /// Remembers a rename that is about to be done.
    fn note_rename(&mut self, from: &CStr, to: &CStr) {
        let [from, to] = [from, to].map(whole_path);
        let folder = fault().map(|fault| fault.folder.clone()).unwrap_or_default();
        let mut beside = std::ffi::OsString::from_vec(folder);
        beside.push(format!(".before-{}", self.events));
        let before = PathBuf::from(beside);
        let before = std::fs::hard_link(&to, &before).is_ok().then_some(before);
        self.renames.push(Renamed { from, to, before });
    }

    /// Forgets the renames into a folder that has been synced.
    fn keep_renames(&mut self, folder: &Path) {
        let (kept, open) = self.renames.drain(..).partition(|renamed| renamed.to.parent() == Some(folder));
        self.renames = open;
        let kept: Vec<Renamed> = kept;
        for renamed in kept {
            let _ = renamed.before.map(std::fs::remove_file);
        }
    }
}

/// Counts a reading and decides about it.
fn reading(layer: &mut Layer) -> Verdict {
    layer.reads += 1;
    match fault().and_then(|fault| fault.at.as_ref()) {
        Some((number, action)) if action == "unreadable" && layer.reads == *number => Verdict::Fails(EIO),
        _ => Verdict::Goes,
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

fn whole_path(path: &CStr) -> PathBuf {
    let path = Path::new(std::ffi::OsStr::from_bytes(path.to_bytes()));
    match path.is_absolute() {
        true => path.to_path_buf(),
        false => env::current_dir().unwrap_or_default().join(path),
    }
}

fn ours(path: &CStr) -> bool {
    let Some(fault) = fault() else { return false };
    let whole = whole_path(path);
    whole.as_os_str().as_bytes().starts_with(&fault.folder)
}

/// The path of an open file.
fn path_of(file: c_int) -> Option<CString> {
    let link = CString::new(format!("/proc/self/fd/{file}")).unwrap_or_default();
    let mut buffer = [0 as c_char; 4096];
    let length = unsafe { readlink(link.as_ptr(), buffer.as_mut_ptr(), buffer.len() - 1) };
    (length > 0).then(|| unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_owned())
}

/// Tells whether an open file is below the folder.
fn ours_open(file: c_int) -> bool {
    path_of(file).is_some_and(|path| ours(&path))
}

type Open = unsafe extern "C" fn(*const c_char, c_int, c_int) -> c_int;

unsafe fn opened(name: &CStr, path: *const c_char, flags: c_int, mode: c_int) -> c_int {
    let real: Open = unsafe { std::mem::transmute(next(name)) };
    let writes = flags & O_ACCMODE != 0;
    let verdict = layered(|layer| match (ours(unsafe { CStr::from_ptr(path) }), writes) {
        (true, true) => Some(event(layer, true)),
        (true, false) if flags & O_DIRECTORY == 0 => Some(reading(layer)),
        _ => None,
    });
    let Some(Some(verdict)) = verdict else {
        return unsafe { real(path, flags, mode) };
    };
    if let Verdict::Fails(code) = verdict {
        fail(code);
        return -1;
    }
    let file = unsafe { real(path, flags, mode) };
    if file >= 0 && writes {
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

#[unsafe(no_mangle)]
unsafe extern "C" fn read(file: c_int, bytes: *mut c_void, count: usize) -> isize {
    type Read = unsafe extern "C" fn(c_int, *mut c_void, usize) -> isize;
    let real: Read = unsafe { std::mem::transmute(next(c"read")) };
    let verdict = layered(|layer| match ours_open(file) {
        true => reading(layer),
        false => Verdict::Goes,
    });
    match verdict {
        Some(Verdict::Fails(code)) => {
            fail(code);
            -1
        }
        _ => unsafe { real(file, bytes, count) },
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
        if let Verdict::Goes = verdict {
            if let Some(known) = layer.files.get_mut(&file) {
                known.synced = unsafe { lseek(known.kept, 0, 2) };
            }
            if let Some(path) = path_of(file) {
                layer.keep_renames(&whole_path(&path));
            }
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
    let verdict = layered(|layer| {
        if !ours(unsafe { CStr::from_ptr(to) }) {
            return Verdict::Goes;
        }
        let verdict = event(layer, false);
        if let Verdict::Goes = verdict {
            layer.note_rename(unsafe { CStr::from_ptr(from) }, unsafe { CStr::from_ptr(to) });
        }
        verdict
    });
    match verdict {
        Some(Verdict::Fails(code)) => {
            fail(code);
            -1
        }
        _ => unsafe { real(from, to) },
    }
}

/// Allocations of fewer bytes are no events: there are millions of them, and what they lead to is the same.
const LARGE: usize = 16 << 10;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

/// The first allocation that fails. Read once when the process starts, because reading it allocates.
static FIRST_FAILING: AtomicU64 = AtomicU64::new(u64::MAX);

/// Counts an allocation and tells whether it goes on. Without the layer's lock and memory of its own: these would
/// allocate.
fn allocates(bytes: usize) -> bool {
    let goes = bytes < LARGE || ALLOCATIONS.fetch_add(1, Relaxed) + 1 < FIRST_FAILING.load(Relaxed);
    if !goes {
        fail(ENOMEM);
    }
    goes
}

#[unsafe(no_mangle)]
unsafe extern "C" fn malloc(bytes: usize) -> *mut c_void {
    match allocates(bytes) {
        true => unsafe { __libc_malloc(bytes) },
        false => std::ptr::null_mut(),
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn calloc(count: usize, bytes: usize) -> *mut c_void {
    match allocates(count.saturating_mul(bytes)) {
        true => unsafe { __libc_calloc(count, bytes) },
        false => std::ptr::null_mut(),
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn realloc(old: *mut c_void, bytes: usize) -> *mut c_void {
    match allocates(bytes) {
        true => unsafe { __libc_realloc(old, bytes) },
        false => std::ptr::null_mut(),
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn posix_memalign(place: *mut *mut c_void, alignment: usize, bytes: usize) -> c_int {
    let made = match allocates(bytes) {
        true => unsafe { __libc_memalign(alignment, bytes) },
        false => std::ptr::null_mut(),
    };
    if made.is_null() {
        return ENOMEM;
    }
    unsafe { *place = made };
    0
}

/// Learns when the process starts which allocation fails.
extern "C" fn begin() {
    let text = env::var("GEOFAN_FAULT").unwrap_or_default();
    if let Some((number, "memory")) = text.split_once(':') {
        FIRST_FAILING.store(number.parse().unwrap_or(u64::MAX), Relaxed);
    }
}

#[used]
#[unsafe(link_section = ".init_array")]
static BEGIN: extern "C" fn() = begin;

/// Tells how many events there were.
extern "C" fn tell() {
    let Some(path) = env::var_os("GEOFAN_FAULT_COUNT") else { return };
    INSIDE.set(true);
    let allocations = ALLOCATIONS.load(Relaxed);
    let layer = LAYER.lock().ok();
    let counts = layer.and_then(|layer| layer.as_ref().map(|layer| (layer.events, layer.reads)));
    let (events, reads) = counts.unwrap_or_default();
    let _ = std::fs::write(path, format!("{events} {reads} {allocations}"));
}

#[used]
#[unsafe(link_section = ".fini_array")]
static TELL: extern "C" fn() = tell;
