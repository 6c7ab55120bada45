"""The manifold text of a bundle (docs/FORMAT.md, appendix A).

In: TOML and the values of its parameters. Out: metric, wind and standard frame at a chart point, the
camera region, the left translation of a group, the conditions that end a path. First derivatives come from
dual numbers. A key that this reader does not evaluate is refused by its name.
"""

import re
import tomllib

import numpy as np

from container import require

TOKEN = re.compile(r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(\w+)|(<=|>=|[-+*/^(),<>]))")


class Dual:
    """A number and its gradient. Where a formula has no value both are no numbers, without an error."""

    __slots__ = ("x", "d")

    def __init__(self, x, d=0.0):
        self.x, self.d = np.float64(x), d


def scaled(slope, d):
    """Multiplies a gradient; that of a constant stays zero whatever the slope is."""
    return slope * d if np.any(d) else 0.0


def chain(f, slope):
    """Makes a function of one dual number from the function and its derivative."""
    return lambda a: Dual(f(a.x), scaled(slope(a.x), a.d))


def multiply(a, b):
    return Dual(a.x * b.x, scaled(a.x, b.d) + scaled(b.x, a.d))


def divide(a, b):
    return Dual(a.x / b.x, scaled(1 / b.x, a.d) - scaled(a.x / b.x / b.x, b.d))


def power(a, b):
    value = a.x**b.x
    slope = b.x * a.x ** (b.x - 1) if b.x != 0 else 0.0
    if not np.any(b.d):
        return Dual(value, scaled(slope, a.d))
    return Dual(value, scaled(slope, a.d) + scaled(value * np.log(a.x), b.d))


def atan2(a, b):
    square = a.x * a.x + b.x * b.x
    return Dual(np.arctan2(a.x, b.x), scaled(b.x / square, a.d) - scaled(a.x / square, b.d))


UNARY = {
    "sin": chain(np.sin, np.cos),
    "cos": chain(np.cos, lambda x: -np.sin(x)),
    "tan": chain(np.tan, lambda x: 1 / np.cos(x) ** 2),
    "asin": chain(np.arcsin, lambda x: 1 / np.sqrt(1 - x * x)),
    "acos": chain(np.arccos, lambda x: -1 / np.sqrt(1 - x * x)),
    "atan": chain(np.arctan, lambda x: 1 / (1 + x * x)),
    "sinh": chain(np.sinh, np.cosh),
    "cosh": chain(np.cosh, np.sinh),
    "tanh": chain(np.tanh, lambda x: 1 / np.cosh(x) ** 2),
    "asinh": chain(np.arcsinh, lambda x: 1 / np.sqrt(1 + x * x)),
    "acosh": chain(np.arccosh, lambda x: 1 / np.sqrt(x * x - 1)),
    "atanh": chain(np.arctanh, lambda x: 1 / (1 - x * x)),
    "exp": chain(np.exp, np.exp),
    "log": chain(np.log, lambda x: 1 / x),
    "ln": chain(np.log, lambda x: 1 / x),
    "sqrt": chain(np.sqrt, lambda x: 0.5 / np.sqrt(x)),
    "abs": chain(np.abs, lambda x: np.copysign(1.0, x)),
}
BINARY = {
    "atan2": atan2,
    "min": lambda a, b: a if a.x < b.x else b,
    "max": lambda a, b: a if a.x > b.x else b,
    "+": lambda a, b: Dual(a.x + b.x, a.d + b.d),
    "-": lambda a, b: Dual(a.x - b.x, a.d - b.d),
    "*": multiply,
    "/": divide,
    "^": power,
}
COMPARISONS = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}
# Left and right tightness of each operator; that of a unary sign is 5.
TIGHTNESS = {"+": (1, 2), "-": (1, 2), "*": (3, 4), "/": (3, 4), "^": (7, 6)}


