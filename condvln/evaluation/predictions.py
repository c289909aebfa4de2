"""Predictions of agents in the formats of VLN-CE, RxR and R2R, read one episode at a time.

===========  ================================================================  ==================================
format       shape                                                             end of the path
===========  ================================================================  ==================================
VLN-CE       ``{episode id: [{"position", "heading", "stop"}, …]}``            STOP where ``stop`` is true
RxR          lines of ``{"instruction_id", "path": [[x, y, z], …]}``           the last point is STOP
R2R          ``[{"instr_id", "trajectory": [[viewpoint, …], …]}, …]``          the last viewpoint is STOP
===========  ================================================================  ==================================

VLN-CE's first pose is the start and each later one the state after an action, so a path of n poses took n − 1 actions.
RxR's and R2R's entries may be lines or an array, may name the episode as ``episode_id``, and hold VLN-CE's poses too. A
step of R2R is one viewpoint, with or without heading and elevation, or a list of the viewpoints that the step led
through, as agents with a global map write it (VLN-DUET's ``agent.py`` and those made from it).
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

import numpy as np
import numpy.typing as npt
import orjson

from condvln.evaluation.reading import (
    ReadRules,
    episode_name,
    named_entries,
    records,
    without_duplicates,
    without_summaries,
)
from condvln.formats.json_document import MAX_COORDINATE
from condvln.formats.json_entries import head, parsed
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
_IDS: Final = {"rxr": ("instruction_id", "episode_id", "instr_id"), "r2r": ("instr_id", "instruction_id", "episode_id")}
_PATHS: Final = {"rxr": ("path", "trajectory"), "r2r": ("trajectory", "path")}
"""Keys of an entry's id and path, in the order in which they are looked for."""
_KEYS: Final = tuple(name.encode() for name in (*_IDS["rxr"], *_PATHS["rxr"]))
_FIRST_PLACE: Final = re.compile(rb'"(?:path|trajectory)"\s*:\s*\[[\s\[]*([^\s\[\]])')
"""The first character of the first place on a path: a quotation mark if places are viewpoints."""

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
    headings : (n,) radians counter-clockwise from −z if all are known
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
        inside = text[1:].lstrip()
        if inside.startswith(b"]"):
            _refuse(path, "", "the file is an empty array: it holds no prediction")
        if not inside.startswith(b"{"):
            kind = {b"[": "arrays", b'"': "texts"}.get(inside[:1], "numbers or words")
            _refuse(path, "", f"the file is an array of {kind}, not of predictions")
        return _kind_of_records(text)
    if text.startswith((b"\xff\xfe", b"\xfe\xff")):
        _refuse(path, "", "the text is UTF-16, not UTF-8")
    if not text.startswith(b"{"):
        _refuse(path, "", "the file is neither a JSON object nor a JSON array" if text else "the file is empty")
    first = _FIRST_VALUE.match(text)
    key, value = (first[1], first[2]) if first is not None else (b"", b"")
    if key not in _KEYS and (value == b"[" or text[1:].lstrip().startswith(b"}")):
        return "vlnce"
    if not any(b'"' + name + b'"' in text for name in _KEYS):
        _refuse(path, "", "the file is a JSON object, but not one of predictions by episode")
    return _kind_of_records(text)


def _kind_of_records(text: bytes) -> PredictionFormat:
    place = _FIRST_PLACE.search(text)
    if place is not None:
        return "r2r" if place[1] == b'"' else "rxr"
    return "rxr" if b'"instruction_id"' in text or b'"episode_id"' in text else "r2r"


