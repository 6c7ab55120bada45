"""Reference geodesics for every file of assets/manifolds, computed independently of geofan.

In: the manifold files, read with tomllib and turned into sympy expressions here.
Out: references.json beside this script: positions, velocities, transported frames and areas
after a given length, from random starts in each camera region in random directions.

Method: metric and its first and second derivatives by sympy; geodesic, parallel transport
(w'^k = -Gamma^k_ij v^i w^j) and variational equation together by Gragg-Bulirsch-Stoer
extrapolation in 80-bit floats. Where a metric has a kink (if, max, abs) the crossing is located and
the variation takes its jump there. Closed forms are checked first and discrepancies printed.

Run: pip install numpy scipy sympy; python make_references.py   (a few minutes, on x86-64)
"""

import json
import math
import pathlib
import re
import sys
import tomllib
import zlib
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import sympy as sp
from scipy.integrate import quad
from scipy.optimize import brentq

HERE = pathlib.Path(__file__).resolve().parent
MANIFOLDS = HERE.parent.parent / "assets" / "manifolds"
LD = np.longdouble
RAYS = 12
PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
assert np.finfo(LD).eps < 2e-19, "needs 80-bit long doubles"


# --- expressions -----------------------------------------------------------------------------


class Switches:
    """Kinked functions as smooth branches chosen by numbers held constant between crossings."""

    def __init__(self):
        self.symbols, self.functions, self.values = [], [], []

    def choose(self, function, positive, negative):
        """positive where function > 0, else negative, through a symbol that is 1 or 0."""
        function = sp.sympify(function)
        if function.is_number:
            return positive if function > 0 else negative
        if function in self.functions:
            s = self.symbols[self.functions.index(function)]
        else:
            s = sp.Symbol(f"switch{len(self.symbols)}")
            self.symbols.append(s)
            self.functions.append(function)
        return s * positive + (1 - s) * negative


def evaluate(text, names, switches):
    """One expression string as sympy; numbers are exact, `^` becomes Python's own power."""

    def condition(c, a, b):
        greater = isinstance(c, (sp.StrictGreaterThan, sp.GreaterThan))
        return switches.choose(c.lhs - c.rhs if greater else c.rhs - c.lhs, a, b)

    functions = {n: getattr(sp, n) for n in "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sqrt".split()}
    functions |= {
        "if_": condition,
        "abs": lambda a: switches.choose(a, a, -a),
        "max": lambda a, b: switches.choose(a - b, a, b),
        "min": lambda a, b: switches.choose(b - a, a, b),
        "exact_": sp.Rational,
        "pi": sp.pi,
        "e": sp.E,
    }
    text = re.sub(r"\bif\s*\(", "if_(", text.replace("^", "**"))
    text = re.sub(r"(?<![\w.])(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)", r'exact_("\1")', text)
    return sp.sympify(eval(text, {"__builtins__": {}}, functions | names))