class Parser:
    """An expression as a function from names to dual numbers, by precedence climbing."""

    def __init__(self, text):
        self.tokens, at = [], 0
        while text[at:].strip():
            match = TOKEN.match(text, at)
            require(match, f"the expression {text!r} cannot be read")
            self.tokens.append(match.groups())
            at = match.end()
        self.tokens.append((None, None, None))
        self.at = 0

    def parse(self):
        tree = self.expression(0)
        require(self.tokens[self.at] == (None, None, None), "an expression does not end")
        return tree

    def symbol(self):
        return self.tokens[self.at][2]

    def expect(self, symbol):
        require(self.symbol() == symbol, f"`{symbol}` is missing in an expression")
        self.at += 1

    def expression(self, tightness):
        left = self.operand()
        while self.symbol() in TIGHTNESS and TIGHTNESS[self.symbol()][0] >= tightness:
            symbol = self.symbol()
            self.at += 1
            right = self.expression(TIGHTNESS[symbol][1])
            left = self.applied(BINARY[symbol], left, right)
        return left

    def operand(self):
        number, name, symbol = self.tokens[self.at]
        self.at += 1
        if number is not None:
            return lambda names, value=float(number): Dual(value)
        if symbol == "-":
            operand = self.expression(5)
            return lambda names: Dual(-(value := operand(names)).x, -value.d)
        if symbol == "+":
            return self.expression(5)
        if symbol == "(":
            inner = self.expression(0)
            self.expect(")")
            return inner
        require(name is not None, "an operand is missing in an expression")
        if self.symbol() != "(":
            return lambda names: names[name]
        self.at += 1
        return self.conditional() if name == "if" else self.call(name)

    def call(self, name):
        arguments = [self.expression(0)]
        while self.symbol() == ",":
            self.at += 1
            arguments.append(self.expression(0))
        self.expect(")")
        functions = {1: UNARY, 2: BINARY}.get(len(arguments), {})
        require(name in functions, f"unknown function `{name}`")
        return self.applied(functions[name], *arguments)

    def conditional(self):
        a = self.expression(0)
        compare = COMPARISONS[self.symbol()]
        self.at += 1
        parts = [a, self.expression(0)]
        for _ in range(2):
            self.expect(",")
            parts.append(self.expression(0))
        self.expect(")")
        a, b, yes, no = parts
        return lambda names: yes(names) if compare(a(names).x, b(names).x) else no(names)

    @staticmethod
    def applied(function, *parts):
        return lambda names: function(*(part(names) for part in parts))


def variables(values):
    """Makes dual numbers with a gradient along each of these values."""
    return [Dual(float(x), row) for x, row in zip(values, np.eye(len(values)))]


def value_and_gradient(duals, count):
    """Splits dual numbers into values and rows of derivatives."""
    values = np.array([a.x for a in duals])
    return values, np.array([np.zeros(count) + a.d for a in duals])


class Names(dict):
    """Values of names; lets are worked out when they are used, since some serve exits alone."""

    def __init__(self, lets):
        self.lets = lets

    def __missing__(self, name):
        require(name in self.lets, f"unknown name `{name}`")
        self[name] = self.lets[name](self)
        return self[name]


# The keys of a manifold text that this reader evaluates, or on which no table depends (`name`, `drift`).
KEYS = {
    *("name", "coordinates", "embedding", "metric", "spacetime", "pullback", "wind", "shift"),
    *("lapse", "drift", "parameters", "let", "domain", "exit", "symmetry", "cameras"),
}
DIAGONAL = [(0, 0), (1, 1), (2, 2)]
# From a point at which textbook coordinates fail to its neighbours, over its distance from the origin.
BESIDE = 1e-3 * np.array([0.48, 0.6, 0.64])


def refuse_unknown(table, known, where):
    """Refuses keys that this reader does not know: paths may depend on them."""
    for key in table:
        require(key in known, f"this reader does not evaluate the key `{key}` {where}")


def expressions(texts):
    return [Parser(t).parse() for t in texts]


