"""Read Matterport3D's connectivity graphs, ``<scan>_connectivity.json``, with strict checks.

The rules are Matterport3DSimulator's (``NavGraph.cpp``, MIT) and those of R2R's ``load_nav_graphs``: a viewpoint counts
if it is ``included``; an edge joins two such viewpoints that are ``unobstructed`` both ways.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from condvln.formats.regular_file import read_regular
from condvln.navigation.tile import Floats
from schemas.errors import FormatError, MissingFileError

__all__ = ["ViewpointGraph", "read_connectivity"]

# The largest scan has about 350 viewpoints; a file lists visibility for every pair.
MAX_VIEWPOINTS = 2000
MAX_FILE_BYTES = 64 * 1024 * 1024

REMEDY = "Take the file from the Matterport3DSimulator repository again"


@dataclass(frozen=True, eq=False)
class ViewpointGraph:
    """A graph of n viewpoints and m edges.

    Attributes
    ----------
    ids : names of the viewpoints, in file order
    positions : (n, 3) float32 on the floor below the camera, metres, Habitat frame
    edges : (m, 2) int32 pairs, each once, the lower index first
    lengths : (m,) float64 metres between the two cameras, R2R's edge weight
    """

    ids: tuple[str, ...]
    positions: Floats
    edges: npt.NDArray[np.int32]
    lengths: npt.NDArray[np.float64]


def read_connectivity(path: str | os.PathLike[str]) -> ViewpointGraph:
    """Read a connectivity file.

    Camera positions are z-up in metres: (x, y, z) becomes (x, z, −y). The floor lies ``height`` metres below the
    camera.

    Raises
    ------
    MissingFileError : the file does not exist
    FormatError : it does not hold a valid connectivity graph
    """
    file = Path(path)
    items = _load(file)
    count = len(items)
    names, poses, heights, included = [], [], [], []
    blocked = np.zeros((count, count), bool)
    for number, item in enumerate(items):
        place = f"[{number}]"
        if not isinstance(item, dict):
            raise _error(file, place, "not an object")
        names.append(_text(file, place, item.get("image_id")))
        poses.append(_numbers(file, f"{place}.pose", item.get("pose"), 16))
        heights.append(_numbers(file, f"{place}.height", [item.get("height")], 1)[0])
        included.append(_flags(file, f"{place}.included", [item.get("included")], 1)[0])
        blocked[number] = ~_flags(file, f"{place}.unobstructed", item.get("unobstructed"), count)
    if len(set(names)) != count:
        twice = next(name for name in names if names.count(name) > 1)
        raise _error(file, f"[{names.index(twice)}].image_id", f"viewpoint {twice!r} occurs twice")
    kept = np.flatnonzero(included)
    if not len(kept):
        raise _error(file, "", "no viewpoint is included")
    joined = ~blocked[np.ix_(kept, kept)]
    if np.diagonal(joined).any():
        number = int(kept[np.argmax(np.diagonal(joined))])
        raise _error(file, f"[{number}].unobstructed", "a viewpoint is connected to itself")
    if (joined != joined.T).any():
        a, b = np.argwhere(joined & ~joined.T)[0]
        raise _error(file, f"[{kept[a]}].unobstructed[{kept[b]}]", "an edge exists in one direction only")
    matrix = np.array(poses)[kept].reshape(-1, 4, 4)
    cameras = np.stack([matrix[:, 0, 3], matrix[:, 2, 3], -matrix[:, 1, 3]], axis=1)
    floors = cameras - np.array([0.0, 1.0, 0.0]) * np.array(heights)[kept][:, None]
    edges = np.argwhere(np.triu(joined)).astype(np.int32)
    lengths = np.linalg.norm(cameras[edges[:, 0]] - cameras[edges[:, 1]], axis=1)
    return ViewpointGraph(tuple(names[i] for i in kept), floors.astype(np.float32), edges, lengths)


def _load(file: Path) -> list[Any]:
    try:
        if file.stat().st_size > MAX_FILE_BYTES:
            raise _error(file, "", f"the file has {file.stat().st_size} bytes (at most {MAX_FILE_BYTES} are read)")
        items = orjson.loads(read_regular(file))
    except FileNotFoundError as error:
        raise MissingFileError("the connectivity file does not exist", where=file, remedy="Check the path") from error
    except OSError as error:
        raise _error(file, "", f"can't be read: {error.strerror or error}") from error
    except orjson.JSONDecodeError as error:
        raise _error(file, f"line {error.lineno}", f"not JSON: {error.msg}") from error
    if not isinstance(items, list) or not 1 <= len(items) <= MAX_VIEWPOINTS:
        raise _error(file, "", f"not a list of 1 to {MAX_VIEWPOINTS} viewpoints")
    return items


def _text(file: Path, place: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise _error(file, f"{place}.image_id", "not a name")
    return value


def _numbers(file: Path, place: str, values: Any, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise _error(file, place, f"not a list of {count} numbers")
    for value in values:
        # bool is a subclass of int in Python; coordinates beyond 1000 km can't belong to a building
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
            or abs(value) > 1e6
        ):
            raise _error(file, place, f"{value!r} is not a length in metres")
    return [float(value) for value in values]


def _flags(file: Path, place: str, values: Any, count: int) -> npt.NDArray[np.bool_]:
    if not isinstance(values, list) or len(values) != count or not all(isinstance(value, bool) for value in values):
        raise _error(file, place, f"not a list of {count} booleans")
    return np.array(values, bool)


def _error(file: Path, place: str, what: str) -> FormatError:
    return FormatError(what, where=file, place=place, remedy=REMEDY)