class Manifold:
    def __init__(self, path, **changes):
        self.stem = path.stem
        self.file = file = tomllib.loads(path.read_text())
        self.parameters = {k: sp.Rational(str(changes.get(k, v))) for k, v in file.get("parameters", {}).items()}
        self.coordinates = [sp.Symbol(c, real=True) for c in file["coordinates"]]
        names = dict(self.parameters) | dict(zip(file["coordinates"], self.coordinates))
        metric_switches, other_switches = Switches(), Switches()
        other_names = dict(names)
        for key, text in file.get("let", {}).items():
            if any(f"v{c}" in text for c in file["coordinates"]):
                continue  # serves exits only
            names[key] = evaluate(text, names, metric_switches)
            other_names[key] = evaluate(text, other_names, other_switches)
        self.metric(file, names, metric_switches)
        self.limits(file, other_names, other_switches)

    def metric(self, file, names, switches):
        """Functions for G, its derivatives and the switches, over arrays of points."""
        x = self.coordinates
        if "embedding" in file:
            f = sp.Matrix([evaluate(t, names, switches) for t in file["embedding"]])
            j = f.jacobian(x)
            g = [sum(j[k, a] * j[k, b] for k in range(len(f))) for a, b in PAIRS]
        elif "conformal" in file["metric"]:
            n = evaluate(file["metric"]["conformal"], names, switches)
            g = [n**2 if a == b else sp.Integer(0) for a, b in PAIRS]
        else:
            c = "xyz"
            g = [evaluate(file["metric"].get(c[a] + c[b], "0"), names, switches) for a, b in PAIRS]
        first = [sp.diff(e, a) for a in x for e in g]
        second = [sp.diff(e, x[a], x[b]) for a, b in PAIRS for e in g]
        used = set().union(*(e.free_symbols for e in g))
        keep = [i for i, s in enumerate(switches.symbols) if s in used]
        # a switch inside another one's condition is needed too; declared order keeps it earlier
        keep = sorted(set(keep) | {switches.symbols.index(s) for i in keep for s in switches.functions[i].free_symbols if s in switches.symbols})
        self.switch_symbols = [switches.symbols[i] for i in keep]
        phi = [switches.functions[i] for i in keep]
        arguments = [x, self.switch_symbols]
        self.compute = sp.lambdify(arguments, g + first + second, "numpy", cse=True)
        self.switch = sp.lambdify(arguments, phi, "numpy")
        self.switch_slope = sp.lambdify(arguments, [[sp.diff(p, a) for a in x] for p in phi], "numpy")

    def limits(self, file, names, switches):
        """A function that is positive as long as a point is neither outside nor past an exit."""
        x = self.coordinates
        domain = file.get("domain", {})
        ways = [evaluate(t, names, switches) for t in domain.get("inside", [])]
        ways += [-evaluate(e["when"], names, switches) for e in file.get("exit", [])]
        for c, s in zip(file["coordinates"], x):
            if c in domain and c not in domain.get("periodic", []):
                ways += [s - sp.Rational(str(domain[c][0])), sp.Rational(str(domain[c][1])) - s]
        for s, f in reversed(list(zip(switches.symbols, switches.functions))):
            ways = [w.subs(s, sp.Piecewise((1, f > 0), (0, True))) for w in ways]
        self.margins = sp.lambdify([x], ways, "numpy")

    def margin(self, u):
        with np.errstate(all="ignore"):
            values = [np.broadcast_to(np.asarray(m, float), u.shape[1:]) for m in self.margins(u)]
        return np.min(values, axis=0) if values else np.ones(u.shape[1:])

    def camera(self, rng):
        """A random chart point of the camera region, moved by a random element of the symmetry."""
        cameras, symmetry = self.file["cameras"], self.file.get("symmetry", {})
        domain = self.file.get("domain", {})
        ranges = cameras.get("parameters", {})
        if "at" in cameras:
            names = self.parameters | {k: sp.Float(rng.uniform(lo, hi), 30) for k, (lo, hi) in ranges.items()}
            u = np.array([float(evaluate(t, names, Switches())) for t in cameras["at"]])
        else:
            u = np.array([rng.uniform(*domain.get(c, [-1, 1])) for c in self.file["coordinates"]])
        if "rotation" in symmetry:
            q, r = np.linalg.qr(rng.normal(size=(3, 3)))
            u = q @ np.diag(np.sign(np.diag(r))) @ u
        for c in symmetry.get("translation", []):
            if c not in domain:
                u[self.file["coordinates"].index(c)] += rng.uniform(-1, 1)
        return u


# --- the differential equation ---------------------------------------------------------------


def pair(a, b):
    return PAIRS.index((min(a, b), max(a, b)))


# where each entry of G, dG and ddG stands in the list that Manifold.compute returns
ENTRY = np.array([[pair(a, b) for b in range(3)] for a in range(3)])
ENTRY1 = np.array([6 + 6 * l + ENTRY for l in range(3)])
ENTRY2 = np.array([[24 + 6 * pair(l, m) + ENTRY for m in range(3)] for l in range(3)])


def fields(manifold, u, switch):
    """G, dG[l], ddG[l, m] at the points u (3, n), as arrays [..., 3, 3, n]."""
    values = np.empty((60, u.shape[1]), LD)
    for row, value in zip(values, manifold.compute(u, switch)):
        row[:] = value
    return values[ENTRY], values[ENTRY1], values[ENTRY2]


