"""Writes the EXR files of this folder with the OpenEXR library (pip install numpy openexr), and prints
what their colours are.

Luminance and chroma: the colours of pixel (x, y) are linear ramps, whose chroma is made before it is
subsampled without a filter, as it is smooth; the reader's filter restores ramps away from the edges.
"""
from pathlib import Path

import numpy as np
import OpenEXR

FOLDER = Path(__file__).parent
WIDTH, HEIGHT = 64, 48
WEIGHTS = np.array([0.21263901, 0.71516868, 0.07219232])  # of Rec.709 in the luminance


def ramps():
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    chroma_r, chroma_b = 0.4 * x / WIDTH - 0.2, 0.5 * y / HEIGHT - 0.3
    light = 0.5 + 0.25 * x / WIDTH + 0.2 * y / HEIGHT
    return light, chroma_r, chroma_b


def channel(values, step, kind):
    """A channel with a sample for every `step` pixels both ways: the library takes an array of the picture's
    size, and from it the first samples."""
    samples = values[::step, ::step].ravel()
    packed = np.zeros(WIDTH * HEIGHT, kind)
    packed[: samples.size] = samples
    return OpenEXR.Channel(packed.reshape(HEIGHT, WIDTH), step, step)


def luminance_chroma(compression, name, kind=np.float16):
    light, r, b = ramps()
    steps = {"Y": (light, 1), "RY": (r, 2), "BY": (b, 2)}
    channels = {key: channel(values, step, kind) for key, (values, step) in steps.items()}
    header = {"type": OpenEXR.scanlineimage, "compression": compression}
    OpenEXR.File(header, channels).write(str(FOLDER / name))


def main():
    for label in "NO RLE ZIPS ZIP PIZ PXR24 B44 B44A DWAA DWAB".split():
        compression = getattr(OpenEXR, label + "_COMPRESSION")
        luminance_chroma(compression, f"yc-{label.lower()}.exr")
    luminance_chroma(OpenEXR.ZIP_COMPRESSION, "yc-float.exr", np.float32)
    light, r, b = ramps()
    red, blue = (1 + r) * light, (1 + b) * light
    green = (light - WEIGHTS[0] * red - WEIGHTS[2] * blue) / WEIGHTS[1]
    for x, y in [(20, 20), (21, 21), (40, 27)]:
        print(x, y, [round(float(c[y, x]), 6) for c in (red, green, blue)])


if __name__ == "__main__":
    main()
