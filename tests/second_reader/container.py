"""The container of a bundle and its header record (docs/FORMAT.md, sections 2, 3 and 12).

In: the bytes of a file. Out: the header as nested dictionaries, and the payloads of the chunks, after
every checksum has been verified.
"""

import struct
from dataclasses import dataclass

import blake3
import xxhash

MAGIC = b"GEOFAN\r\n\x1a\n"
VERSION = 11
HEADER, CONTENTS, CHUNK, FIELD = 1, 2, 3, 5
MOST_HEADER_BYTES = 1 << 24
MOST_CHUNKS = 1 << 20


class FormatError(Exception):
    """Stands for bytes that are no bundle as docs/FORMAT.md describes it."""


def require(condition, message):
    """Raises a FormatError with this message unless the condition holds."""
    if not condition:
        raise FormatError(message)


class Cursor:
    """Little-endian numbers, read one after the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        require(self.at + count <= len(self.data), "the data end too early")
        self.at += count
        return self.data[self.at - count : self.at]

    def number(self, code):
        return struct.unpack("<" + code, self.take(struct.calcsize("<" + code)))[0]

    def u8(self):
        return self.number("B")

    def i8(self):
        return self.number("b")

    def i16(self):
        return self.number("h")

    def u32(self):
        return self.number("I")

    def u64(self):
        return self.number("Q")

    def f64(self):
        return self.number("d")

    def finish(self):
        require(self.at == len(self.data), "bytes are left over")


@dataclass
class Block:
    kind: int
    index: int
    id: bytes
    payload: bytes
    offset: int


@dataclass
class Container:
    id: bytes
    header: dict
    chunks: dict  # number of the chunk -> payload


def read_block(cursor):
    start = cursor.at
    kind, index, length, id = struct.unpack("<BIQ16s", cursor.take(29))
    offset = cursor.at
    payload = cursor.take(length)
    checked = cursor.data[start : cursor.at]
    require(xxhash.xxh3_64_intdigest(checked) == cursor.u64(), f"the block at byte {start} is damaged")
    return Block(kind, index, id, payload, offset)


def read_container(data):
    """Reads and verifies the container in the bytes of a file."""
    require(data[: len(MAGIC)] == MAGIC, "not a bundle")
    require(len(data) >= len(MAGIC) + 4 + 32, "the file is truncated")
    version = struct.unpack_from("<I", data, len(MAGIC))[0]
    require(version == VERSION, f"format {version}; this reader knows {VERSION}")
    body = data[:-32]
    require(blake3.blake3(body).digest() == data[-32:], "the hash of the file does not match")
    cursor, blocks = Cursor(body), []
    cursor.at = len(MAGIC) + 4
    while cursor.at < len(body):
        blocks.append(read_block(cursor))
    require(len(blocks) >= 2, "header or contents are missing")
    header, contents, *chunks = blocks
    fields = [block for block in chunks if block.kind == FIELD]
    names = [Cursor(block.payload) for block in fields]
    names = ", ".join(f"[field.{cursor.take(cursor.u32()).decode()}]" for cursor in names)
    require(not fields, f"this reader does not evaluate sampled fields: {names}")
    kinds = [header.kind, contents.kind] + [block.kind for block in chunks]
    require(kinds == [HEADER, CONTENTS] + [CHUNK] * len(chunks), "blocks are out of order")
    require(all(block.id == header.id for block in blocks), "blocks of several bundles")
    listed = b"".join(struct.pack("<IQQ", c.index, c.offset, len(c.payload)) for c in chunks)
    require(contents.payload == listed, "contents and chunks disagree")
    require(all(a.index < b.index for a, b in zip(chunks, chunks[1:])), "chunks do not ascend")
    record, plan = read_header(header.payload)
    require(identity(record, plan) == header.id, "the id is not that of manifold and plan")
    return Container(header.id, record, {c.index: c.payload for c in chunks})


def identity(header, plan):
    """Calculates the id that section 2 derives from the manifold and the encoded plan."""
    fingerprint = blake3.blake3(header["manifold"]["text"].encode())
    for name, value in header["manifold"]["parameters"]:
        fingerprint.update(name.encode() + b"\0" + struct.pack("<d", value))
    return blake3.blake3(fingerprint.digest() + plan).digest()[:16]


def flag(cursor):
    value = cursor.u8()
    require(value in (0, 1), "a flag is neither 0 nor 1")
    return bool(value)


def string(cursor):
    return cursor.take(cursor.u64()).decode("utf-8")


def list_of(read):
    return lambda cursor: [read(cursor) for _ in range(cursor.u64())]


def array_of(count, read):
    return lambda cursor: [read(cursor) for _ in range(count)]


def option_of(read):
    return lambda cursor: read(cursor) if flag(cursor) else None


def record_of(**fields):
    return lambda cursor: {name: read(cursor) for name, read in fields.items()}


def enumeration(*names):
    def read(cursor):
        number = cursor.u32()
        require(number < len(names), "unknown variant of an enumeration")
        return names[number]

    return read


def tangent_promise(cursor):
    kind = cursor.u8()
    require(kind in (0, 1, 2), "unknown promise of tangents")
    return (kind, cursor.f64() if kind == 2 else None)


def chart_map(cursor):
    name = enumeration("identity", "sphere", "polar")(cursor)
    return (name, cursor.f64() if name == "sphere" else None)


f64, u32, u64 = Cursor.f64, Cursor.u32, Cursor.u64
matrix = array_of(3, array_of(3, f64))
permutation = list_of(Cursor.i8)
quantiles = record_of(p50=f64, p95=f64, p99=f64, max=f64)

read_plan = record_of(
    max_error=f64,
    length=f64,
    tangents=tangent_promise,
    tolerance=f64,
    nodes=list_of(u32),
    most_rays=u32,
    chart_map=chart_map,
    refinement=u32,
    least_volume=f64,
    most_arc_halvings=u32,
    cells=list_of(u32),
    alpha=f64,
    parallax=matrix,
    sphere=option_of(matrix),
    mirrors=list_of(record_of(axes=permutation, cameras=permutation, directions=permutation)),
    seed=u64,
)

read_before_plan = record_of(
    generator=string,
    manifold=record_of(
        name=string,
        source=string,
        text=string,
        parameters=list_of(lambda cursor: (string(cursor), cursor.f64())),
    ),
    reduction=enumeration("none", "rotation", "translation", "group", "axis"),
    cameras=list_of(array_of(2, f64)),
    faces=u32,
)

read_after_plan = record_of(
    certify_rays=u64,
    certificate=option_of(
        record_of(
            mrad=quantiles,
            screen_mrad=quantiles,
            sky_mrad=option_of(quantiles),
            rotation_mrad=option_of(quantiles),
            flagged=f64,
            rays=u64,
            seed=u64,
            tolerance=f64,
            exact_rays_baked=u64,
        )
    ),
    shard=option_of(record_of(index=u32, of=u32, exact_rays=u64)),
)


def read_header(payload):
    """Reads the header record; gives it and the bytes of its plan."""
    require(len(payload) <= MOST_HEADER_BYTES, "the header is too long")
    cursor = Cursor(payload)
    header = read_before_plan(cursor)
    start = cursor.at
    header["plan"] = read_plan(cursor)
    plan = payload[start : cursor.at]
    header.update(read_after_plan(cursor))
    cursor.finish()
    check_header(header)
    return header, plan


def check_header(header):
    """Checks what section 12 asks of a header by itself."""
    plan, cameras = header["plan"], header["cameras"]
    chunks = header["faces"]
    for count in plan["cells"]:
        chunks *= count
    directions = 1 if header["reduction"] == "rotation" else 2
    require(1 <= chunks <= MOST_CHUNKS, "the number of cells is out of range")
    require(len(plan["cells"]) == len(cameras), "cells and cameras disagree")
    require(len(plan["nodes"]) == len(cameras) + directions + 1, "nodes and axes disagree")
    require(0 <= plan["alpha"] < 1, "alpha is out of range")