def inverse(g):
    c = np.cross(g[[1, 2, 0]], g[[2, 0, 1]], axis=1)
    return c / np.sum(g[0] * c[0], axis=0)


def christoffel(manifold, u, switch):
    """Gamma[k, i, j] and its derivatives [l, k, i, j]."""
    g, d1, d2 = fields(manifold, u, switch)
    lower = (np.einsum("ikjn->kijn", d1) + np.einsum("jkin->kijn", d1) - d1) / 2
    dlower = (np.einsum("likjn->lkijn", d2) + np.einsum("ljkin->lkijn", d2) - d2) / 2
    up = inverse(g)
    gamma = np.einsum("kan,aijn->kijn", up, lower)
    dgamma = np.einsum("kan,laijn->lkijn", up, dlower - np.einsum("labn,bijn->laijn", d1, gamma))
    return gamma, dgamma


def derivative(manifold, y, switch, scale):
    """State (9, 3, n): u, v, three transported vectors, two variations du, two variations dv."""
    u, v = y[0], y[1]
    gamma, dgamma = christoffel(manifold, u, switch)
    gv = np.einsum("kijn,in->kjn", gamma, v)
    dgvv = np.einsum("lkijn,in,jn->lkn", dgamma, v, v)
    moved = -np.einsum("kjn,ajn->akn", gv, y[1:5])
    bent = -np.einsum("lkn,aln->akn", dgvv, y[5:7]) - 2 * np.einsum("kjn,ajn->akn", gv, y[7:9])
    return scale * np.concatenate([v[None], moved, y[7:9], bent])


def extrapolated_step(f, y, h, rows):
    """One Gragg-Bulirsch-Stoer step with 2, 4, ..., 2 rows substeps: new state and error."""
    table, slope = [], f(y)
    for j in range(rows):
        n = 2 * (j + 1)
        k = h / LD(n)
        before, now = y, y + k * slope
        for _ in range(n - 1):
            before, now = now, before + 2 * k * f(now)
        line = [now]
        for i in range(j):
            ratio = LD(n) ** 2 / LD(2 * (j - i)) ** 2 - 1
            line.append(line[i] + (line[i] - table[i]) / ratio)
        previous, table = table, line
    size = 1e-2 + np.maximum(np.abs(y), np.abs(table[-1])).max(axis=1, keepdims=True)
    return table[-1], float(np.max(np.abs(table[-1] - previous[-1]) / size))


def integrate(manifold, y, scale, end, tolerance=2e-15, rows=8):
    """The state after parameter `end`; crossings of switches need a batch of one ray."""
    switch = settle(manifold, y[0])
    assert not switch or y.shape[2] == 1
    t, h = LD(0), LD(end) / 50
    while t < end:
        h = min(h, LD(end) - t)
        if switch:
            distance = min(abs(float(p[0])) for p in manifold.switch(y[0], switch))
            h = min(h, LD(max(0.02, 0.4 * distance)))
        f = lambda q: derivative(manifold, q, switch, scale)
        with np.errstate(all="ignore"):
            new, error = extrapolated_step(f, y, h, rows)
        if not error <= tolerance:
            factor = (tolerance / error) ** (1 / (2 * rows - 1)) if np.isfinite(error) else 0.2
            h *= LD(min(0.8, max(0.2, 0.85 * factor)))
            assert h > 1e-9 * end, f"{manifold.stem}: stuck at {float(t)} with {y[0]}"
            continue
        crossed = crossings(manifold, y, new, switch, h, f, rows)
        if crossed:
            step, index, new = min(crossed, key=lambda c: c[0])
            t += step
            y, switch = jump(manifold, new, switch, index, scale)
            h = LD(0.01)
            continue
        t, y = t + h, new
        if error < 0.1 * tolerance:  # as good as rounding noise, which says nothing about the step
            h *= LD(1.5)
        else:
            h *= LD(min(1.5, 0.9 * (tolerance / error) ** (1 / (2 * rows - 1))))
    return y


