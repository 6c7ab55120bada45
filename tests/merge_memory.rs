//! The memory of a merge does not grow with its shards.
//!
//! An ordinary run joins a few megabytes; `GEOFAN_MERGE_MB=1000 cargo test --release --workspace --test merge_memory --
//! --nocapture` joins a gigabyte, within the same limit.

#![cfg(target_os = "linux")]

use geofan_bundle::{
    Contents, PlanRecord, Polynomial, ShardRecord, StepSize, Train, Tree, Variables, rays::RaySpace,
};
use geofan_core::{diagnostic::SourceText, manifold::Manifold, random::Stream};
use ndarray::{ArrayD, IxDyn};
use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    sync::Arc,
    time::{Duration, Instant},
};

const FLAT: &str = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
                    [cameras]\nparameters = { c = [-1, 1] }\nat = ['c', '0', '0']\nlength = 5\n";

/// Kilobytes of address space that a merge gets: threads and their stacks have their share of it.
const MOST: u64 = 1_000_000;

/// Megabytes of shards in an ordinary run.
const USUAL: u64 = 3;

const SHARDS: u32 = 4;

/// A chunk of random numbers: nothing makes it smaller.
fn chunk(plan: &PlanRecord) -> Vec<u8> {
    let mut stream = Stream::new(&[3]);
    let shape: Vec<usize> = plan.nodes.iter().map(|n| *n as usize).chain([3]).collect();
    let polynomial = Polynomial {
        coefficients: ArrayD::from_shape_simple_fn(IxDyn(&shape), || 1e-4 * stream.uniform()),
        variables: Variables::of_face(1, plan.mapping),
    };
    let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-8));
    Tree::Leaf(Arc::new(tensor.unwrap())).encode()
}

/// The whole of a table of about so many bytes, whose chunks are all the same, and its chunk.
fn table(bytes: u64) -> (Contents, Vec<u8>) {
    let manifold = Manifold::from_source(SourceText::new("flat.toml", FLAT), &[]).unwrap();
    let space = RaySpace::new(Arc::new(manifold)).unwrap();
    let plan = |cells: u32| PlanRecord::new(5.0, 0.5, vec![cells], vec![4, 10, 10, 12]);
    let chunk = chunk(&plan(1));
    let cells = bytes.div_ceil(6 * chunk.len() as u64) as u32;
    let contents = Contents::new(space, plan(cells), 1600, Vec::new()).unwrap();
    (contents, chunk)
}

/// Writes a shard of the table.
fn write_shard(contents: &Contents, chunk: &[u8], index: u32, folder: &Path) {
    let mut shard = contents.clone();
    let all = 6 * contents.header.plan.cells[0];
    let own = (0..all).filter(|k| k % SHARDS == index - 1);
    shard.chunks = own.map(|k| (k, chunk.to_vec())).collect();
    shard.header.shard = Some(ShardRecord {
        index,
        of: SHARDS,
        exact_rays: 1,
    });
    shard.write(&folder.join(format!("{index}.fan"))).unwrap();
}

/// Runs the program within the limit; returns the most memory it held, kB.
fn merge(folder: &Path) -> u64 {
    let program = env!("CARGO_BIN_EXE_geofan");
    let shards: Vec<String> = (1..=SHARDS).map(|k| format!("{k}.fan")).collect();
    let command = format!(
        "ulimit -v {MOST}; exec {program} --threads 2 merge {} -o b.fan --quiet --json",
        shards.join(" ")
    );
    let mut child = Command::new("sh")
        .current_dir(folder)
        .args(["-c", &command])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut most = 0;
    loop {
        let status = format!("/proc/{}/status", child.id());
        let status = fs::read_to_string(status).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let held = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        most = held.unwrap_or(0).max(most);
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{status}");
            return most;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn shards_of_any_size_are_joined_within_the_same_memory() {
    let given = std::env::var("GEOFAN_MERGE_MB").ok();
    let megabytes = given.and_then(|n| n.parse().ok()).unwrap_or(USUAL);
    let folder = tempfile::tempdir().unwrap();
    let (contents, chunk) = table(megabytes * 1_000_000);
    for index in 1..=SHARDS {
        write_shard(&contents, &chunk, index, folder.path());
    }
    let began = Instant::now();
    let most = merge(folder.path());
    let size = fs::metadata(folder.path().join("b.fan")).unwrap().len();
    println!(
        "{} bytes: {most} kB, {:.1} s",
        size,
        began.elapsed().as_secs_f64()
    );
    // Every chunk is there.
    let chunks = u64::from(6 * contents.header.plan.cells[0]);
    assert!(size > chunks * chunk.len() as u64 && size < chunks * (chunk.len() as u64 + 80) + 4000);
}