def read_predictions(
    path: str | os.PathLike[str],
    kind: PredictionFormat | None = None,
    rules: ReadRules | None = None,
    notes: list[str] | None = None,
) -> Iterator[Prediction]:
    """Yield predictions in continuous space, in file order.

    Parameters
    ----------
    notes : receives a sentence for each kind of thing that was left out

    Raises
    ------
    FormatError : the file is malformed, a position exceeds `MAX_COORDINATE`, or an id is repeated; the message names
        the episode and step
    """
    path, rules, notes = Path(path), rules or ReadRules(), [] if notes is None else notes
    kind = kind or detect_format(path)
    if kind == "r2r":
        raise FormatError(
            "the file holds paths over viewpoints, not positions",
            where=path,
            remedy="Evaluate it against a split that has an R2R file (r2r/R2R_<split>.json)",
        )
    said: Counter[str] = Counter()
    read = (_vlnce if kind == "vlnce" else _rxr)(path, rules, notes, said)
    yield from without_duplicates(read, lambda one: one.episode_id, path, rules, notes, "predictions")
    if said["without stop"] and not rules.assume_stop:
        notes.append(
            f"{said['without stop']} of {said['paths']} paths do not say whether the agent stopped, and count as if it "
            "did not; --assume-stop takes their last pose as STOP"
        )


def read_graph_predictions(
    path: Path, rules: ReadRules | None = None, notes: list[str] | None = None
) -> Iterator[GraphPrediction]:
    """Yield R2R predictions in file order, with the viewpoints of all steps one after another; arguments as for
    `read_predictions`.

    Raises
    ------
    FormatError : the file is malformed, or an id is repeated
    """
    rules, notes = rules or ReadRules(), [] if notes is None else notes
    read = _r2r(path, rules, notes)
    yield from without_duplicates(read, lambda one: one.instruction_id, path, rules, notes, "predictions")


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
            poses: list[dict[str, Any]] = [
                {"position": position, "stop": prediction.stopped and step == last}
                for step, position in enumerate(prediction.positions.tolist())
            ]
            if prediction.headings is not None:
                for pose, heading in zip(poses, prediction.headings.tolist(), strict=True):
                    pose["heading"] = heading
            if prediction.collided is not None:
                for pose, collided in zip(poses, prediction.collided.tolist(), strict=True):
                    pose["collision"] = collided
            entries.entry(orjson.dumps(prediction.episode_id) + b":" + orjson.dumps(poses))
        stream.write(b"}\n")
    return entries.count


def _vlnce(path: Path, rules: ReadRules, notes: list[str], said: Counter[str]) -> Iterator[Prediction]:
    for key, data in named_entries(path, rules, notes):
        name = episode_name(key)
        if name is None:
            _refuse(path, "", "the file is an array, not an object of paths by episode id")
        poses = parsed(data, path, f"episode {name}", nonfinite=True)
        if not isinstance(poses, list):
            _refuse(path, f"episode {name}", "the value is not a list of poses")
        if poses and isinstance(poses[0], dict) and any(one in poses[0] for one in _IDS["rxr"]):
            what = f"the key {name!r} holds a list of predictions, not the poses of one episode: write that list alone"
            _refuse(path, f"episode {name}", what)
        yield _of_poses(path, name, poses, rules, said)


def _of_poses(path: Path, name: str, poses: list[Any], rules: ReadRules, said: Counter[str]) -> Prediction:
    stops = _stops(path, name, poses)
    said["paths"] += 1
    said["without stop"] += bool(poses) and all(pose.get("stop") is None for pose in poses)
    end = stops.index(True) + 1 if True in stops else len(poses)
    positions = _positions(path, name, [pose.get("position") for pose in poses[:end]])
    stopped = True in stops or (rules.assume_stop and end > 0)
    return Prediction(name, positions, stopped, True, _collided(poses[:end]), _headings(poses[:end]))


def _stops(path: Path, name: str, poses: list[Any]) -> list[bool]:
    wrong = next((step for step, pose in enumerate(poses) if not isinstance(pose, dict)), None)
    if wrong is not None:
        _refuse(path, f"episode {name}, step {wrong}", "the pose is not an object with position, heading and stop")
    stops = [pose.get("stop") for pose in poses]
    # True and False equal 1 and 0, which some agents write.
    wrong = next((step for step, stop in enumerate(stops) if stop is not None and stop not in (False, True)), None)
    if wrong is not None:
        _refuse(path, f"episode {name}, step {wrong}", f"stop is {stops[wrong]!r:.40}, neither true nor false")
    return [stop == 1 for stop in stops]