def settle(manifold, u):
    """The branches at a start point."""
    switch = [1] * len(manifold.switch_symbols)
    for _ in switch:
        switch = [int(p[0] > 0) for p in manifold.switch(u, switch)]
    return switch


def crossings(manifold, y, new, switch, h, f, rows):
    """(step, switch, state) of every branch that the step left; Newton on the step length."""
    found = []
    for i, p in enumerate(manifold.switch(new[0], switch)):
        if int(p[0] > 0) == switch[i]:
            continue
        start = abs(manifold.switch(y[0], switch)[i][0])
        step, there = h * start / (start + abs(p[0])), None
        for _ in range(40):
            there, _ = extrapolated_step(f, y, step, rows)
            value = manifold.switch(there[0], switch)[i][0]
            slope = np.array([np.broadcast_to(np.asarray(s, LD), (1,)) for s in manifold.switch_slope(there[0], switch)[i]])
            change = value / np.sum(slope[:, 0] * there[1][:, 0])
            step = min(max(step - change, LD(0)), h)
            if abs(change) < 1e-17:
                break
        found.append((step, i, there))
    return found


def jump(manifold, y, switch, index, scale):
    """Change the branch; variations take the saltation (F+ - F-) (grad phi . du)/(grad phi . v)."""
    after = list(switch)
    after[index] = 1 - after[index]
    slope = np.array([np.broadcast_to(np.asarray(s, LD), (1,)) for s in manifold.switch_slope(y[0], switch)[index]])
    rate = np.sum(slope * y[1], axis=0)
    a0 = derivative(manifold, y, switch, scale)[1]
    a1 = derivative(manifold, y, after, scale)[1]
    y = y.copy()
    for c in range(2):
        y[7 + c] += (a1 - a0) * np.sum(slope * y[5 + c], axis=0) / rate
    return y, after


# --- rays ------------------------------------------------------------------------------------


def standard_frame(g):
    """S upper triangular with positive diagonal, S^T G S = I: Gram-Schmidt in coordinate order."""
    s = np.zeros((3, 3), LD)
    for k in range(3):
        w = np.eye(3, dtype=LD)[k]
        for _ in range(2):
            for j in range(k):
                w = w - s[:, j] * (s[:, j] @ g @ w)
        s[:, k] = w / np.sqrt(w @ g @ w)
    return s


def launch(manifold, u, d):
    """Start state of one ray, (9, 3, 1)."""
    u, d = np.array(u, LD), np.array(d, LD)
    d = d / np.sqrt(d @ d)
    g, _, _ = fields(manifold, u[:, None], settle(manifold, u[:, None]))
    s = standard_frame(g[:, :, 0])
    a = np.cross(d, np.eye(3, dtype=LD)[np.argmin(np.abs(d))])
    a = a / np.sqrt(a @ a)
    b = np.cross(d, a)
    zero = np.zeros(3, LD)
    return np.array([u, s @ d, *s.T, zero, zero, s @ a, s @ b])[:, :, None]


def area_of(manifold, y):
    """|det| of the two variations across the ray, from their Gram matrix."""
    g = fields(manifold, y[0], settle(manifold, y[0]))[0][:, :, 0]
    v, p, q = y[1, :, 0], y[5, :, 0], y[6, :, 0]
    p, q = (w - v * (v @ g @ w) for w in (p, q))
    return float(np.sqrt(np.linalg.det(g.astype(float)))) * abs(float(np.cross(p, q) @ v))


def shoot(manifold, u, d, length, **options):
    return integrate(manifold, launch(manifold, u, d), LD(1), length, **options)


def free_lengths(manifold, y, wanted):
    """How far each ray of a batch goes before an exit, an edge or a far place of the chart, at
    most `wanted`; plain RK4, since a little less than the truth is enough."""
    n, h = 800, LD(1) / 800
    scale, free = np.array(wanted, LD), np.array(wanted, float)
    open_ = manifold.margin(y[0]) > 0
    free[~open_] = 0
    for i in range(n):
        switch = [1] * len(manifold.switch_symbols)
        for _ in switch:
            switch = [(p > 0).astype(int) for p in manifold.switch(y[0], switch)]
        f = lambda w: derivative(manifold, w, switch, scale)
        with np.errstate(all="ignore"):
            k1 = f(y)
            k2 = f(y + h / 2 * k1)
            k3 = f(y + h / 2 * k2)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(y + h * k3))
            still = (manifold.margin(y[0]) > 0) & (np.abs(y[0]).max(axis=0) < 60)
        free[open_ & ~still] *= 0.96 * i / n
        open_ &= still
        y = np.where(open_, y, LD("nan"))
    return free


