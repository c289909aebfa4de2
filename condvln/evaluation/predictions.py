"""What agents hand in: the formats of VLN-CE, RxR and R2R, read one episode at a time.

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

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

import numpy as np
import numpy.typing as npt
import orjson

from condvln.evaluation.json_entries import entries, first_character, json_lines, opened, parsed
from condvln.export.streams import JsonArrayStream, atomic_stream
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

_REMEDY: Final = "See docs/metrics.md for the formats"


@dataclass(frozen=True, eq=False)
class Prediction:
    """What an agent did in one episode.

    Attributes
    ----------
    episode_id : as the file names it; RxR's numbers as their digits
    positions : (n, 3) float64, metres, Habitat frame, the start first; n = 0 for an empty path
    stopped : STOP was called at the last position
    counts_actions : every action has its pose, so that a step budget can be held against the path
    collided : (n,) whether the step to each position met an obstacle, where that is told
    headings : (n,) radians counter-clockwise from −z where they are known; no metric asks for them
    """

    episode_id: str
    positions: npt.NDArray[np.float64]
    stopped: bool
    counts_actions: bool
    collided: npt.NDArray[np.bool_] | None = None
    headings: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class GraphPrediction:
    """What an agent did in one episode on a graph: viewpoints in order."""

    instruction_id: str
    viewpoints: tuple[str, ...]


def detect_format(path: Path) -> PredictionFormat:
    """Format of a file, from its beginning.

    Raises
    ------
    FormatError : none of the three
    """
    start = first_character(path)
    if start == "[":
        return "r2r"
    if start == "{":
        with opened(path) as file:
            head = file.read(1 << 12)
        brace = head.index(b"{")
        return "rxr" if head[brace + 1 :].lstrip().startswith((b'"instruction_id"', b'"path"')) else "vlnce"
    raise FormatError("neither a JSON object nor an array", where=path, place="the start", remedy=_REMEDY)


def read_predictions(
    path: Path, kind: PredictionFormat | None = None, *, assume_stop: bool = False
) -> Iterator[Prediction]:
    """Predictions in continuous space, in the order of the file.

    Parameters
    ----------
    assume_stop : take the last pose of a VLN-CE path without any ``stop`` as STOP

    Raises
    ------
    FormatError : malformed, or one id twice; the message names the episode and the step
    """
    kind = kind or detect_format(path)
    if kind == "r2r":
        _refuse(path, "the file", "holds viewpoints of a graph, not positions: evaluate it against an R2R file")
    seen: set[str] = set()
    for prediction in _vlnce(path, assume_stop) if kind == "vlnce" else _rxr(path):
        _refuse_repeat(path, prediction.episode_id, seen)
        yield prediction


def read_graph_predictions(path: Path) -> Iterator[GraphPrediction]:
    """R2R predictions, in the order of the file.

    Raises
    ------
    FormatError : malformed, or one id twice
    """
    seen: set[str] = set()
    for number, (_, data) in enumerate(entries(path)):
        entry = parsed(data, path, f"entry {number}")
        if not isinstance(entry, dict) or not isinstance(entry.get("trajectory"), list):
            _refuse(path, f"entry {number}", "is not {instr_id, trajectory}")
        name = _identity(path, f"entry {number}", entry.get("instr_id"))
        viewpoints = []
        for step, stop in enumerate(entry["trajectory"]):
            viewpoint = stop[0] if isinstance(stop, list) and stop else stop
            if not isinstance(viewpoint, str):
                _refuse(path, f"{name}, step {step}", "has no viewpoint id")
            viewpoints.append(viewpoint)
        _refuse_repeat(path, name, seen)
        yield GraphPrediction(name, tuple(viewpoints))


def write_predictions(path: Path, predictions: Iterable[Prediction]) -> int:
    """Write VLN-CE's format, one episode in memory at a time; returns how many.

    Raises
    ------
    StoreError : the disk refused; nothing half-written is left
    """
    with atomic_stream(path) as stream:
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
            _refuse(path, "the file", "is an array, not an object of episodes")
        poses = parsed(data, path, f"episode {name}")
        if not isinstance(poses, list):
            _refuse(path, f"episode {name}", "is not a list of poses")
        stops = _stops(path, name, poses)
        end = stops.index(True) + 1 if True in stops else len(poses)
        told = any(stop is not None for stop in stops)
        positions = _positions(path, name, [pose.get("position") for pose in poses[:end]])
        stopped = True in stops or (assume_stop and not told and end > 0)
        yield Prediction(name, positions, stopped, True, _collided(poses[:end]))


def _stops(path: Path, name: str, poses: list[Any]) -> list[bool | None]:
    try:
        stops = [pose.get("stop") for pose in poses]
    except AttributeError:
        wrong = next(step for step, pose in enumerate(poses) if not isinstance(pose, dict))
        _refuse(path, f"episode {name}, step {wrong}", "is not {position, heading, stop}")
    if not {*map(type, stops)} <= {bool, type(None)}:
        wrong = next(step for step, stop in enumerate(stops) if not isinstance(stop, bool | None))
        _refuse(path, f"episode {name}, step {wrong}", "has a stop that is neither true nor false")
    return stops


def _collided(poses: list[Any]) -> npt.NDArray[np.bool_] | None:
    told = [pose.get("collision") for pose in poses]
    if not any(isinstance(collision, bool) for collision in told):
        return None
    return np.array([collision is True for collision in told])


def _rxr(path: Path) -> Iterator[Prediction]:
    for number, line in json_lines(path):
        entry = parsed(line, path, f"line {number}")
        if not isinstance(entry, dict) or not isinstance(entry.get("path"), list):
            _refuse(path, f"line {number}", "is not {instruction_id, path}")
        name = _identity(path, f"line {number}", entry.get("instruction_id"))
        positions = _positions(path, name, entry["path"])
        yield Prediction(name, positions, len(positions) > 0, False)


def _positions(path: Path, name: str, points: list[Any]) -> npt.NDArray[np.float64]:
    if not points:
        return np.zeros((0, 3))
    try:
        # Strings of digits would turn into numbers without a word.
        positions = np.array(points, dtype=None)
        sound = positions.dtype.kind in "fi" and positions.shape == (len(points), 3)
    except ValueError:
        sound = False
    if not sound:
        _refuse(path, f"episode {name}, step {_first_unsound(points)}", "has a position that is not three numbers")
    positions = positions.astype(np.float64)
    if not np.isfinite(positions).all():
        step = int(np.flatnonzero(~np.isfinite(positions).all(axis=1))[0])
        _refuse(path, f"episode {name}, step {step}", "has a position that is not finite")
    return positions


def _first_unsound(points: list[Any]) -> int:
    def sound(point: Any) -> bool:
        return isinstance(point, list) and len(point) == 3 and all(type(value) in (int, float) for value in point)

    return next((step for step, point in enumerate(points) if not sound(point)), len(points) - 1)


def _identity(path: Path, place: str, name: Any) -> str:
    if isinstance(name, bool) or not isinstance(name, str | int):
        _refuse(path, place, "has no id")
    return str(name)


def _refuse_repeat(path: Path, name: str, seen: set[str]) -> None:
    if name in seen:
        _refuse(path, f"episode {name}", "stands twice")
    seen.add(name)


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy=_REMEDY)