def _headings(poses: list[Any]) -> npt.NDArray[np.float64] | None:
    found = [pose.get("heading") for pose in poses]
    if not all(type(heading) in (int, float) and abs(heading) <= sys.float_info.max for heading in found):
        return None
    return np.array(found, dtype=np.float64)


def _collided(poses: list[Any]) -> npt.NDArray[np.bool_] | None:
    said = [pose.get("collision") for pose in poses]
    if all(collision not in (False, True) for collision in said):
        return None
    return np.array([collision == 1 for collision in said])


def _rxr(path: Path, rules: ReadRules, notes: list[str], said: Counter[str]) -> Iterator[Prediction]:
    for name, points in _named_paths(path, "rxr", rules, notes):
        if points and isinstance(points[0], dict):
            yield _of_poses(path, name, points, rules, said)
        else:
            positions = _positions(path, name, points)
            yield Prediction(name, positions, len(positions) > 0, False)


def _r2r(path: Path, rules: ReadRules, notes: list[str]) -> Iterator[GraphPrediction]:
    for name, steps in _named_paths(path, "r2r", rules, notes):
        viewpoints: list[str] = []
        for number, step in enumerate(steps):
            passed = list(_viewpoints(step))
            if not passed and step != []:
                _refuse(path, f"instruction {name}, step {number}", "the step has no viewpoint id")
            # A step may begin where the one before ended.
            several = len(passed) > 1 and viewpoints and passed[0] == viewpoints[-1]
            viewpoints += passed[1:] if several else passed
        yield GraphPrediction(name, tuple(viewpoints))


def _viewpoints(step: Any) -> Iterator[str]:
    """Yield all viewpoints of one step of a trajectory; headings and elevations are numbers."""
    if isinstance(step, str):
        yield step
    elif isinstance(step, list):
        for part in step:
            yield from _viewpoints(part)


def _named_paths(
    path: Path, kind: Literal["rxr", "r2r"], rules: ReadRules, notes: list[str]
) -> Iterator[tuple[str, list[Any]]]:
    """Yield the id and the path of each entry, except for summaries, which have neither."""
    for place, entry in without_summaries(records(path, rules, notes), (*_IDS[kind], *_PATHS[kind]), notes):
        yield _named_path(path, place, entry, kind)


def _named_path(path: Path, place: str, entry: object, kind: Literal["rxr", "r2r"]) -> tuple[str, list[Any]]:
    """Return the id and the path of one entry."""
    fields = entry if isinstance(entry, dict) else {}
    key = next((key for key in _IDS[kind] if fields.get(key) is not None), _IDS[kind][0])
    found = next((fields[one] for one in _PATHS[kind] if one in fields), None)
    if not isinstance(found, list):
        what = f"the {place.split()[0]} is not an object with {_IDS[kind][0]} and a list {_PATHS[kind][0]}"
        _refuse(path, place, what)
    name = episode_name(fields.get(key))
    if name is None:
        value = fields.get(key)
        _refuse(
            path, place, f"{key} is missing" if value is None else f"{key} is {_shown(value)}, not text or a number"
        )
    return name, found


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
    inside = np.abs(positions) <= MAX_COORDINATE  # false for NaN
    if not inside.all():
        step, axis = np.argwhere(~inside)[0].tolist()
        value = positions[step, axis]
        what = f"the position {_shown(points[step])} is farther than {MAX_COORDINATE:g} m from the origin of its scene"
        if not np.isfinite(value):
            what = f"the number {value} in the position is not finite"
        _refuse(path, f"episode {name}, step {step}", what)
    return positions


def _is_point(point: Any) -> bool:
    return isinstance(point, list) and len(point) == 3 and all(type(value) in (int, float) for value in point)


def _shown(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))[:60]


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy=_REMEDY)
