"""Trees of boxes, tensors and their evaluation (docs/FORMAT.md, sections 6, 8 and 9).

In: the payload of a chunk. Out: for parameters of a camera and a direction, the pieces of a path: rows
of coefficients over intervals of the arc length.
"""

import struct
from dataclasses import dataclass
from math import asin, ceil, cos, pi, prod, sin

import numpy as np

from container import Cursor, require
from entropy import IntegerReader, next_pivot

FLAGGED, PATCH, FACES, EDGE, SIDES, APART = 255, 254, 253, 252, 251, 250
MOST_INTEGERS, MOST_CORE_INTEGERS = 1 << 26, 1 << 24
MOST_DEGREES, MOST_TERMS, DEEPEST = 64, 128, 64


@dataclass
class Shape:
    """Axes and channels of the tensors of a chunk."""

    cameras: int
    directions: int
    channels: int
    alpha: float
    sphere: bool  # whether directions are held together

    def of_faces(self):
        return Shape(self.cameras, self.directions, self.channels, self.alpha, False)


@dataclass
class Tensor:
    axes: list  # the axes of each core
    cores: list  # arrays (left rank, axes…, right rank)
    shape: Shape


def read_chunk(payload, shape, may_have_sections=True):
    """Reads the tree of a chunk or a section: None where flagged, a Tensor, or (axis or FACES, [trees])."""
    cursor = Cursor(payload)
    count = cursor.u32()
    require(count <= MOST_INTEGERS, "a chunk has too many integers")
    code = cursor.take(cursor.u32())
    require(len(code) % 4 == 0, "the code is not whole words")
    structure = Cursor(cursor.take(cursor.u32()))
    integers = IntegerReader([w for (w,) in struct.iter_unpack("<I", code)], count)
    sections = cursor if may_have_sections else None
    tree = read_tree(structure, (integers, sections), shape, 0)
    structure.finish()
    integers.finish()
    cursor.finish()
    return tree


def read_tree(structure, rest, shape, depth):
    integers, sections = rest
    require(depth <= DEEPEST, "a tree is too deep")
    kind = structure.u8()
    if kind == FLAGGED:
        return None
    if kind == PATCH:
        return read_tensor(structure, integers, shape)
    if kind == APART:
        require(sections is not None, "a section within a section")
        return read_chunk(sections.take(sections.u32()), shape, may_have_sections=False)
    if kind == FACES:
        require(shape.sphere, "directions are divided into faces twice")
        faces = shape.of_faces()
        return (FACES, [read_tree(structure, rest, faces, depth + 1) for _ in range(6)])
    arc = shape.cameras + shape.directions
    if kind in (EDGE, SIDES):
        require(not shape.sphere, "paths or rays are parted where directions are held together")
        axis, reach = None, None
        if kind == SIDES:
            axis = structure.u8()
            require(shape.cameras <= axis < arc, "a separatrix along no direction")
            reach = [structure.u8() / 32 for _ in range(2)]
            require(min(reach) > 0, "a separatrix with nothing beside it")
        one = Shape(shape.cameras, shape.directions, 1, shape.alpha, False)
        place = read_tensor(structure, integers, one)
        parts = [read_tree(structure, rest, shape, depth + 1) for _ in range(2)]
        return (kind, [place] + parts + [axis, reach])
    is_direction = shape.cameras <= kind < arc
    require(kind <= arc and not (shape.sphere and is_direction), "an axis cannot be halved")
    return (kind, [read_tree(structure, rest, shape, depth + 1) for _ in range(2)])


def order_of_rank(rank, count):
    """Finds the order of so many axes that has this rank among all, sorted like words."""
    places = []
    for left in range(1, count + 1):
        places.append(rank % left)
        rank //= left
    require(rank == 0, "there is no such order of axes")
    free = list(range(count))
    return [free.pop(place) for place in reversed(places)]


