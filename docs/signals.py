#!/usr/bin/env python3
"""Processor time that a bake takes from SIGTERM to its end: the figures of docs/trust.md.

    docs/signals.py SECONDS...       needs `cargo build --release --workspace`, or GEOFAN=program

Each bake of a box of cameras among three bumps, at 0.1 mrad on one thread, is ended after so many seconds of processor
time: its boxes are the largest there are.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
GEOFAN = os.environ.get("GEOFAN", os.path.join(ROOT, "target/release/geofan"))


def used(pid):
    """Seconds of processor time that a process has used."""
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ended_after(seconds):
    """Ends a bake after so many seconds; returns its exit code and the seconds that it took to end."""
    with tempfile.TemporaryDirectory() as folder:
        bumps = os.path.join(ROOT, "assets/manifolds/three-bumps.toml")
        command = [GEOFAN, "bake", bumps, "-o", os.path.join(folder, "b.fan"), "--max-error", "0.1"]
        bake = subprocess.Popen([*command, "--quiet", "--threads", "1"], stderr=subprocess.DEVNULL)
        while bake.poll() is None and used(bake.pid) < seconds:
            time.sleep(0.02)
        if bake.returncode is not None:
            sys.exit(f"the bake was done before {seconds:g} s")
        before = used(bake.pid)
        bake.send_signal(signal.SIGTERM)
        _, status, usage = os.wait4(bake.pid, 0)
        return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime - before


def main():
    """Prints a row for each moment."""
    worst = 0.0
    for seconds in map(float, sys.argv[1:]):
        code, took = ended_after(seconds)
        worst = max(worst, took)
        print(f"after {seconds:g} s: exit code {code}, {took:.2f} s", flush=True)
    print(f"at most {worst:.2f} s of processor time")


if __name__ == "__main__":
    main()