def candidates(manifold):
    """Twice as many rays as wanted: (start, direction, length, start state), the first good ones."""
    rng = np.random.default_rng(zlib.crc32(manifold.stem.encode()))
    tries = []
    for _ in range(2 * RAYS):
        u, d = manifold.camera(rng), rng.normal(size=3)
        d /= np.linalg.norm(d)
        tries.append((u, d, manifold.file["cameras"]["length"] * rng.uniform(0.25, 1.0)))
    starts = [launch(manifold, u, d) for u, d, _ in tries]
    free = free_lengths(manifold, np.concatenate(starts, axis=2), [t[2] for t in tries])
    rays = [(u, d, round(float(l), 6), y) for (u, d, w), l, y in zip(tries, free, starts) if l > 0.1 * w]
    assert len(rays) >= RAYS, manifold.stem
    return rays[:RAYS]


def references(path):
    """All reference rays of one manifold file, and a line on how well they agree."""
    manifold = Manifold(path)
    rays = candidates(manifold)
    if manifold.switch_symbols:
        run = lambda **options: [integrate(manifold, y, LD(1), length, **options) for _, _, length, y in rays]
    else:
        batch = np.concatenate([r[3] for r in rays], axis=2)
        scale = np.array([r[2] for r in rays], LD)

        def run(**options):
            y = integrate(manifold, batch, scale, 1, **options)
            return [y[:, :, i : i + 1] for i in range(RAYS)]

    finals, again = run(), run(tolerance=4e-14, rows=7)
    worst = max(float(np.max(np.abs(a - b)[:5])) for a, b in zip(finals, again))
    return [record(manifold, *ray, final) for ray, final in zip(rays, finals)], report(manifold, finals, worst)


def record(manifold, u, d, length, _, y):
    n = lambda a: [float(x) for x in a]
    return {
        "manifold": manifold.stem,
        "start": n(u),
        "direction": n(d),
        "length": length,
        "end": n(y[0, :, 0]),
        "velocity": n(y[1, :, 0]),
        "frame": [n(y[2 + k, :, 0]) for k in range(3)],
        "area": area_of(manifold, y),
        "end_kind": "length",
    }


def report(manifold, finals, worst):
    speed = ortho = 0.0
    for y in finals:
        g = fields(manifold, y[0], settle(manifold, y[0]))[0][:, :, 0]
        w = y[1:5, :, 0]
        gram = w @ g @ w.T
        speed = max(speed, abs(float(gram[0, 0]) - 1))
        ortho = max(ortho, float(np.abs(gram[1:, 1:] - np.eye(3)).max()))
    return f"{manifold.stem:22s} second run {worst:.1e}  speed {speed:.1e}  frame {ortho:.1e}"


# --- closed forms ----------------------------------------------------------------------------


def say(name, got, want, bound=1e-11):
    """Print a discrepancy; too large a one stops the script."""
    got, want = np.atleast_1d(np.asarray(got, float)), np.atleast_1d(np.asarray(want, float))
    off = float(np.max(np.abs(got - want)))
    print(f"  {name:44s} discrepancy {off:.1e}", flush=True)
    assert off < bound, (name, got, want)


def load(stem, **changes):
    return Manifold(MANIFOLDS / f"{stem}.toml", **changes)


def unit(*d):
    return np.array(d) / np.linalg.norm(d)


def random_rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q @ np.diag(np.sign(np.diag(r)))
    return q * np.linalg.det(q)