def read_tensor(structure, integers, shape):
    rays = shape.cameras + shape.directions
    code, exponent = structure.u8(), structure.i16()
    last = [rays, rays + 1]
    if code == 0:
        axes = [list(range(rays + 2))]
    else:
        axes = [[axis] for axis in order_of_rank(code - 1, rays)] + [last]
    cores, left, rows_before = [], 1, False
    for number, own in enumerate(axes):
        is_last = number + 1 == len(axes)
        lengths = [structure.u32() for _ in own]
        right = structure.u32()
        core_shape = [left, *lengths, right]
        check_core(core_shape, is_last, shape)
        core, rows_before = read_core(integers, core_shape, rows_before)
        core *= 2.0 ** (exponent / 32)
        if is_last:
            degrees = np.arange(1, lengths[-2] + 1, dtype=float) ** (5 / 8)
            core *= degrees[:, None, None]
        else:
            core /= read_scales(integers, right, exponent // 8)
        cores.append(core)
        left = right
    return Tensor(axes, cores, shape)


def check_core(core_shape, is_last, shape):
    lengths, right = core_shape[1:-1], core_shape[-1]
    require(1 <= prod(core_shape) <= MOST_CORE_INTEGERS, "the size of a core is out of range")
    require(max(lengths) <= MOST_TERMS, "an axis is too long")
    if is_last:
        require(lengths[-2] <= MOST_DEGREES and right == 1, "the last core is out of range")
        require(lengths[-1] == shape.channels, "the number of channels is wrong")


def read_core(integers, core_shape, rows_before):
    """Reads a core in steps; tells whether rows were kept: sections 8.1 to 8.3."""
    left, right, size = core_shape[0], core_shape[-1], prod(core_shape)
    rows = rows_before or left > right
    count = left if rows else right
    if count * count > size:
        count = 1
    turned = not rows and count > 1
    stored = [right, *core_shape[:-1]] if turned else core_shape
    length = size // count
    vectors = integers.take(stored, length)
    vectors = unreflected(np.array(vectors, dtype=np.int64).reshape(count, length))
    core = vectors.reshape(stored)
    if turned:
        core = np.moveaxis(core, 0, -1)
    return core, rows


def unreflected(vectors):
    """Restores the vectors that integers stand for: H₁ … H_{j−1} z_j."""
    pivots, normals = set(), []
    for number, z in enumerate(vectors):
        pivot = next_pivot(z.tolist(), pivots)
        if pivot is None:
            continue
        pivots.add(pivot)
        normal = z / np.sqrt(float(z @ z))
        normal[pivot] += 1.0 if z[pivot] >= 0 else -1.0
        normals.append((number, normal))
    real = vectors.astype(float)
    for number, normal in reversed(normals):
        behind = real[number + 1 :]
        along = behind @ normal * (2.0 / (normal @ normal))
        behind -= np.outer(along, normal)
    return real


def read_scales(integers, count, exponent):
    """Reads the scales of a bond of this rank."""
    exponents = exponent + np.cumsum(integers.take([count], count))
    return 2.0 ** (exponents / 4)


def chebyshev_terms(y, count):
    values = [1.0, y]
    while len(values) < count:
        values.append(2.0 * y * values[-1] - values[-2])
    return np.array(values[:count])


def mapped(x, alpha):
    """Maps the place x to the variable of the polynomials: section 9.1."""
    return sin(x * asin(alpha)) / alpha if alpha > 0 else x


def azimuth_terms(azimuth, count, odd):
    """Gives the terms with odd multiples of the azimuth, or with even ones, and zeros."""
    terms = np.zeros(count)
    for i in range(count):
        m = ceil(i / 2)
        if m % 2 == odd:
            terms[i] = cos(m * pi * azimuth) if i % 2 == 1 or i == 0 else sin(m * pi * azimuth)
    return terms


def polar_terms(polar, count, odd):
    theta = pi * (polar + 1) / 2
    return np.array([sin((j + 1) * theta) if odd else cos(j * theta) for j in range(count)])


def weight_sets(tensor, parameters):
    """Gives, for each sum that is to be added, the terms of each ray axis as functions of their number."""
    shape = tensor.shape
    plain = [lambda n, x=x: chebyshev_terms(mapped(x, shape.alpha), n) for x in parameters]
    if not shape.sphere:
        return [plain]
    azimuth, polar = parameters[shape.cameras :]
    sets = []
    for odd in (0, 1):
        own = [
            lambda n, odd=odd: azimuth_terms(azimuth, n, odd),
            lambda n, odd=odd: polar_terms(polar, n, odd),
        ]
        sets.append(plain[: shape.cameras] + own)
    return sets


def rows_at(tensor, parameters):
    """Sums the rows (arc length, channel) at parameters of cameras and directions."""
    result = 0.0
    for terms in weight_sets(tensor, parameters):
        product = np.ones(1)
        for axes, core in zip(tensor.axes, tensor.cores):
            product = np.tensordot(product, core, axes=(0, 0))
            for axis in axes:
                if axis < len(parameters):
                    product = np.tensordot(terms[axis](product.shape[0]), product, axes=(0, 0))
        result = result + product[..., 0]
    return result


def half(x):
    """Finds the half of [−1, 1] that holds x, and the parameter there."""
    return (0, 2 * x + 1) if x < 0 else (1, 2 * x - 1)


def beside(x, place, reach):
    """Finds the side of a separatrix at `place` that holds x, and the parameter there."""
    if x < place:
        return 0, max(1 + 2 * (x - place) / reach[0], -1.0)
    return 1, min(2 * (x - place) / reach[1] - 1, 1.0)


def pieces(tree, cameras, directions, face, interval):
    """Collects the pieces (interval, rows) of a ray's path; rows are None where flagged.

    `face` is the number of the face and the direction parameters there.
    """
    if tree is None:
        return [(interval, None)]
    if isinstance(tree, Tensor):
        return [(interval, rows_at(tree, cameras + directions))]
    axis, branches = tree
    if axis == FACES:
        number, own = face
        return pieces(branches[number], cameras, own, face, interval)
    if axis == EDGE:
        low, high = interval
        least = 1e-9 * (high - low)
        place = float(rows_at(branches[0], cameras + directions)[0][0])
        place = min(max(place, low + least), high - least)
        return pieces(branches[1], cameras, directions, face, (low, place)) + pieces(
            branches[2], cameras, directions, face, (place, high)
        )
    if axis == SIDES:
        parameters, (axis, reach) = cameras + directions, branches[3:]
        place = float(rows_at(branches[0], parameters)[0][0])
        side, parameters[axis] = beside(parameters[axis], place, reach)
        cut = len(cameras)
        return pieces(branches[1 + side], parameters[:cut], parameters[cut:], face, interval)
    if axis == len(cameras) + len(directions):
        low, high = interval
        middle = 0.5 * (low + high)
        return pieces(branches[0], cameras, directions, face, (low, middle)) + pieces(
            branches[1], cameras, directions, face, (middle, high)
        )
    parameters = cameras + directions
    side, parameters[axis] = half(parameters[axis])
    cut = len(cameras)
    return pieces(branches[side], parameters[:cut], parameters[cut:], face, interval)
