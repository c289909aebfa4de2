"""Lines of leaves and agents differ in colour, also for people with colour blindness, and in dash or shape."""

from __future__ import annotations

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

F64 = NDArray[np.float64]
CSS = files("condvln.explorer").joinpath("page", "page.css").read_text()
# Machado, Oliveira and Fernandes 2009, severity 1, on linear RGB.
SEEN = {
    "all colours": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
APART = 20.0
"""Least CIE 1976 difference of two colours; one is the smallest that people notice side by side."""


def linear(colour: str) -> F64:
    part = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(rgb: F64) -> F64:
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = matrix @ np.clip(rgb, 0.0, 1.0) / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def luminance(colour: str) -> float:
    return float(np.array([0.2126, 0.7152, 0.0722]) @ linear(colour))


def palette(theme: str) -> dict[str, str]:
    block = CSS.split("prefers-color-scheme: dark")[theme == "dark"].split("}")[0]
    found = re.findall(r"--(back|gold|leaf\d|agent\d): (#[0-9a-f]{6})", block)
    return dict(found)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_colours_of_leaves_and_agents_are_told_apart_by_everyone(theme: str) -> None:
    colours = palette(theme)
    back = colours.pop("back")
    assert sorted(colours) == [*(f"agent{k}" for k in range(4)), "gold", *(f"leaf{k}" for k in range(4))]
    for sight, matrix in SEEN.items():
        seen = {name: lab(matrix @ linear(colour)) for name, colour in colours.items()}
        for one, other in combinations(seen, 2):
            assert np.linalg.norm(seen[one] - seen[other]) > APART, (sight, one, other)
    for name, colour in colours.items():
        light, dark = sorted((luminance(colour), luminance(back)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 3.0, name
