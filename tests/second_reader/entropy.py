"""The entropy coding of a chunk (docs/FORMAT.md, section 7).

In: the words of a chunk. Out: arrays of integers. The models learn from every integer in binary64, so
each operation here is in the order of the text; Python's `sum` is not used, because it compensates
rounding since Python 3.12.
"""

from math import frexp, sqrt

from container import require

CLASSES, BITS = 130, 15
NEVER, ALWAYS = 64, 65472
ALONG_LAST = [(1, 0, 3.0), (2, 0, 3.0), (3, 0, 0.5), (4, 0, 0.5)]
ALONG_OTHERS = [(1, 0, 3.0), (2, 0, 2.0), (3, 0, 0.5), (1, -1, 0.5), (1, 1, 0.5), (1, 2, 0.5)]
HISTORY_WEIGHT = 3.0
LEARNING_RATE, SIGN_RATE = 0.002, 0.015


def total(numbers):
    """Sums from left to right."""
    result = 0.0
    for x in numbers:
        result += x
    return result


def truncated(a, b):
    """Divides integers, rounding towards zero; b is positive."""
    return a // b if a >= 0 else -(-a // b)


class RangeDecoder:
    """Section 7.1."""

    def __init__(self, words):
        self.words, self.at = words, 0
        self.range = (1 << 64) - 1
        self.offset = self.word() << 32
        self.offset |= self.word()

    def word(self):
        self.at += 1
        return self.words[self.at - 1] if self.at <= len(self.words) else 0

    def narrow(self, scale, first, share):
        self.offset -= scale * first
        self.range = scale * share
        if self.range < 1 << 32:
            self.range <<= 32
            self.offset = (self.offset << 32) | self.word()

    def quantile(self, scale):
        quantile = self.offset // scale
        require(quantile < 65536, "the code is damaged")
        return quantile

    def bit(self, y):
        """Decodes a yes that has the probability y / 65536."""
        scale = self.range >> 16
        yes = self.quantile(scale) < y
        if yes:
            self.narrow(scale, 0, y)
        else:
            self.narrow(scale, y, 65536 - y)
        return yes

    def raw(self, count):
        """Decodes a number of so many bits, all equally likely."""
        value = 0
        while count > 0:
            part = min(count, 16)
            share = 1 << (16 - part)
            scale = self.range >> 16
            digits = self.quantile(scale) // share
            self.narrow(scale, digits * share, share)
            value = (value << part) | digits
            count -= part
        return value

    def finish(self):
        require(self.at >= len(self.words), "words are left over")


def low_bits(c):
    return max(c - 16, 0) // 4


