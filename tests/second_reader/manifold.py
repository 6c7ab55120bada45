"""The manifold text of a bundle (docs/FORMAT.md, appendix A).

In: TOML and the values of its parameters. Out: metric and standard frame at a chart point, the camera
region, the left translation of a group. Derivatives come from dual numbers.
"""

import math
import re
import tomllib

import numpy as np

from container import require

TOKEN = re.compile(r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(\w+)|(<=|>=|[-+*/^(),<>]))")


class Dual:
    """A number and its gradient."""

    __slots__ = ("x", "d")

    def __init__(self, x, d=0.0):
        self.x, self.d = x, d


def chain(f, slope):
    """Makes a function of one dual number from the function and its derivative."""
    return lambda a: Dual(f(a.x), slope(a.x) * a.d)


def multiply(a, b):
    return Dual(a.x * b.x, a.x * b.d + b.x * a.d)


def divide(a, b):
    return Dual(a.x / b.x, (a.d - a.x / b.x * b.d) / b.x)


def power(a, b):
    if not np.any(b.d):
        slope = b.x * a.x ** (b.x - 1) if b.x != 0 else 0.0
        return Dual(a.x**b.x, slope * a.d)
    value = a.x**b.x
    return Dual(value, value * (b.d * math.log(a.x) + b.x / a.x * a.d))


def atan2(a, b):
    square = a.x * a.x + b.x * b.x
    return Dual(math.atan2(a.x, b.x), (b.x * a.d - a.x * b.d) / square)


UNARY = {
    "sin": chain(math.sin, math.cos),
    "cos": chain(math.cos, lambda x: -math.sin(x)),
    "tan": chain(math.tan, lambda x: 1 / math.cos(x) ** 2),
    "asin": chain(math.asin, lambda x: 1 / math.sqrt(1 - x * x)),
    "acos": chain(math.acos, lambda x: -1 / math.sqrt(1 - x * x)),
    "atan": chain(math.atan, lambda x: 1 / (1 + x * x)),
    "sinh": chain(math.sinh, math.cosh),
    "cosh": chain(math.cosh, math.sinh),
    "tanh": chain(math.tanh, lambda x: 1 / math.cosh(x) ** 2),
    "asinh": chain(math.asinh, lambda x: 1 / math.sqrt(1 + x * x)),
    "acosh": chain(math.acosh, lambda x: 1 / math.sqrt(x * x - 1)),
    "atanh": chain(math.atanh, lambda x: 1 / (1 - x * x)),
    "exp": chain(math.exp, math.exp),
    "log": chain(math.log, lambda x: 1 / x),
    "ln": chain(math.log, lambda x: 1 / x),
    "sqrt": chain(math.sqrt, lambda x: 0.5 / math.sqrt(x)),
    "abs": chain(abs, lambda x: math.copysign(1.0, x)),
    "floor": chain(math.floor, lambda x: 0.0),
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


class Manifold:
    """A space in one chart."""

    def __init__(self, text, parameters):
        document = tomllib.loads(text)
        self.coordinates = document["coordinates"]
        self.parameters = dict(parameters)
        self.lets = {k: Parser(t).parse() for k, t in document.get("let", {}).items()}
        self.read_domain(document.get("domain", {}))
        self.read_definition(document)
        symmetry = document.get("symmetry", {})
        self.rotation = "rotation" in symmetry
        self.translated = [name in symmetry.get("translation", []) for name in self.coordinates]
        group = symmetry.get("group")
        self.group = group and [Parser(t).parse() for t in group]
        self.read_cameras(document.get("cameras", {}))

    def read_domain(self, domain):
        glued = domain.get("periodic", [])
        self.limits = [domain.get(name) for name in self.coordinates]
        self.glued = [name in glued for name in self.coordinates]

    def read_definition(self, document):
        self.embedding, self.entries = None, None
        if "embedding" in document:
            self.embedding = [Parser(t).parse() for t in document["embedding"]]
            return
        metric = document["metric"]
        self.conformal = Parser(metric["conformal"]).parse() if "conformal" in metric else None
        if self.conformal is not None:
            return
        spellings = [self.coordinates]
        if not set("xyz") & set(self.coordinates):
            spellings.append(["x", "y", "z"])
        self.entries = {}
        for names in spellings:
            for i in range(3):
                for j in range(3):
                    if names[i] + names[j] in metric:
                        self.entries[i, j] = Parser(metric[names[i] + names[j]]).parse()

    def read_cameras(self, cameras):
        intervals = cameras.get("parameters", {})
        if "at" in cameras:
            at = [Parser(t).parse() for t in cameras["at"]]
        elif self.group:
            intervals, at = {}, [Parser("0").parse()] * 3
        else:
            intervals = dict(zip(self.coordinates, self.limits))
            at = [Parser(name).parse() for name in self.coordinates]
        self.region = Region(self, intervals, at)

    def scope(self):
        """Gives the names that stand for constants, and lets."""
        names = Names(self.lets)
        names.update(pi=Dual(math.pi), e=Dual(math.e))
        names.update((name, Dual(x)) for name, x in self.parameters.items())
        return names

    def names(self, u):
        """Gives all names at a chart point, differentiated by its coordinates."""
        names = self.scope()
        for k, (name, x) in enumerate(zip(self.coordinates, variables(u))):
            names[name] = Dual(x.x - self.shift(k, x.x), x.d)
        return names

    def shift(self, k, x):
        """Gives the multiple of the period by which a glued coordinate lies outside its limits."""
        if not self.glued[k]:
            return 0.0
        low, high = self.limits[k]
        return (high - low) * math.floor((x - low) / (high - low))

    def wrap(self, u):
        return np.array([x - self.shift(k, x) for k, x in enumerate(u)])

    def metric(self, u):
        names = self.names(u)
        if self.embedding is not None:
            _, jacobian = value_and_gradient([f(names) for f in self.embedding], 3)
            return jacobian.T @ jacobian
        if self.entries is None:
            return np.eye(3) * self.conformal(names).x ** 2
        metric = np.zeros((3, 3))
        for (i, j), entry in self.entries.items():
            metric[i, j] = metric[j, i] = entry(names).x
        return metric

    def frame(self, u):
        """Gives the standard frame: upper triangular, with the metric's unit lengths."""
        return np.linalg.inv(np.linalg.cholesky(self.metric(u)).T)

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
        return value_and_gradient([t(names) for t in self.at_trees], len(self.names))

    def at(self, parameters):
        return self.map(parameters)[0]

    def middle(self):
        return self.at([0.5 * (low + high) for low, high in self.intervals])

    def locate(self, u):
        """Finds the parameters whose point is u: Gauss–Newton from several starts."""
        count = len(self.names)
        low, high = np.array(self.intervals).reshape(count, 2).T
        for start in np.ndindex(*[3] * count):
            p = low + (high - low) * np.array([[0.5, 0.1, 0.9][i] for i in start])
            for _ in range(60):
                point, slopes = self.map(p)
                step = np.linalg.lstsq(slopes, u - point, rcond=None)[0] if count else 0
                p = np.clip(p + step, low - 1e-9 * (high - low), high + 1e-9 * (high - low))
            if np.linalg.norm(self.at(p) - u) <= 1e-9 * max(1e-3, np.linalg.norm(u)):
                return list(np.clip(p, low, high))
        require(False, f"no camera of the bundle is at {u}")