class Manifold:
    """A space in one chart."""

    def __init__(self, text, parameters):
        document = tomllib.loads(text)
        refuse_unknown(document, KEYS, "of the manifold text")
        self.coordinates = document["coordinates"]
        self.parameters = dict(parameters)
        self.lets = {k: Parser(t).parse() for k, t in document.get("let", {}).items()}
        pullback = document.get("pullback", {})
        self.textbook = list(zip(pullback, expressions(pullback.values())))
        self.read_domain(document.get("domain", {}), document.get("exit", []))
        self.read_definition(document)
        symmetry = document.get("symmetry", {})
        refuse_unknown(symmetry, {"rotation", "translation", "group"}, "in [symmetry]")
        self.translated = [name in symmetry.get("translation", []) for name in self.coordinates]
        rotation = symmetry.get("rotation")
        self.axis = self.coordinates.index(rotation) if rotation in self.coordinates else None
        group = symmetry.get("group")
        self.group = group and expressions(group)
        self.read_cameras(document.get("cameras", {}))

    def read_domain(self, domain, exits):
        refuse_unknown(domain, {*self.coordinates, "periodic", "inside"}, "in [domain]")
        glued = domain.get("periodic", [])
        self.limits = [domain.get(name) for name in self.coordinates]
        self.glued = [name in glued for name in self.coordinates]
        self.inside = expressions(domain.get("inside", []))
        for exit in exits:
            refuse_unknown(exit, {"name", "when", "direction"}, "in [[exit]]")
        self.exits = [(exit["name"], Parser(exit["when"]).parse()) for exit in exits]

    def read_definition(self, document):
        """Reads how the space is given; `kind` is embedding, metric, normal or static."""
        self.kind, self.time = "metric", []
        self.wind, self.shift, self.lapse = None, None, None
        # A drift moves paths, but neither their starts nor their tangents: appendix A.
        for key in ("wind", "shift", "drift"):
            if key in document:
                setattr(self, key, expressions(document[key]))
        if "lapse" in document:
            self.lapse = Parser(document["lapse"]).parse()
        if "embedding" in document:
            self.kind, self.embedding = "embedding", expressions(document["embedding"])
            return
        if "spacetime" in document:
            table = dict(document["spacetime"])
            self.kind = table.pop("observers", "normal")
            require(self.kind in ("normal", "static"), f"unknown observers `{self.kind}`")
            self.time = [Parser(table.pop("tt")).parse()]
            for name in self.written_in():
                texts = [table.pop(key, None) for key in ("t" + name, name + "t")]
                self.time.append(Parser(texts[0] or texts[1] or "0").parse())
            self.entries = self.read_entries(table, "[spacetime]")
            return
        table = document["metric"]
        self.conformal = "conformal" in table
        if self.conformal:
            refuse_unknown(table, {"conformal"}, "in `metric`")
            factor = Parser(table["conformal"]).parse()
            self.entries = {pair: factor for pair in DIAGONAL}
        else:
            self.entries = self.read_entries(table, "`metric`")

    def written_in(self):
        """Names the coordinates of metric, wind and drift."""
        return [name for name, _ in self.textbook] or self.coordinates

    def read_entries(self, table, where):
        spellings = [self.written_in()]
        if not self.textbook and not set("xyz") & set(self.coordinates):
            spellings.append(["x", "y", "z"])
        keys = {
            names[i] + names[j]: (i, j) for names in spellings for i in range(3) for j in range(3)
        }
        refuse_unknown(table, keys, f"in {where}")
        return {keys[key]: Parser(text).parse() for key, text in table.items()}

    def read_cameras(self, cameras):
        refuse_unknown(cameras, {"parameters", "at", "length"}, "in [cameras]")
        intervals = cameras.get("parameters", {})
        if "at" in cameras:
            at = expressions(cameras["at"])
        elif self.group:
            intervals, at = {}, [Parser("0").parse()] * 3
        else:
            intervals = dict(zip(self.coordinates, self.limits))
            at = expressions(self.coordinates)
        self.region = Region(self, intervals, at)

    def scope(self):
        """Gives the names that stand for constants, and lets."""
        names = Names(self.lets)
        names.update(pi=Dual(np.pi), e=Dual(np.e))
        names.update((name, Dual(x)) for name, x in self.parameters.items())
        return names

    def names(self, u, v=None):
        """Gives all names at a chart point, differentiated by its coordinates."""
        names = self.scope()
        for k, (name, x) in enumerate(zip(self.coordinates, variables(u))):
            names[name] = Dual(x.x - self.shift_of(k, x.x), x.d)
            if v is not None:
                names["v" + name] = Dual(v[k])
        for name, tree in self.textbook:
            names[name] = tree(names)
        return names

    def shift_of(self, k, x):
        """Gives the multiple of the period by which a glued coordinate lies outside its limits."""
        if not self.glued[k]:
            return 0.0
        low, high = self.limits[k]
        return (high - low) * np.floor((x - low) / (high - low))

    def wrap(self, u):
        return np.array([x - self.shift_of(k, x) for k, x in enumerate(u)])

    def geometry(self, u):
        """Gives the metric and the wind as lines of sight meet it.

        On an axis of textbook coordinates these are what those around it tend to.
        """
        u = np.asarray(u, dtype=float)
        with np.errstate(all="ignore"):
            found = self.geometry_beside_axes(u)
            if np.all(np.isfinite(found)) or not self.textbook:
                return found[0], found[1][0]
            size = np.linalg.norm(u) or 1.0
            mean = lambda k: 0.5 * sum(
                self.geometry_beside_axes(u + sign * k * size * BESIDE) for sign in (1, -1)
            )
            # Even functions of the distance: terms of its second and fourth powers fall out.
            found = (15 * mean(1) - 6 * mean(2) + mean(3)) / 10
        return found[0], found[1][0]

    def geometry_beside_axes(self, u):
        """Stacks the metric and a matrix whose first row is the wind."""
        names = self.names(u)
        metric, wind = self.written(names)
        if self.textbook:
            _, jacobian = value_and_gradient([names[name] for name, _ in self.textbook], 3)
            if self.kind != "embedding":
                metric = jacobian.T @ metric @ jacobian
            if np.any(wind):
                bad = not np.all(np.isfinite(jacobian)) or np.linalg.det(jacobian) == 0
                wind = np.full(3, np.nan) if bad else np.linalg.solve(jacobian, wind)
        # Lines of sight run into the past.
        return np.array([metric, np.outer([1.0, 0.0, 0.0], -wind)])

    def written(self, names):
        """Gives metric and wind in the coordinates in which the text is written."""
        value = lambda trees: np.array([tree(names).x for tree in trees])
        if self.kind == "embedding":
            _, jacobian = value_and_gradient([f(names) for f in self.embedding], 3)
            return jacobian.T @ jacobian, value(self.wind) if self.wind else np.zeros(3)
        space = np.zeros((3, 3))
        for (i, j), entry in self.entries.items():
            space[i, j] = space[j, i] = entry(names).x ** (2 if self.is_conformal() else 1)
        if self.kind == "metric" and self.shift:
            lapse = self.lapse(names).x if self.lapse else 1.0
            return space / lapse**2, -value(self.shift)
        if self.kind == "metric":
            return space, value(self.wind) if self.wind else np.zeros(3)
        tt, *mixed = value(self.time)
        if self.kind == "static":
            return space / -tt + np.outer(mixed, mixed) / tt**2, np.zeros(3)
        shift = np.linalg.solve(space, mixed) if np.all(np.isfinite(space)) else np.full(3, np.nan)
        return space / (mixed @ shift - tt), -shift

    def is_conformal(self):
        return self.kind == "metric" and self.conformal

    def metric(self, u):
        return self.geometry(u)[0]

    def frame(self, u):
        """Gives the standard frame: upper triangular, with the metric's unit lengths."""
        return np.linalg.inv(np.linalg.cholesky(self.metric(u)).T)

    def restored(self, u, v):
        """Gives the tangent with its part against the wind at unit length."""
        metric, wind = self.geometry(u)
        n = v - wind
        return n / np.sqrt(n @ metric @ n) + wind

    def ends(self, u, v):
        """Lists what ends a path and the number for each that is positive where it does."""
        with np.errstate(all="ignore"):
            names = self.names(u, v)
            found = [(name, tree(names).x) for name, tree in self.exits]
            for x, limits, glued in zip(u, self.limits, self.glued):
                if limits and not glued:
                    found += [("limit", limits[0] - x), ("limit", x - limits[1])]
            found += [("inside", -tree(names).x) for tree in self.inside]
            if self.kind == "static":
                found.append(("inside", self.time[0](names).x))
        return found

    def left_translation(self, u, p):
        """Gives p·u and its derivative by u."""
        names = self.scope()
        for name, x in zip(self.coordinates, variables(u)):
            names[name] = x
        for name, x in zip(self.coordinates, p):
            names["p" + name] = Dual(float(x))
        return value_and_gradient([g(names) for g in self.group], 3)


