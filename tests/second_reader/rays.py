"""The ray space of a bundle and chart maps (docs/FORMAT.md, sections 4, 5 and 10.1).

In: a header and its manifold. Out: for a camera and a direction the stored ray: its chunk, its
parameters there, the start of its path, and the isometry that carries it to the true ray.
"""

from dataclasses import dataclass
from math import asin, atan, atan2, floor, log, pi, sqrt

import numpy as np

from container import require

IDENTITY = (np.eye(3), np.zeros(3))


@dataclass
class Ray:
    """A stored ray."""

    face: int
    direction: list  # parameters of the face
    aim: np.ndarray  # unit vector; None under rotation
    u: np.ndarray
    v: np.ndarray
    chunk: int
    cameras: list  # parameters in the cell
    isometry: object  # chart point -> (image, differential)


def affine(q, t):
    return lambda x: (q @ x + t, q)


def composed(outer, inner):
    """Puts the isometry `outer` behind the affine map `inner`."""
    q, t = inner

    def apply(x):
        image, differential = outer(q @ x + t)
        return image, differential @ q

    return apply


def signed_matrix(entries):
    matrix = np.zeros((len(entries), len(entries)))
    for i, entry in enumerate(entries):
        matrix[i, abs(entry) - 1] = 1 if entry > 0 else -1
    return matrix


def face_of(a):
    """Finds the face of a unit vector and its parameters there: section 4.2."""
    size = np.abs(a)
    k = int(np.argmax(size))
    warp = lambda i: 4 / pi * atan(a[(k + i) % 3] / size[k])
    return 2 * k + int(a[k] < 0), [warp(1), warp(2)]


