#!/usr/bin/env python3
"""Memory of a viewer that is looked through, a path tracer and a bake, minute by minute: the table of docs/trust.md.

    docs/soak.py MINUTES             needs `cargo build --release --workspace`, or GEOFAN=program

The viewer turns, moves, picks, changes its way of drawing and its size without a pause, by messages as its page sends
them. The path tracer adds samples to one picture. The bake is one of 64,000 chunks that are all alike, because its space
looks the same from everywhere and does not say so: what it holds may grow by its finished chunks alone, some kilobytes
each. All are ended by SIGTERM. Written is the resident memory of each in MB, the most that it has held so far where
that is more, and what the bake's finished chunks take.
"""

import base64
import json
import os
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
GEOFAN = os.environ.get("GEOFAN", os.path.join(ROOT, "target/release/geofan"))
NICE = ["nice", "-n", "19", GEOFAN]


# A group with a metric that it leaves as it is, without the claim that would spare all cameras but one.
ALIKE = """name = "Nil that claims no symmetry"
coordinates = ["x", "y", "z"]
metric = { xx = "1", yy = "1 + x^2", zz = "1", yz = "-x" }
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 400"
[cameras]
parameters = { cx = [-1.0, 1.0], cy = [-1.0, 1.0], cz = [-1.0, 1.0] }
at = ["cx", "cy", "cz"]
length = 4.0
"""


def scene(name):
    return os.path.join(ROOT, "assets/scenes", name)


class Page:
    """What the viewer's page does, at random."""

    def __init__(self, address):
        host, token = address.removeprefix("http://").strip().rstrip("/").split("/")
        name, port = host.split(":")
        self.socket = socket.create_connection((name, int(port)), timeout=300)
        key = base64.b64encode(os.urandom(16)).decode()
        head = f"GET /{token}/socket HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\n"
        head += f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n"
        self.socket.sendall(head.encode())
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += self.socket.recv(1)
        if not answer.startswith(b"HTTP/1.1 101"):
            sys.exit(answer.decode())
        self.random = random.Random(1)
        self.frames = self.events = 0

    def take(self, count):
        data = b""
        while len(data) < count:
            part = self.socket.recv(count - len(data))
            if not part:
                raise ConnectionError("the viewer hung up")
            data += part
        return data

    def send(self, message):
        text = json.dumps(message).encode()
        mask = os.urandom(4)
        size = bytes([0x80 | len(text)]) if len(text) < 126 else bytes([0x80 | 126]) + struct.pack(">H", len(text))
        self.socket.sendall(b"\x81" + size + mask + bytes(b ^ mask[k % 4] for k, b in enumerate(text)))
        self.events += 1

    def message(self):
        head, size = self.take(2)
        size &= 127
        if size > 125:
            size = struct.unpack(*((">H", self.take(2)) if size == 126 else (">Q", self.take(8))))[0]
        return head & 15, self.take(size)

    def event(self):
        r = self.random
        kind = r.randrange(9)
        if kind < 3:
            go = [r.uniform(-1, 1) for _ in range(3)]
            return {"type": "hold", "go": go, "turn": [r.uniform(-1, 1), 0], "roll": 0, "fast": False}
        if kind < 5:
            return {"type": "look", "right": r.uniform(-0.1, 0.1), "down": r.uniform(-0.05, 0.05)}
        if kind == 5:
            return {"type": "pick", "x": r.random(), "y": r.random()}
        if kind == 6:
            split = r.choice([None, "exact", "flat"])
            return {"type": "show", "kind": r.choice(["table", "exact", "error"]), "split": split}
        if kind == 7:
            return {"type": "resize", "width": r.randrange(200, 700), "height": r.randrange(120, 400)}
        return {"type": "home"}

    def run(self, until):
        self.send({"type": "resize", "width": 640, "height": 360})
        last = 0
        while time.time() < until:
            # When the picture is complete and nothing moves, nothing comes.
            if not select.select([self.socket], [], [], 0.3)[0]:
                self.send(self.event())
                continue
            kind, data = self.message()
            if kind == 2:
                frame = struct.unpack_from("<I", data, 4)[0]
                self.send({"type": "shown", "frame": frame})
                self.frames += frame != last
                last = frame
                if self.random.random() < 0.05:
                    self.send(self.event())
            elif kind == 8:
                raise ConnectionError("the viewer closed the session")


def held(process):
    """Megabytes that a process holds, and the most that it has held."""
    with open(f"/proc/{process.pid}/status") as file:
        lines = dict(line.split(":", 1) for line in file)
    return [int(lines[name].split()[0]) / 1024 if name in lines else 0.0 for name in ("VmRSS", "VmHWM")]


def main():
    """Runs the three for so many minutes."""
    minutes = float(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        table = os.path.join(folder, "hole.fan")
        ellis = os.path.join(ROOT, "assets/manifolds/ellis-wormhole.toml")
        subprocess.run([*NICE, "bake", ellis, "-o", table, "--quiet", "--max-error", "10", "--certify-rays", "500"],
                       stdout=subprocess.DEVNULL)
        until = time.time() + 60 * minutes
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        view = [*NICE, "view", scene("wormhole-gallery.toml"), "--bundle", table, "--no-open", "--threads", "1"]
        viewer = subprocess.Popen(view, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        page = Page(viewer.stdout.readline())
        driver = threading.Thread(target=page.run, args=(until,), daemon=True)
        driver.start()
        path = [*NICE, "render", scene("h3-lamp.toml"), "--tracer", "path", "--size", "800x600", "--spp", "4096"]
        path += ["-o", os.path.join(folder, "a.png"), "--quiet", "--threads", "1"]
        alike = os.path.join(folder, "alike.toml")
        with open(alike, "w") as file:
            file.write(ALIKE)
        baked = os.path.join(folder, "b.fan")
        bake = [*NICE, "bake", alike, "-o", baked, "--max-error", "1", "--cells", "40", "--quiet", "--threads", "1"]
        processes = [viewer, subprocess.Popen(path, **quiet), subprocess.Popen(bake, **quiet)]
        try:
            watch(processes, driver, until, baked + ".parts")
        finally:
            print(f"\n{page.frames} frames shown, {page.events} messages sent", flush=True)
            for name, process in zip(("viewer", "path tracer", "bake"), processes):
                before = time.time()
                process.send_signal(signal.SIGTERM)
                code = process.wait(300)
                print(f"{name}: exit code {code}, {time.time() - before:.1f} s after SIGTERM", flush=True)


def watch(processes, driver, until, chunks):
    """Prints a row for each minute while all of them live; `chunks` is the folder of the bake's finished ones."""
    print("| minute | viewer, MB | path tracer, MB | bake, MB | its chunks, MB |\n|---|---|---|---|---|", flush=True)
    began, minute = time.time(), 0
    while time.time() < until:
        time.sleep(max(0.0, began + 60 * (minute + 1) - time.time()))
        minute += 1
        ended = [k for k, process in enumerate(processes) if process.poll() is not None]
        if ended or not driver.is_alive() and time.time() < until:
            sys.exit(f"ended early: {ended or 'the page'}")
        cells = " | ".join("{:.0f} (most {:.0f})".format(*held(process)) for process in processes)
        finished = [entry.stat().st_size for entry in os.scandir(chunks) if entry.name.startswith("chunk-")]
        print(f"| {minute} | {cells} | {sum(finished) / 1e6:.1f} ({len(finished)}) |", flush=True)


if __name__ == "__main__":
    main()