class Region:
    """Where cameras may be: parameters in intervals, mapped to chart points."""

    def __init__(self, manifold, intervals, at):
        self.manifold, self.at_trees = manifold, at
        self.names, self.intervals = list(intervals), [tuple(i) for i in intervals.values()]

    def map(self, parameters):
        """Gives the chart point and its derivatives by the parameters."""
        names = self.manifold.scope()
        names.update(zip(self.names, variables(parameters)))
        with np.errstate(all="ignore"):
            return value_and_gradient([t(names) for t in self.at_trees], len(self.names))

    def at(self, parameters):
        return self.map(parameters)[0]

    def middle(self):
        return self.at([0.5 * (low + high) for low, high in self.intervals])

    def locate(self, u, value=lambda point, slopes: (point, slopes)):
        """Finds the parameters at whose point `value` is u: Gauss–Newton from several starts."""
        count = len(self.names)
        low, high = np.array(self.intervals).reshape(count, 2).T
        for start in np.ndindex(*[3] * count):
            p = low + (high - low) * np.array([[0.5, 0.1, 0.9][i] for i in start])
            for _ in range(60):
                point, slopes = value(*self.map(p))
                step = np.linalg.lstsq(slopes, u - point, rcond=None)[0] if count else 0
                p = np.clip(p + step, low - 1e-9 * (high - low), high + 1e-9 * (high - low))
            off = np.linalg.norm(value(*self.map(p))[0] - u)
            if off <= 1e-9 * max(1e-3, np.linalg.norm(u)):
                return list(np.clip(p, low, high))
        require(False, f"no camera of the bundle is at {u}")
