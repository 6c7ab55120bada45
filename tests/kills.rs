//! Commands that are killed at any moment: what they leave is whole, and the same command ends with the bytes of one
//! that was never disturbed, and nothing else.
//!
//! An ordinary run kills each command a few times; `GEOFAN_KILLS=50 cargo test --release --workspace --test kills --
//! --nocapture` kills each fifty times. Moments are drawn over the time that the command takes, so that they are not the
//! same in every run; what must hold does not depend on them.

#![cfg(unix)]

#[macro_use]
#[path = "faults/commands.rs"]
mod commands;

use commands::{CASES, Case, Inputs, Wanted, done, geofan};
use geofan_core::random::Stream;
use std::{
    os::unix::process::ExitStatusExt,
    process::Stdio,
    time::{Duration, Instant},
};

const SIGKILL: i32 = 9;

/// Kills of each command in an ordinary run, and of one that takes long.
const USUAL: usize = 3;
const USUAL_SLOW: usize = 1;

/// Runs for each kill that are given up to those that ended before it came.
const TRIES: usize = 10;

/// Kills `case` so many times, each in a folder of its own or in that of the kill before, and ends it.
fn survives(case: &Case) {
    let kills = std::env::var("GEOFAN_KILLS").ok();
    let kills =
        kills
            .and_then(|n| n.parse().ok())
            .unwrap_or(if case.slow { USUAL_SLOW } else { USUAL });
    let inputs = Inputs::of(case);
    let calm = inputs.copy(case, false);
    let began = Instant::now();
    let reference = geofan(calm.path(), case.arguments).output().unwrap();
    let whole = began.elapsed();
    assert!(done(reference.status), "{}: {reference:?}", case.name);
    let wanted = Wanted::of(case, calm.path());
    let mut stream = Stream::new(&[case.name.len() as u64]);
    let (mut killed, mut tries) = (0, 0);
    // The machine may have become faster: after a run that ended by itself kills come sooner.
    let mut latest = whole;
    while killed < kills && tries < TRIES * kills {
        let old = stream.uniform() < 0.5;
        let folder = inputs.copy(case, old);
        // One in three is killed again when it goes on.
        let times = if stream.uniform() < 0.33 { 2 } else { 1 };
        for time in 0..times {
            tries += 1;
            let again = if time == 0 { "" } else { case.again };
            let arguments = format!("{}{again}", case.arguments);
            let after = latest.mul_f64(stream.uniform());
            let ended = killed_after(&mut geofan(folder.path(), &arguments), after);
            let about = format!("{} after {after:?}", case.name);
            assert!(
                ended.signal() == Some(SIGKILL) || done(ended),
                "{about}: {ended:?}"
            );
            match ended.signal() {
                Some(SIGKILL) => killed += 1,
                _ => latest = latest.mul_f64(0.7),
            }
            wanted.check_left(case, folder.path(), (old, done(ended)), &about);
        }
        wanted.check_again(case, folder.path(), case.name);
    }
    println!("{}: {killed} kills in {tries} runs", case.name);
    assert!(killed > 0, "{}: every run ended before its kill", case.name);
}

/// Runs a command and kills it after a while.
fn killed_after(command: &mut std::process::Command, after: Duration) -> std::process::ExitStatus {
    let command = command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    std::thread::sleep(after);
    // It may have ended: then there is nobody to kill.
    let _ = child.kill();
    child.wait().unwrap()
}

cases! {
    a_killed_bake_ends_with_the_same_bytes: 0;
    a_killed_merge_ends_with_the_same_bytes: 1;
    a_killed_sweep_ends_with_the_same_bytes: 2;
    a_killed_animation_ends_with_the_same_bytes: 3;
    a_killed_path_traced_picture_ends_with_the_same_bytes: 4;
    a_killed_page_ends_with_the_same_bytes: 5;
    a_killed_cache_of_light_ends_with_the_same_bytes: 6;
}