def swept(manifold, radius, heading, length, seed=1):
    """Angle swept about the origin from chart radius `radius`; heading is the cosine to the
    radial direction; in a random plane. Also the end state."""
    q = random_rotation(seed)
    u = q @ np.array([radius, 0, 0])
    g = fields(manifold, np.array(u, LD)[:, None], settle(manifold, np.array(u, LD)[:, None]))[0][:, :, 0].astype(float)
    radial, side = q[:, 0], q[:, 1]
    v = heading * radial / np.sqrt(radial @ g @ radial) + np.sqrt(1 - heading**2) * side / np.sqrt(side @ g @ side)
    d = np.linalg.solve(standard_frame(g.astype(LD)).astype(float), v)
    y = shoot(manifold, u, d, length)
    w = q.T @ y[0, :, 0].astype(float)
    return math.atan2(w[1], w[0]) % (2 * math.pi), y


def check_groups():
    rng = np.random.default_rng(5)
    nil = load("nil")
    d = unit(0.5, -0.4, 0.6)
    s, a, c, turn = 5.3, math.hypot(d[0], d[1]), d[2], math.atan2(d[1], d[0])
    y = shoot(nil, [0, 0, 0], d, s)
    w = 2 * a / c * math.sin(c * s / 2) * np.exp(1j * (c * s / 2 + turn))
    say("Nil position", y[0, :, 0], [w.real, w.imag, c * s + a * a / (2 * c * c) * (c * s - math.sin(c * s))])
    say("Nil area", area_of(nil, y), abs(2 - 2 * math.cos(c * s) - c * s * (1 - c * c) * math.sin(c * s)) / c**4)
    sol = load("sol")
    y = shoot(sol, [0, 0, 0], [0.6, 0.5, math.sqrt(1 - 0.61)], 5)
    say("Sol position (published to 8 digits)", y[0, :, 0], [3.27790077, 4.09009073, -0.19595538], 6e-9)
    for stem, curved in (("h2xr", math.sinh), ("s2xr", math.sin)):
        m, u, d, s = load(stem), rng.uniform(0.3, 0.8, 3), unit(*rng.normal(size=3)), 2.5
        y = shoot(m, u, d, s)
        if stem == "h2xr":
            h = math.hypot(d[0], d[1])
        else:
            v = y[1, :, 0] / np.linalg.norm(y[0, :, 0].astype(float))
            h = math.sqrt(1 - float(v @ y[0, :, 0] / np.linalg.norm(y[0, :, 0].astype(float))) ** 2)
        say(f"{stem} area", area_of(m, y), abs(s * curved(h * s) / h))


def check_constant_curvature():
    cases = [("s3", math.sin, 2.8), ("s3-graph", math.sin, 0.5), ("h3-ball", math.sinh, 4), ("h3-half-space", math.sinh, 4), ("flat", lambda s: s, 7), ("rolled-sheet", lambda s: s, 7)]
    for stem, curved, s in cases:
        m = load(stem)
        y = shoot(m, [0.2, -0.3, 0.45], unit(0.3, 0.8, -0.5), s)
        size = curved(s) ** 2
        say(f"{stem} area", area_of(m, y) / size, 1)
    m, u = load("s3"), np.array([0.7, 0.4, -0.5])
    y = shoot(m, u, unit(0.1, 0.7, 0.4), math.pi)
    say("s3 antipode", y[0, :, 0], -u / (u @ u))
    y = shoot(m, u, unit(0.1, 0.7, 0.4), 2 * math.pi)
    say("s3 closes", y[0, :, 0], u)


