"""Predictions of agents in the formats of VLN-CE, RxR and R2R, read one episode at a time.

===========  ================================================================  ==================================
format       shape                                                             end of the path
===========  ================================================================  ==================================
VLN-CE       ``{episode id: [{"position", "heading", "stop"}, …]}``            STOP where ``stop`` is true
RxR          lines of ``{"instruction_id", "path": [[x, y, z], …]}``           the last point is STOP
R2R          ``[{"instr_id", "trajectory": [[viewpoint, …], …]}, …]``          the last viewpoint is STOP
===========  ================================================================  ==================================

VLN-CE's first pose is the start and each later one the state after an action, so a path of n poses took n − 1 actions.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

import numpy as np
import numpy.typing as npt
import orjson

from condvln.formats.json_document import MAX_COORDINATE
from condvln.formats.json_entries import entries, head, json_lines, parsed
from condvln.formats.streams import JsonArrayStream, atomic_stream
from schemas.errors import FormatError

__all__ = [
    "GraphPrediction",
    "Prediction",
    "PredictionFormat",
    "detect_format",
    "read_graph_predictions",
    "read_predictions",
    "write_predictions",
]

PredictionFormat = Literal["vlnce", "rxr", "r2r"]

_HEAD: Final = 1 << 16
_FIRST_VALUE: Final = re.compile(rb'\{\s*"([^"\\]*(?:\\.[^"\\]*)*)"\s*:\s*(.)', re.DOTALL)
"""How an object of predictions begins: its first key, and the first character of that key's value."""
_RXR_KEYS: Final = (b"instruction_id", b"path")

_REMEDY: Final = (
    "Accepted are VLN-CE's {episode id: [{position, heading, stop}, ...]}, RxR's lines of {instruction_id, path}, "
    "R2R's [{instr_id, trajectory}, ...] and results {episode id: {measure: number}}; see docs/metrics.md"
)


@dataclass(frozen=True, eq=False)
class Prediction:
    """An agent's trajectory in one episode.

    Attributes
    ----------
    episode_id : as in the file; RxR's integers as decimal text
    positions : (n, 3) float64, metres, Habitat frame, the start first; n = 0 for an empty path
    stopped : STOP was called at the last position
    counts_actions : every action has a pose, so that a step budget can be applied to the path
    collided : (n,) whether the step to each position collided, if the file says so
    headings : (n,) radians counter-clockwise from −z if known; no metric uses them
    """

    episode_id: str
    positions: npt.NDArray[np.float64]
    stopped: bool
    counts_actions: bool
    collided: npt.NDArray[np.bool_] | None = None
    headings: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class GraphPrediction:
    """An agent's path over viewpoints in one episode."""

    instruction_id: str
    viewpoints: tuple[str, ...]


def detect_format(path: Path) -> PredictionFormat:
    """Detect the format of a predictions file from its beginning.

    Raises
    ------
    FormatError : none of the three formats; the message says what the file holds instead
    """
    text = head(path, _HEAD)
    if text.startswith(b"["):
        return _kind_of_array(path, text[1:].lstrip())
    if not text.startswith(b"{"):
        _refuse(path, "", "the file is neither a JSON object nor a JSON array" if text else "the file is empty")
    first = _FIRST_VALUE.match(text)
    key, value = (first[1], first[2]) if first is not None else (b"", b"")
    if key not in _RXR_KEYS and (value == b"[" or text[1:].lstrip().startswith(b"}")):
        return "vlnce"
    if not any(b'"' + name + b'"' in text for name in _RXR_KEYS):
        _refuse(path, "", "the file is a JSON object, but not one of predictions by episode")
    return "rxr"


def _kind_of_array(path: Path, inside: bytes) -> PredictionFormat:
    if inside.startswith(b"]"):
        _refuse(path, "", "the file is an empty array: it holds no prediction")
    if not inside.startswith(b"{"):
        kind = {b"[": "arrays", b'"': "texts"}.get(inside[:1], "numbers or words")
        _refuse(path, "", f"the file is an array of {kind}, not of predictions")
    return "r2r"


def read_predictions(
    path: str | os.PathLike[str], kind: PredictionFormat | None = None, *, assume_stop: bool = False
) -> Iterator[Prediction]:
    """Yield predictions in continuous space, in file order.

    Parameters
    ----------
    assume_stop : treat the last pose of a VLN-CE path without any ``stop`` as STOP

    Raises
    ------
    FormatError : the file is malformed, a position exceeds `MAX_COORDINATE`, or an id is repeated; the message names
        the episode and step
    """
    path = Path(path)
    kind = kind or detect_format(path)
    if kind == "r2r":
        raise FormatError(
            "the file holds paths over viewpoints, not positions",
            where=path,
            remedy="Evaluate it against a split that has an R2R file (r2r/R2R_<split>.json)",
        )
    seen: set[str] = set()
    for prediction in _vlnce(path, assume_stop) if kind == "vlnce" else _rxr(path):
        _refuse_repeat(path, prediction.episode_id, seen)
        yield prediction


def read_graph_predictions(path: Path) -> Iterator[GraphPrediction]:
    """Yield R2R predictions in file order.

    Raises
    ------
    FormatError : the file is malformed, or an id is repeated
    """
    seen: set[str] = set()
    for number, (_, data) in enumerate(entries(path)):
        place = f"entry {number}"
        entry = parsed(data, path, place, item="step")
        if not isinstance(entry, dict) or not isinstance(entry.get("trajectory"), list):
            _refuse(path, place, "the entry is not an object with instr_id and a list trajectory")
        name = _identity(path, place, entry, "instr_id")
        viewpoints = []
        for step, stop in enumerate(entry["trajectory"]):
            viewpoint = stop[0] if isinstance(stop, list) and stop else stop
            if not isinstance(viewpoint, str):
                _refuse(path, f"instruction {name}, step {step}", "the step has no viewpoint id")
            viewpoints.append(viewpoint)
        _refuse_repeat(path, name, seen)
        yield GraphPrediction(name, tuple(viewpoints))