class Mirror:
    """Discrete symmetry: section 4.5."""

    def __init__(self, record, middle):
        self.cameras = record["cameras"]
        self.p, self.d = signed_matrix(record["axes"]), signed_matrix(record["directions"])
        self.forth = (self.p, middle - self.p @ middle)
        self.back = (self.p.T, middle - self.p.T @ middle)

    def cell(self, cell, counts):
        """Finds the cell that this one is carried to; None if the division does not follow."""
        image = []
        for i, entry in enumerate(self.cameras):
            j = abs(entry) - 1
            if counts[i] != counts[j]:
                return None
            image.append(cell[j] if entry > 0 else counts[j] - 1 - cell[j])
        return image

    def source(self, axis):
        """Finds the axis of a direction that becomes this one of its image, and its sign."""
        j = int(np.argmax(np.abs(self.d[axis])))
        return j, self.d[axis, j]

    def face(self, face):
        axis = int(np.argmax(np.abs(self.d[:, face // 2])))
        sign = self.source(axis)[1] * (1 if face % 2 == 0 else -1)
        return 2 * axis + int(sign < 0)

    def direction(self, face, direction):
        """Gives the parameters on the image of a face."""
        axis, image = face // 2, self.face(face) // 2
        parameters = []
        for j in (1, 2):
            i, sign = self.source((image + j) % 3)
            parameters.append(sign * direction[(i - axis) % 3 - 1])
        return parameters


class RaySpace:
    """All rays of a bundle."""

    def __init__(self, header, manifold):
        self.manifold, self.region = manifold, manifold.region
        self.reduction, self.cameras = header["reduction"], header["cameras"]
        self.faces, plan = header["faces"], header["plan"]
        self.cells = plan["cells"]
        self.parallax = np.array(plan["parallax"]).T
        self.axes = None if plan["sphere"] is None else np.array(plan["sphere"]).T
        self.by_region = self.has_region_parameters()
        middle = [0.5 * (low + high) for low, high in self.cameras]
        self.mirrors = [Mirror(m, self.stored_point(middle)) for m in plan["mirrors"]]
        self.least_radius = self.find_least_radius() if self.reduction == "rotation" else 0.0
        self.divide()

    # Stored cameras: section 4.1.

    def has_region_parameters(self):
        count = len(self.region.names)
        if self.reduction == "rotation":
            return count == 0 or (count == 1 and self.radius_is_monotonic())
        if self.reduction == "translation":
            return count <= self.manifold.translated.count(False)
        return self.reduction == "none"

    def radius_is_monotonic(self):
        (low, high), = self.region.intervals
        radii = [np.linalg.norm(self.region.at([low + (high - low) * i / 256])) for i in range(257)]
        rises = [b > a for a, b in zip(radii, radii[1:])]
        return all(rises) or not any(rises)

    def stored_point(self, parameters):
        if self.reduction == "group":
            return np.zeros(3)
        if self.by_region:
            point = self.region.at(parameters)
        elif self.reduction == "rotation":
            point = np.array([parameters[0], 0, 0])
        else:
            point = self.with_kept(parameters)
        if self.reduction == "rotation":
            return np.array([np.linalg.norm(point), 0, 0])
        return point

    def with_kept(self, values):
        """Replaces the coordinates of the region's middle that are not translated."""
        point = self.region.middle()
        point[[k for k in range(3) if not self.manifold.translated[k]]] = values
        return point

    def kept(self, u):
        return [u[k] for k in range(3) if not self.manifold.translated[k]]

    def place(self, u):
        """Finds the stored parameters of a camera."""
        if self.reduction == "group":
            return []
        if self.reduction == "rotation":
            return self.place_by_radius(np.linalg.norm(u))
        if self.reduction == "translation":
            kept = self.kept(u)
            return self.region.locate(self.with_kept(kept)) if self.by_region else kept
        return self.region.locate(u)

    def place_by_radius(self, rho):
        if not self.by_region:
            return [rho]
        if not self.cameras:
            return []
        (low, high), = self.region.intervals
        radius = lambda p: np.linalg.norm(self.region.at([p]))
        rising = radius(high) > radius(low)
        ends = sorted((radius(low), radius(high)))
        slack = 1e-9 * (ends[1] - ends[0])
        require(ends[0] - slack <= rho <= ends[1] + slack, "the camera is not in the region")
        for _ in range(200):
            middle = 0.5 * (low + high)
            if (radius(middle) < rho) == rising:
                low = middle
            else:
                high = middle
        return [0.5 * (low + high)]

    # Rotation: section 4.3.

    def areal_radius(self, u):
        return u[0] * sqrt(self.manifold.metric(u)[1, 1])

    def find_least_radius(self):
        """Finds R₀, or 0 where it is negligible."""
        radius = lambda x: self.areal_radius(self.stored_point(x))
        if not self.cameras:
            return radius([])
        (low, high), = self.cameras
        at = lambda t: radius([low + (high - low) * t])
        grid = [i / 256 for i in range(257)]
        values = [at(t) for t in grid]
        best = int(np.argmin(values))
        a, b = grid[max(best - 1, 0)], grid[min(best + 1, 256)]
        golden = (sqrt(5) - 1) / 2
        for _ in range(100):
            c, d = b - golden * (b - a), a + golden * (b - a)
            if at(c) <= at(d):
                b = d
            else:
                a = c
        least = min(at(a), at(b), values[best])
        return least if least > 1e-6 * max(values) else 0.0

    def rotated_ray(self, u, d, parameters):
        v = self.manifold.frame(u) @ d
        outwards = u / np.linalg.norm(u) if np.any(u) else v / np.linalg.norm(v)
        across = v - outwards * (outwards @ v)
        if across @ across <= 1e-30 * (v @ v):
            across = np.cross(outwards, np.eye(3)[int(np.argmin(np.abs(outwards)))])
        across /= np.linalg.norm(across)
        q = np.array([outwards, across, np.cross(outwards, across)]).T
        stored = self.stored_point(parameters)
        planar = np.array([outwards @ v, across @ v, 0])
        x, y, _ = np.linalg.solve(self.manifold.frame(stored), planar)
        face, parameter = self.orbit(x, y, self.areal_radius(stored))
        return face, parameter, stored, q.T @ v, q

    def orbit(self, x, y, radius):
        """Finds face and parameter of the direction (x, y) at an areal radius."""
        least, theta = self.least_radius, atan2(y, x)
        b = radius * y / sqrt(x * x + y * y)
        if least > 0 and b <= least:
            face, t = int(x >= 0), asin(b / least) / (pi / 2)
        else:
            cone = asin(min(1, least / radius)) if radius > 0 else 0.0
            face, t = (2 if least > 0 else 0), (theta - cone) / (pi - 2 * cone)
        return face, 2 * min(max(t, 0), 1) - 1

    # Chunks: section 5.

    def divide(self):
        """Lists for each place the chunk that holds it and the mirror that carries it there."""
        self.blocks = 1 if self.axes is not None else self.faces
        self.stored, chunks = [], {}
        for place in range(int(np.prod(self.cells, dtype=int)) * self.blocks):
            found = None
            for mirror in self.mirrors:
                image = self.image(place, mirror)
                if image in chunks:
                    found = (chunks[image], mirror)
                    break
            if found is None:
                found = (len(chunks), None)
                chunks[place] = len(chunks)
            self.stored.append(found)
        self.chunks = len(chunks)

    def image(self, place, mirror):
        block, rest, cell = place % self.blocks, place // self.blocks, []
        for n in self.cells:
            cell.append(rest % n)
            rest //= n
        cell = mirror.cell(cell, self.cells)
        if cell is None:
            return None
        return self.number(cell, 0 if self.blocks == 1 else mirror.face(block))

    def number(self, cell, block):
        place = 0
        for k, n in zip(reversed(cell), reversed(self.cells)):
            place = place * n + k
        return place * self.blocks + block

    def cell(self, parameters):
        """Finds the cell that holds parameters, and the parameters in it."""
        cell, inner = [], []
        for n, (low, high), x in zip(self.cells, self.cameras, parameters):
            t = n * (x - low) / (high - low) if high > low else 0.5
            k = min(floor(max(t, 0)), n - 1)
            cell.append(k)
            inner.append(min(max(2 * (t - k) - 1, -1), 1))
        return cell, inner

    # Any ray.

    def locate(self, u, d):
        """Finds the stored ray of the camera at u in the direction d (standard frame, unit)."""
        parameters = self.place(u)
        cell, cameras = self.cell(parameters)
        if self.reduction == "rotation":
            face, parameter, stored, v, q = self.rotated_ray(u, d, parameters)
            chunk, _ = self.stored[self.number(cell, face)]
            return Ray(face, [parameter], None, stored, v, chunk, cameras, affine(q, np.zeros(3)))
        stored = self.stored_point(parameters)
        isometry = self.isometry(u, stored)
        v = np.linalg.solve(isometry(stored)[1], self.manifold.frame(u) @ d)
        aim = self.aim(np.linalg.solve(self.manifold.frame(stored), v), stored, cell)
        face, direction = face_of(aim)
        block = 0 if self.axes is not None else face
        chunk, mirror = self.stored[self.number(cell, block)]
        ray = Ray(face, direction, aim, stored, v, chunk, cameras, isometry)
        return self.mirrored(ray, mirror) if mirror else ray

    def isometry(self, u, stored):
        if self.reduction == "group":
            return lambda x: self.manifold.left_translation(x, u)
        if self.reduction == "translation":
            return affine(np.eye(3), u - stored)
        return affine(*IDENTITY)

    def aim(self, d, stored, cell):
        """Finds the aim of a direction: section 4.4."""
        d = d / np.linalg.norm(d)
        if not np.any(self.parallax) or not self.cameras:
            return d
        middle = [
            low + (high - low) * (k + 0.5) / n
            for (low, high), k, n in zip(self.cameras, cell, self.cells)
        ]
        w = self.parallax @ (stored - self.stored_point(middle))
        size = np.linalg.norm(w)
        if size > 0.9:
            w *= 0.9 / size
        along = d @ w
        return d * (sqrt(along**2 + 1 - w @ w) - along) + w

    def mirrored(self, ray, mirror):
        p, t = mirror.forth
        signs = signed_matrix(mirror.cameras) if mirror.cameras else np.zeros((0, 0))
        return Ray(
            mirror.face(ray.face),
            mirror.direction(ray.face, ray.direction),
            mirror.d @ ray.aim,
            p @ ray.u + t,
            p @ ray.v,
            ray.chunk,
            list(signs @ np.array(ray.cameras)),
            composed(ray.isometry, mirror.back),
        )

    def spherical(self, aim):
        """Gives azimuth and polar angle as parameters: section 4.6."""
        y = self.axes.T @ aim
        return [atan2(y[1], y[0]) / pi, atan2(sqrt(y[0] ** 2 + y[1] ** 2), y[2]) / (pi / 2) - 1]


class ChartMap:
    """Map of chart points to what is stored: section 10.1."""

    def __init__(self, name, radius, planar):
        self.name, self.radius = name, radius
        self.channels = {
            "identity": [0, 1] if planar else [0, 1, 2],
            "sphere": [0, 1, 3] if planar else [0, 1, 2, 3],
            "polar": [0, 3],
        }[name]

    def lift(self, u, v):
        """Maps chart point and tangent to R⁴."""
        if self.name == "identity":
            return np.append(u, 0.0), np.append(v, 0.0)
        if self.name == "sphere":
            w, dw = u / self.radius, v / self.radius
            sum, change = w @ w + 1, 2 * (w @ dw)
            x = np.append(2 * w, w @ w - 1) / sum
            return x, np.append(2 * dw, change) / sum - x * (change / sum)
        square = u[0] ** 2 + u[1] ** 2
        x = np.array([atan2(u[1], u[0]), 0, 0, 0.5 * log(square)])
        turn, growth = u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1]
        return x, np.array([turn, 0, 0, growth]) / square

    def project(self, x, dx):
        """Maps a point and a tangent in R⁴ back to the chart."""
        if self.name == "identity":
            return x[:3], dx[:3]
        if self.name == "sphere":
            size = np.linalg.norm(x)
            y = x / size
            dy = (dx - y * (y @ dx)) / size
            below = 1 - y[3]
            u = self.radius * y[:3] / below
            return u, self.radius * (dy[:3] + y[:3] * (dy[3] / below)) / below
        u = np.exp(x[3]) * np.array([np.cos(x[0]), np.sin(x[0]), 0])
        return u, dx[3] * u + dx[0] * np.array([-u[1], u[0], 0])