def first_probability(c):
    """Calculates the first probability of yes of the adaptive bits of class c."""
    a, b = 1, 20
    if c >= 2:
        a = [218, 259, 308, 367][(c - 2) % 4] << ((c - 2) // 4)
        b = 1000 << low_bits(c)
    return min(max(65536 * a // (a + b), NEVER), ALWAYS)


class Magnitudes:
    """The adaptive bits of all classes: section 7.2."""

    def __init__(self, decoder):
        self.decoder = decoder
        self.y = [[first_probability(c)] * BITS for c in range(CLASSES)]
        self.seen = [[6] * BITS for _ in range(CLASSES)]

    def take(self, c):
        decoder, y, seen = self.decoder, self.y[c], self.seen[c]
        times = 0
        for k in range(BITS):
            yes = decoder.bit(y[k])
            change = truncated((65536 if yes else 0) - y[k], seen[k] + 2)
            y[k] = min(max(y[k] + change, NEVER), ALWAYS)
            seen[k] = min(seen[k] + 1, 200)
            if not yes:
                break
            times += 1
        if times == BITS:
            n = decoder.raw(5)
            times = BITS + (1 << n) + decoder.raw(n) - 1
        low = low_bits(c)
        magnitude = (times << low) + decoder.raw(low)
        require(magnitude < 1 << 31, "an integer is too large")
        return magnitude


class Context:
    """Surroundings of the present place of an array: section 7.3."""

    def __init__(self, shape):
        self.shape = [n for n in shape if n > 1]
        self.axes = len(self.shape)
        self.neighbours = []
        stride = 1
        for axis in reversed(range(self.axes)):
            last = axis == self.axes - 1
            for back, shift, weight in ALONG_LAST if last else ALONG_OTHERS:
                self.neighbours.append((axis, back, shift, back * stride - shift, weight))
            stride *= self.shape[axis]
        self.index = [0] * self.axes
        slab = 1
        for n in self.shape[1:]:
            slab *= n
        self.means, self.place, self.slabs = [0] * slab, 0, 0
        self.values = []

    def first_weights(self):
        weights = [n[4] for n in self.neighbours] + [HISTORY_WEIGHT]
        sum = total(weights)
        return [w / sum for w in weights]

    def surroundings(self):
        """Lists values and presence of the neighbours, and last those of the history."""
        values, index, shape = self.values, self.index, self.shape
        at = len(values)
        around, present = [], []
        for axis, back, shift, offset, _ in self.neighbours:
            if index[axis] >= back and 0 <= index[-1] + shift < shape[-1]:
                around.append(values[at - offset])
                present.append(1.0)
            else:
                around.append(0)
                present.append(0.0)
        around.append(self.means[self.place] / 16 if self.slabs else 0)
        present.append(1.0 if self.slabs else 0.0)
        return around, present

    def add(self, value):
        """Takes the integer of the present place and goes on to the next."""
        self.values.append(value)
        mean = self.means[self.place]
        self.means[self.place] = mean + truncated(16 * abs(value) - mean, self.slabs + 1)
        self.place += 1
        if self.place == len(self.means):
            self.place, self.slabs = 0, min(self.slabs + 1, 7)
        for axis in reversed(range(self.axes)):
            self.index[axis] += 1
            if self.index[axis] < self.shape[axis]:
                break
            self.index[axis] = 0


class MagnitudeModel:
    """Expected magnitudes, and the classes that follow from them: section 7.4."""

    def __init__(self):
        self.weights, self.learnt, self.expected = {}, 0, 0.0

    def classify(self, context, around, present):
        weights = self.weights.get(context.axes)
        if weights is None:
            weights = self.weights[context.axes] = context.first_weights()
        sum = all = 0.0
        for w, x, p in zip(weights, around, present):
            sum += w * abs(x)
            all += w * p
        self.expected = sum / all if all > 0 else 0.0
        if self.expected <= 0:
            return 1 if all > 0 else 0
        z = 5.0 * self.expected
        z = z * z
        z = z * z
        return min(2 + max(frexp(z)[1] - 1, 0), CLASSES - 1)

    def learn(self, context, around, present, magnitude):
        expected = self.expected
        if expected <= 0:
            return
        weights = self.weights[context.axes]
        unit = 1.0 / (expected + 1.0)
        surprise = min(magnitude * unit, 4.0) - expected * unit
        rate = LEARNING_RATE * surprise
        for i, x in enumerate(around):
            off = min(max((abs(x) - expected) * unit, -2.0), 2.0)
            weights[i] = max(weights[i] + rate * off * present[i], 0.0)
        self.learnt += 1
        if self.learnt % 32 == 0:
            factor = 1.0 / total(weights)
            for i in range(len(weights)):
                weights[i] *= factor


class SignModel:
    """Probabilities of positive signs: section 7.5."""

    def __init__(self):
        self.weights = {}

    def predict(self, context, around, present, magnitude):
        count = len(context.neighbours)
        weights = self.weights.setdefault(context.axes, [0.0] * count)
        sum = number = 0.0
        for x, p in zip(around[:count], present):
            sum += abs(x)
            number += p
        unit = 1.0 / max(sum / max(number, 1.0), 0.3)
        own = min(magnitude * unit, 2.0)
        self.pulls = [own * min(max(x * unit, -2.0), 2.0) for x in around[:count]]
        z = 0.0
        for w, pull in zip(weights, self.pulls):
            z += w * pull
        self.plus = min(max(0.5 + 0.5 * z / sqrt(4.0 + z * z), 0.005), 0.995)
        return min(max(int(self.plus * 65536), NEVER), ALWAYS)

    def learn(self, context, positive):
        weights = self.weights[context.axes]
        step = SIGN_RATE * ((1.0 if positive else 0.0) - self.plus)
        for i, pull in enumerate(self.pulls):
            weights[i] += step * pull


class IntegerReader:
    """All integers of a chunk, array by array."""

    def __init__(self, words, count):
        self.decoder = RangeDecoder(words)
        self.magnitudes = Magnitudes(self.decoder)
        self.sizes, self.signs = MagnitudeModel(), SignModel()
        self.left = count

    def take(self, shape, length):
        """Decodes the next array, vectors of this length; with pivots as section 8.2 has them."""
        count = 1
        for n in shape:
            count *= n
        self.left -= count
        require(self.left >= 0, "there are fewer integers")
        context, pivots = Context(shape), set()
        for first in range(0, count, max(length, 1)):
            for place in range(length):
                context.add(0 if place in pivots else self.one(context))
            pivot = next_pivot(context.values[first:], pivots)
            if pivot is not None:
                pivots.add(pivot)
        return context.values

    def one(self, context):
        around, present = context.surroundings()
        c = self.sizes.classify(context, around, present)
        magnitude = self.magnitudes.take(c)
        self.sizes.learn(context, around, present, magnitude)
        if magnitude == 0:
            return 0
        y = self.signs.predict(context, around, present, magnitude)
        positive = self.decoder.bit(y)
        self.signs.learn(context, positive)
        return magnitude if positive else -magnitude

    def finish(self):
        require(self.left == 0, "integers are left over")
        self.decoder.finish()


def next_pivot(vector, pivots):
    """Finds the pivot of a vector of integers behind those that have these pivots, or None."""
    square = 0
    for x in vector:
        square += x * x
    if square < 400:
        return None
    best = None
    for place, x in enumerate(vector):
        if place not in pivots and (best is None or abs(x) > abs(vector[best])):
            best = place
    return best