def write_predictions(path: str | os.PathLike[str], predictions: Iterable[Prediction]) -> int:
    """Write predictions in VLN-CE's format and return their number; only one episode is in memory at a time.

    Raises
    ------
    StoreError : the file can't be written; no partial file is left
    """
    with atomic_stream(Path(path)) as stream:
        stream.write(b"{")
        entries = JsonArrayStream(stream)
        for prediction in predictions:
            last = len(prediction.positions) - 1
            headings = prediction.headings if prediction.headings is not None else np.zeros(last + 1)
            poses: list[dict[str, Any]] = [
                {"position": position, "heading": heading, "stop": prediction.stopped and step == last}
                for step, (position, heading) in enumerate(
                    zip(prediction.positions.tolist(), headings.tolist(), strict=True)
                )
            ]
            if prediction.collided is not None:
                for pose, collided in zip(poses, prediction.collided.tolist(), strict=True):
                    pose["collision"] = collided
            entries.entry(orjson.dumps(prediction.episode_id) + b":" + orjson.dumps(poses))
        stream.write(b"}\n")
    return entries.count


def _vlnce(path: Path, assume_stop: bool) -> Iterator[Prediction]:
    for name, data in entries(path):
        if name is None:
            _refuse(path, "", "the file is an array, not an object of paths by episode id")
        poses = parsed(data, path, f"episode {name}", item="step")
        if not isinstance(poses, list):
            _refuse(path, f"episode {name}", "the value is not a list of poses")
        stops = _stops(path, name, poses)
        end = stops.index(True) + 1 if True in stops else len(poses)
        said = any(stop is not None for stop in stops)
        positions = _positions(path, name, [pose.get("position") for pose in poses[:end]])
        stopped = True in stops or (assume_stop and not said and end > 0)
        yield Prediction(name, positions, stopped, True, _collided(poses[:end]))


def _stops(path: Path, name: str, poses: list[Any]) -> list[bool | None]:
    try:
        stops = [pose.get("stop") for pose in poses]
    except AttributeError:
        wrong = next(step for step, pose in enumerate(poses) if not isinstance(pose, dict))
        _refuse(path, f"episode {name}, step {wrong}", "the pose is not an object with position, heading and stop")
    if not {*map(type, stops)} <= {bool, type(None)}:
        wrong = next(step for step, stop in enumerate(stops) if not isinstance(stop, bool | None))
        _refuse(path, f"episode {name}, step {wrong}", f"stop is {stops[wrong]!r:.40}, neither true nor false")
    return stops


def _collided(poses: list[Any]) -> npt.NDArray[np.bool_] | None:
    said = [pose.get("collision") for pose in poses]
    if not any(isinstance(collision, bool) for collision in said):
        return None
    return np.array([collision is True for collision in said])


def _rxr(path: Path) -> Iterator[Prediction]:
    for number, line in json_lines(path):
        place = f"line {number}"
        entry = parsed(line, path, place, item="step")
        if not isinstance(entry, dict) or not isinstance(entry.get("path"), list):
            _refuse(path, place, "the line is not an object with instruction_id and a list path")
        name = _identity(path, place, entry, "instruction_id")
        positions = _positions(path, name, entry["path"])
        yield Prediction(name, positions, len(positions) > 0, False)


def _positions(path: Path, name: str, points: list[Any]) -> npt.NDArray[np.float64]:
    if not points:
        return np.zeros((0, 3))
    try:
        # numpy would accept quoted digits, true and false as numbers.
        sound = {*map(type, points)} == {list} and {*map(type, chain.from_iterable(points))} <= {float, int}
        positions = np.array(points if sound else (), dtype=np.float64)
    except (ValueError, OverflowError):
        positions = np.zeros(0)
    if positions.shape != (len(points), 3):
        wrong = next((step for step, point in enumerate(points) if not _is_point(point)), len(points) - 1)
        what = f"the position is {_shown(points[wrong])}, not three numbers"
        _refuse(path, f"episode {name}, step {wrong}", what)
    if not (np.abs(positions) <= MAX_COORDINATE).all():
        step = int(np.flatnonzero(~(np.abs(positions) <= MAX_COORDINATE).all(axis=1))[0])
        what = f"the position {_shown(points[step])} is farther than {MAX_COORDINATE:g} m from the origin of its scene"
        _refuse(path, f"episode {name}, step {step}", what)
    return positions


def _is_point(point: Any) -> bool:
    return isinstance(point, list) and len(point) == 3 and all(type(value) in (int, float) for value in point)


def _shown(value: Any) -> str:
    return orjson.dumps(value).decode()[:60]


def _identity(path: Path, place: str, entry: dict[str, Any], key: str) -> str:
    name = entry.get(key)
    if isinstance(name, bool) or not isinstance(name, str | int):
        _refuse(path, place, f"{key} is missing" if name is None else f"{key} is {_shown(name)}, not text or a number")
    return str(name)


def _refuse_repeat(path: Path, name: str, seen: set[str]) -> None:
    if name in seen:
        raise FormatError(
            "the file has two predictions of this episode",
            where=path,
            place=f"episode {name}",
            remedy="Keep one of the two",
        )
    seen.add(name)


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy=_REMEDY)
