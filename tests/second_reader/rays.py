"""The ray space of a bundle and chart maps (docs/FORMAT.md, sections 4, 5 and 10.1).

In: a header and its manifold. Out: for a camera and a direction the stored ray: its chunk, its
parameters there, the start of its path, and the isometry that carries it to the true ray.
"""

from dataclasses import dataclass
from math import asin, atan, atan2, floor, hypot, log, pi, sqrt

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


class Axis:
    """Rotations about a coordinate axis, and perhaps translations along it: section 4.1."""

    def __init__(self, manifold):
        self.k = manifold.axis
        self.i, self.j = (self.k + 1) % 3, (self.k + 2) % 3
        self.translated = manifold.translated[self.k]

    def invariants(self, u):
        """Gives the distance from the axis, and the place along it unless that is translated."""
        both = [hypot(u[self.i], u[self.j]), u[self.k]]
        return np.array(both[:1] if self.translated else both)

    def changes(self, u, slopes):
        """Gives the invariants and their derivatives by the parameters on which u depends."""
        rho = hypot(u[self.i], u[self.j])
        outwards = u[self.i] * slopes[self.i] + u[self.j] * slopes[self.j]
        both = [outwards / rho if rho > 0 else 0 * outwards, slopes[self.k]]
        return self.invariants(u), np.array(both[:1] if self.translated else both)

    def stored(self, distance, along):
        point = np.zeros(3)
        point[self.i], point[self.k] = distance, along
        return point

    def isometry(self, u, stored):
        """Gives the rotation and the shift that take the stored point to u."""
        rho = hypot(u[self.i], u[self.j])
        cos, sin = (u[self.i] / rho, u[self.j] / rho) if rho > 0 else (1.0, 0.0)
        q, t = np.eye(3), np.zeros(3)
        plane = np.ix_([self.i, self.j], [self.i, self.j])
        q[plane] = [[cos, -sin], [sin, cos]]
        if self.translated:
            t[self.k] = u[self.k] - stored[self.k]
        return q, t


class RaySpace:
    """All rays of a bundle."""

    def __init__(self, header, manifold):
        self.manifold, self.region = manifold, manifold.region
        self.reduction, self.cameras = header["reduction"], header["cameras"]
        self.faces, plan = header["faces"], header["plan"]
        self.cells = plan["cells"]
        self.parallax = np.array(plan["parallax"]).T
        self.axes = None if plan["sphere"] is None else np.array(plan["sphere"]).T
        self.axis = Axis(manifold) if self.reduction == "axis" else None
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
        if self.reduction == "axis":
            return count <= (1 if self.axis.translated else 2)
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
        elif self.reduction == "axis":
            along = self.region.middle()[self.axis.k] if self.axis.translated else parameters[1]
            point = self.axis.stored(parameters[0], along)
        elif self.reduction == "rotation":
            point = np.array([parameters[0], 0, 0])
        else:
            point = self.with_kept(parameters)
        if self.reduction == "rotation":
            return np.array([np.linalg.norm(point), 0, 0])
        if self.reduction == "axis":
            distance = hypot(point[self.axis.i], point[self.axis.j])
            return self.axis.stored(distance, point[self.axis.k])
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
            kept = np.array([not moves for moves in self.manifold.translated], float)
            if self.by_region:
                value = lambda point, slopes: (kept * point, kept[:, None] * slopes)
                return self.region.locate(kept * np.asarray(u), value)
            return self.within_intervals(self.kept(u))
        if self.reduction == "axis":
            values = self.axis.invariants(u)
            if self.by_region:
                return self.region.locate(values, self.axis.changes)
            return self.within_intervals(list(values))
        return self.region.locate(u)

    def within_intervals(self, values):
        for x, (low, high) in zip(values, self.cameras):
            slack = 1e-9 * (high - low) + 1e-12 * abs(x)
            require(low - slack <= x <= high + slack, "the camera is not in the region")
        return values

    def place_by_radius(self, rho):
        if not self.by_region:
            return self.within_intervals([rho])
        if not self.cameras:
            own = np.linalg.norm(self.region.at([]))
            require(abs(rho - own) <= 1e-9 * own, "the camera is not in the region")
            return []
        (low, high), = self.region.intervals
        radius = lambda p: np.linalg.norm(self.region.at([p]))
        rising = radius(high) > radius(low)
        ends = sorted((radius(low), radius(high)))
        slack = 1e-9 * (ends[1] - ends[0]) + 1e-12 * rho
        require(ends[0] - slack <= rho <= ends[1] + slack, "the camera is not in the region")
        for _ in range(200):
            middle = 0.5 * (low + high)
            if (radius(middle) < rho) == rising:
                low = middle
            else:
                high = middle
        return [0.5 * (low + high)]

    # Rotation: section 4.3.

    def radius_and_wind(self, u):
        """Gives the areal radius and the outward part of the wind at a stored point."""
        metric, wind = self.manifold.geometry(u)
        return u[0] * sqrt(metric[1, 1]), wind[0] * sqrt(metric[0, 0])

    def largest_impact(self, u):
        """Gives the largest impact parameter of the rays from a stored point; 0 where none is the largest."""
        radius, wind = self.radius_and_wind(u)
        return radius / sqrt(1 - wind * wind) if abs(wind) < 1 else 0.0

    def find_least_radius(self):
        """Finds b₀, or 0 where it is negligible."""
        radius = lambda x: self.largest_impact(self.stored_point(x))
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
        n = self.manifold.frame(u) @ d
        v = n + self.manifold.geometry(u)[1]
        outwards = u / np.linalg.norm(u) if np.any(u) else n / np.linalg.norm(n)
        across = n - outwards * (outwards @ n)
        if across @ across <= 1e-30 * (n @ n):
            across = np.cross(outwards, np.eye(3)[int(np.argmin(np.abs(outwards)))])
        across /= np.linalg.norm(across)
        q = np.array([outwards, across, np.cross(outwards, across)]).T
        stored = self.stored_point(parameters)
        planar = np.array([outwards @ n, across @ n, 0])
        x, y, _ = np.linalg.solve(self.manifold.frame(stored), planar)
        face, parameter = self.orbit(x, y, *self.radius_and_wind(stored))
        return face, parameter, stored, q.T @ v, q

    def orbit(self, x, y, radius, wind):
        """Finds face and parameter of the direction (x, y) at an areal radius and an outward wind."""
        least, length = self.least_radius, sqrt(x * x + y * y)
        b = radius * (y / length) / (1 + wind * x / length) if least > 0 else 0.0
        if least > 0 and b <= least:
            face, t = int(x >= -wind * length), asin(b / least) / (pi / 2)
        else:
            low, width = self.across(radius, wind)
            face, t = (2 if least > 0 else 0), (atan2(y, x) - low) / width
        return face, 2 * min(max(t, 0), 1) - 1

    def across(self, radius, wind):
        """Gives the first angle of the rays across and the width of all."""
        if not radius > 0:
            return 0.0, pi
        turn, size = atan2(self.least_radius * wind, radius), hypot(radius, self.least_radius * wind)
        inner = asin(min(1, self.least_radius / size))
        return turn + inner, max(pi - 2 * inner, 1e-300)

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
        n = self.manifold.frame(u) @ d
        differential = isometry(stored)[1]
        v = np.linalg.solve(differential, n + self.manifold.geometry(u)[1])
        n = np.linalg.solve(differential, n)
        aim = self.aim(np.linalg.solve(self.manifold.frame(stored), n), stored, cell)
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
        if self.reduction == "axis":
            return affine(*self.axis.isometry(u, stored))
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