def check_deflections():
    far = 1e6
    m = load("ellis-wormhole")
    for b, want in ((2, 0.2299080560354), (1.1, 1.5022554199624), (5, 0.0321430413185)):
        l = math.sqrt(b * b - 1)
        angle, _ = swept(m, (l + b) / 2, 0.0, far)
        say(f"Ellis deflection b={b}", 2 * (angle + b / far) - math.pi, want, 1e-10)
    angle, _ = swept(m, 0.5, math.sqrt(0.75), far)
    say("Ellis passing through b=0.5", 2 * (angle + 0.5 / far), 1.6857503548126, 1e-10)
    m = load("schwarzschild")
    for b, want in ((6, 1.7193883102302), (10, 0.5903957876058), (20, 0.2361359953885), (100, 0.0412225397493)):
        r = brentq(lambda r: r**3 - b * b * (r - 2), 3.0, 2 * b, xtol=1e-14, rtol=1e-15)
        rho = (r - 1 + math.sqrt(r * r - 2 * r)) / 2
        angle, y = swept(m, rho, 0.0, far)
        rho = float(np.linalg.norm(y[0, :, 0].astype(float)))
        say(f"Schwarzschild deflection b={b}", 2 * (angle + b / (rho * (1 + 0.5 / rho) ** 2)) - math.pi, want, 1e-10)
    m = load("interstellar-wormhole")
    angle, y = swept(m, 0.5, math.sqrt(0.75), far)
    say("Interstellar passing through b=0.5", 2 * (angle + 0.5 / far), 1.18137496623, 1e-9)
    m = load("gaussian-bump")
    for b, want in ((0.5, 0.3242617359016), (1, 0.3032443164935), (2, 0.03203006981698)):
        angle, y = swept(m, b, 0.0, 1e3)
        end = np.linalg.norm(y[0, :, 0].astype(float))
        say(f"Gaussian bump deflection b={b}", abs(2 * (angle + math.asin(b / end)) - math.pi), want)


def check_lenses():
    m = load("luneburg")
    q = random_rotation(3)
    for height in (0.2, 0.6, 0.9):
        y = shoot(m, q @ np.array([-3, height, 0.1]), q[:, 0], 3 + math.pi / 2)
        say(f"Luneburg focus, height {height}", y[0, :, 0], q[:, 0])
    start, d, length = q @ np.array([0.5, 0.1, 0.2]), unit(*(q @ np.array([-0.8, 0.5, 0.2]))), 4.0
    y = shoot(m, start, d, length)
    say("Luneburg area across the kink, by differences", area_of(m, y), difference_area(m, start, d, length), 1e-9)
    m = load("grin-rod")
    u, d = np.array([0.2, -0.3, 0.4]), unit(0.3, 0.25, 0.9)
    n = 1.5 * math.sqrt(1 - u[0] ** 2 - u[1] ** 2)
    k, p = 1.5, n * d
    place = lambda t: np.array([*(u[:2] * math.cos(k * t) + p[:2] / k * math.sin(k * t)), u[2] + p[2] * t])
    index2 = lambda t: 2.25 * (1 - place(t)[0] ** 2 - place(t)[1] ** 2)
    end = 3.0
    y = shoot(m, u, d, quad(index2, 0, end, epsabs=1e-13, epsrel=1e-13)[0])
    say("Gradient-index rod", y[0, :, 0], place(end))
    m = load("cone")
    angle, y = swept(m, 3.0, -0.6, 7.0)
    say("Monopole, unrolled", angle, math.atan2(7 * 0.8, 3 - 7 * 0.6) / 0.8)


def difference_area(manifold, start, d, length):
    """The area from neighbouring rays instead of variations, where the end lies in flat space."""
    a = unit(*np.cross(d, [0.1, 0.2, 1.0]))
    b = np.cross(d, a)
    end = lambda w, h: shoot(manifold, start, d * math.cos(h) + w * math.sin(h), length)[0, :, 0]
    slope = lambda w, h: (end(w, h) - end(w, -h)) / (2 * h)
    p, q = ((4 * slope(w, 5e-4) - slope(w, 1e-3)) / 3 for w in (a, b))
    return float(np.linalg.norm(np.cross(p, q).astype(float)))


def main():
    stems = sys.argv[1:]
    paths = [p for p in sorted(MANIFOLDS.glob("*.toml")) if not stems or p.stem in stems]
    checks = (check_deflections, check_lenses, check_groups, check_constant_curvature)
    with ProcessPoolExecutor(2) as pool:
        checked = [pool.submit(check) for check in checks]
        found = []
        for records, line in pool.map(references, paths):
            print(line, flush=True)
            found += records
        [c.result() for c in checked]  # a failed check stops here
    out = HERE / "references.json"
    out.write_text("[\n" + ",\n".join(json.dumps(r) for r in found) + "\n]\n")
    print(f"{len(found)} rays, {out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
