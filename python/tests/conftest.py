"""What tests share: paths, the command line to compare with, a small bundle."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geofan as gf
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
MANIFOLDS = ROOT / "assets" / "manifolds"
SCENES = ROOT / "assets" / "scenes"
MESHES = ROOT / "assets" / "meshes"


def _program() -> str | None:
    """Finds the command line: as the environment says, or built beside the package."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    places = (os.environ.get("GEOFAN"), target / "release" / "geofan", shutil.which("geofan"))
    return next((str(place) for place in places if place and Path(place).exists()), None)


@pytest.fixture(scope="session")
def command() -> Callable[..., Any]:
    """Runs `geofan … --json` and returns what it prints."""
    program = _program()
    if program is None:
        pytest.skip("the command line is not built: cargo build --release, or set GEOFAN")

    def run(*arguments: Any) -> Any:
        line = [program, "--json", *map(str, arguments)]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture(scope="session")
def s3() -> gf.Manifold:
    """The unit 3-sphere with one camera."""
    return gf.catalogue.s3()


@pytest.fixture(scope="session")
def wormhole() -> gf.Manifold:
    return gf.catalogue.ellis_wormhole()


@pytest.fixture(scope="session")
def bump() -> gf.Manifold:
    """A rotationally symmetric bump with an exit, which bakes in about a second."""
    return gf.Manifold.embedding(
        ["x", "y", "z", "exp(-(x^2 + y^2 + z^2)/2)"],
        exits={"sky": "x^2 + y^2 + z^2 - 25"},
        symmetry={"rotation": "origin"},
        cameras={"parameters": {"c": (0.0, 4.0)}, "at": ["c", 0, 0]},
        length=10.0,
        name="Bump",
    )


@pytest.fixture(scope="session")
def table(bump: gf.Manifold, tmp_path_factory: pytest.TempPathFactory) -> gf.Bundle:
    return bump.bake(1.0, out=tmp_path_factory.mktemp("bundles") / "bump.fan", certify_rays=2000)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(1)
