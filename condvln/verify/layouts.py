"""Prove that the layouts of a folder of trajectories agree with its hub (the tables, poses and images that all layouts
share), and read what their samples say.

Nothing in a layout is its own: it is written once more from the hub, which has a proof of its own, and both must be the
same. What the samples tell the agents to do is read by this module's own code, as the agents' public code reads it
(``docs/training.md`` names it), and replayed by :mod:`condvln.verify.trajectories`.
"""

from __future__ import annotations

import math
import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeAlias

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.formats.parquet_rows import refuse_parquet_bombs
from condvln.formats.regular_file import open_regular, read_regular
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, ActionSpace
from condvln.verify.trajectory_files import read_annotations
from schemas.base import Row
from schemas.errors import StoreError, UsageError
from schemas.tables import TRAJECTORY_TABLES

__all__ = ["DAMAGED", "HUBS", "MEANINGS", "LayoutProof", "Row", "WriteLayout", "meaning_of", "prove_layouts"]

SceneTables: TypeAlias = tuple[str, str, Mapping[str, pa.Table]]
"""A scene's source, its id, and its tables of walks and poses."""
WriteLayout: TypeAlias = Callable[[str, Path, Row, Iterable[SceneTables]], None]
"""Writes a layout, given by its name, below a folder that has the images. The row is the content of
``trajectories.json``.
"""
Sample: TypeAlias = tuple[str, int, Any]
"""A walk, the frame where the agent is asked, and the answer as the layout has it."""

HUBS: Final = ("streamvln", "snav")
"""Layouts whose file is ``annotations.json`` of the folder itself."""

_TURNS_OF_15: Final = ActionSpace(0.25, 15.0)
_TURNS_OF_30: Final = ActionSpace(0.25, 30.0)
MEANINGS: Final[Mapping[str, ActionSpace]] = {
    "streamvln": _TURNS_OF_15,  # its prompt: by 15 degrees, by 25 centimeters
    "snav": _TURNS_OF_30,  # NavSpace's render_streamvln.py: --turn_angle 30
    "navila": _TURNS_OF_15,  # its trainer acts once for each 25 cm and 15 degrees of an answer
    "uninavid": _TURNS_OF_30,  # NaVid's task files: FORWARD_STEP_SIZE 0.25, TURN_ANGLE 30
    "janusvln": _TURNS_OF_15,  # its config/vln_r2r.yaml
    "internvla-n1": _TURNS_OF_15,  # InternNav's vln_r2r.yaml
}
"""What an action means to the agent that reads a layout, written a second time."""

DAMAGED: Final = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    struct.error,
    pa.ArrowException,
    UsageError,
    StoreError,
)
"""What a damaged file of a layout raises."""


@dataclass
class LayoutProof:
    """What the proof of layouts finds.

    rows : number of samples read, by layout
    words : what the samples say, by layout and walk: the actions of the whole walk. A walk without samples is left out;
        one whose samples can't be read has a fault instead.
    faults : each as (walk, what is wrong); the walk is empty if the layout as a whole is meant
    """

    rows: Counter[str] = field(default_factory=Counter)
    words: dict[str, dict[str, list[int]]] = field(default_factory=dict)
    faults: list[tuple[str, str]] = field(default_factory=list)


def prove_layouts(
    folder: Path, record: Row, walks: Sequence[Row], write: WriteLayout, *, sound: bool = True
) -> LayoutProof:
    """Read the samples of the layouts that `record` names, and compare the layouts with the hub.

    record : content of ``trajectories.json``
    walks : rows of ``trajectories.parquet``, in their order
    write : writes a layout once more
    sound : the hub itself is proven; otherwise there is nothing to compare with
    """
    from PIL import Image

    proof = LayoutProof()
    named = {*record["layouts"]}
    for name in sorted(named - _ANSWERS.keys()):
        proof.faults.append(("", f"{name}: the record names a layout that is not known here"))
    for name in sorted(_ANSWERS.keys() - named):
        if (folder / name).exists():
            proof.faults.append(("", f"{name}: the folder is there, but the record does not name this layout"))
    for name in sorted(named & _ANSWERS.keys()):
        try:
            _read_words(name, folder, walks, proof)
            if name not in HUBS and sound:
                proof.faults += [("", f"{name}: {what}") for what in _differences(name, folder, record, walks, write)]
        except (*DAMAGED, Image.DecompressionBombError) as error:
            proof.faults.append(("", f"{name}: a file is missing or damaged ({error})"))
    unknown = sorted((named & _ANSWERS.keys()) - {*HUBS})
    if unknown and not sound:
        proof.faults.append(("", f"{', '.join(unknown)}: not compared with the hub, since the hub has faults itself"))
    return proof


def meaning_of(folder: Path, layout: str) -> ActionSpace:
    """Return the sizes of a layout's actions; those of ``lerobot`` are in its own description.

    Raises
    ------
    OSError, ValueError, KeyError, TypeError, UsageError : the description lacks them, or they are no sizes
    """
    if layout != "lerobot":
        return MEANINGS[layout]
    sizes = orjson.loads(read_regular(folder / "lerobot/meta/info.json"))["features"]["action"]["info"]
    return ActionSpace(forward=float(sizes["forward_metres"]), turn=float(sizes["turn_degrees"]))


# -- what the samples say ----------------------------------------------------------------------------------------------


def _read_words(name: str, folder: Path, walks: Sequence[Row], proof: LayoutProof) -> None:
    """Add to `proof` the actions that the samples of each walk say. A sample that can't be read is a fault of its walk
    alone.
    """
    said: dict[str, dict[int, list[int]]] = {}
    damaged: set[str] = set()
    samples, meant = _ANSWERS[name]
    for walk, frame, answer in samples(folder):
        proof.rows[name] += 1
        try:
            said.setdefault(walk, {})[frame] = meant(answer)
        except (ValueError, KeyError, TypeError, AttributeError):
            if walk not in damaged:
                proof.faults.append((walk, f"{name}: an answer is {answer!r}"))
            damaged.add(walk)
    words = proof.words[name] = {}
    for row in walks:
        walk = row["trajectory"]
        whole = len(row["executed"]) == len(row["repeats"]) == row["n_frames"]
        if whole and walk in said and walk not in damaged:  # other numbers are a fault of the walk already
            words[walk] = _joined(row, said[walk])


def _joined(walk: Row, said: Mapping[int, Sequence[int]]) -> list[int]:
    """Return the actions of a whole walk: what the sample of each frame says that follows on the one before. Where none
    speaks, as in mistakes, the executed action is taken.
    """
    actions: list[int] = []
    while len(actions) < walk["n_frames"] and STOP not in actions[-1:]:
        frame = len(actions)
        own = said.get(frame, ()) if walk["repeats"][frame] > 0 else ()
        actions += own or walk["executed"][frame : frame + 1]
    return actions[: actions.index(STOP) + 1] if STOP in actions else actions


def _of_the_hub(folder: Path) -> Iterator[Sample]:
    for entry in read_annotations(folder):
        for frame, action in enumerate([*entry["actions"][1:], STOP]):
            yield str(entry.get("trajectory")), frame, action


def _of_navila(folder: Path) -> Iterator[Sample]:
    with open_regular(folder / "navila" / "annotations.json") as lines:
        for row in map(orjson.loads, lines):
            walk, _, frame = row["video_id"].rpartition("_")
            yield walk, int(frame), row["a"]


def _of_janusvln(folder: Path) -> Iterator[Sample]:
    for entry in orjson.loads(read_regular(folder / "janusvln" / "train.json")):
        _, walk, frame = entry["id"].split("/")
        yield walk, int(frame), entry["conversations"][1]["value"]


def _of_uninavid(folder: Path) -> Iterator[Sample]:
    for entry in orjson.loads(read_regular(folder / "uninavid" / "annotations.json")):
        walk, _, frame = entry["id"].removeprefix("NAV_ID_").rpartition("_")
        yield walk, int(frame), entry["conversations"][1]["value"]


def _of_internvla(folder: Path) -> Iterator[Sample]:
    for scene in sorted((folder / "internvla-n1").iterdir()):
        for row in map(orjson.loads, read_regular(scene / "meta/episodes.jsonl").splitlines()):
            number = row["episode_index"]
            table = _table(scene / f"data/chunk-{number // 1000:03d}/episode_{number:06d}.parquet")
            for frame, action in enumerate([*table["action"].to_pylist()[1:], STOP]):
                yield row["trajectory"], frame, action


def _of_lerobot(folder: Path) -> Iterator[Sample]:
    episodes = _table(folder / "lerobot/meta/episodes/chunk-000/file-000.parquet", ["episode_index", "trajectory"])
    names = dict(zip(*episodes.to_pydict().values(), strict=True))
    for path in sorted((folder / "lerobot/data").glob("chunk-*/file-*.parquet")):
        for row in _table(path, ["episode_index", "frame_index", "action"]).to_pylist():
            yield names[row["episode_index"]], row["frame_index"], row["action"]


def _number(answer: Any) -> list[int]:
    if type(answer) is not int or answer not in (STOP, FORWARD, LEFT, RIGHT):
        raise ValueError
    return [answer]


_NAVILA: Final = re.compile(
    r"The next action is (?:(stop)|move forward (\d{1,3}) cm|turn (left|right) (\d{1,3}) degrees)\."
)
_JANUS: Final = {"STOP": STOP, "MOVE_FORWARD": FORWARD, "TURN_LEFT": LEFT, "TURN_RIGHT": RIGHT}
_UNINAVID: Final = {"stop": STOP, "forward": FORWARD, "left": LEFT, "right": RIGHT}


def _said_by_navila(answer: str) -> list[int]:
    """Return the actions of an answer, as NaVILA's evaluator takes them: one for each 25 cm or 15 degrees.

    Raises
    ------
    ValueError : it would not understand the answer, or round it
    """
    found = _NAVILA.fullmatch(answer)
    if found is None:
        raise ValueError
    stop, centimetres, side, degrees = found.groups()
    if stop:
        return [STOP]
    amount, unit = (int(centimetres), 25) if centimetres else (int(degrees), 15)
    if not 0 < amount <= 3 * unit or amount % unit:
        raise ValueError
    return [FORWARD if centimetres else LEFT if side == "left" else RIGHT] * (amount // unit)


_ANSWERS: Final[Mapping[str, tuple[Callable[[Path], Iterator[Sample]], Callable[[Any], list[int]]]]] = {
    **dict.fromkeys(HUBS, (_of_the_hub, _number)),
    "navila": (_of_navila, _said_by_navila),
    "uninavid": (_of_uninavid, lambda answer: [_UNINAVID[word] for word in answer.split(" ")]),
    "janusvln": (_of_janusvln, lambda answer: [_JANUS[answer]]),
    "internvla-n1": (_of_internvla, _number),
    "lerobot": (_of_lerobot, _number),
}
"""By layout: what yields its samples, and the actions that an answer means."""


# -- whether a layout agrees with the hub ------------------------------------------------------------------------------


def _differences(name: str, folder: Path, record: Row, walks: Sequence[Row], write: WriteLayout) -> Iterator[str]:
    """Yield what differs between a layout and what is written once more from the hub; a layout that agrees yields
    nothing.
    """
    within = folder if os.access(folder, os.W_OK) else None  # there, images are linked and not copied
    with TemporaryDirectory(prefix=".proof-", dir=within) as place:
        again = Path(place)
        (again / "images").symlink_to((folder / "images").resolve(), target_is_directory=True)
        write(name, again, record, _scenes(folder, walks))
        wanted, found = (_files(where / name) for where in (again, folder))
        for file in sorted(wanted ^ found):
            yield f"{file} is missing" if file in wanted else f"{file} does not belong to this layout"
        for file in sorted(wanted & found):
            if not _agree(again / name / file, folder / name / file):
                yield f"{file} is not what the walks, poses and images give"


def _scenes(folder: Path, walks: Sequence[Row]) -> Iterator[SceneTables]:
    """Yield each scene with its walks and poses. One scene's poses are in memory at a time.

    Raises
    ------
    ValueError : the two tables have the scenes in different orders, or a walk has other numbers of frames than poses
    """
    schema = TRAJECTORY_TABLES["trajectories"]
    with pq.ParquetFile(folder / "poses.parquet") as poses:
        groups = iter(range(poses.num_row_groups))
        for (source, scene_id), own in groupby(walks, lambda walk: (walk["source"], walk["scene_id"])):
            group = next(groups, None)
            table = poses.schema_arrow.empty_table() if group is None else poses.read_row_group(group)
            rows = [*own]
            keys = {*zip(table["source"].to_pylist(), table["scene_id"].to_pylist(), strict=True)}
            if keys != {(source, scene_id)}:
                raise ValueError("poses.parquet has the scenes in another order")
            frames = Counter(zip(table["trajectory"].to_pylist(), table["camera"].to_pylist(), strict=True))
            for walk in rows:
                counts = {count for (name, _), count in frames.items() if name == walk["frames_of"]}
                if counts != {walk["n_frames"]} or len(walk["actions"]) != walk["n_frames"]:
                    raise ValueError(f"{walk['trajectory']} has other than {walk['n_frames']} actions or poses")
            yield source, scene_id, {"trajectories": pa.Table.from_pylist(rows, schema=schema), "poses": table}


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def _agree(made: Path, found: Path) -> bool:
    """Return whether two files are the same: tables and JSON by their values, all others byte for byte."""
    if os.path.samefile(made, found):
        return True
    one, other = made.read_bytes(), read_regular(found)
    if one == other:
        return True
    if made.suffix == ".parquet":
        tables = _table(made), _table(found)
        return tables[0].schema.equals(tables[1].schema, check_metadata=True) and _alike(
            *(table.to_pydict() for table in tables)
        )
    return made.suffix in (".json", ".jsonl") and _alike(_documents(one), _documents(other))


def _table(path: Path, columns: list[str] | None = None) -> pa.Table:
    refuse_parquet_bombs(path)
    return pq.read_table(path, columns=columns)


def _documents(data: bytes) -> Any:
    """Return the content of a JSON file, or a list of that of its lines."""
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError:
        return [orjson.loads(line) for line in data.splitlines()]


def _alike(made: Any, found: Any) -> bool:
    """Return whether two values are equal, but for the rounding of numbers that another processor computed."""
    if isinstance(made, dict) and isinstance(found, dict):
        return made.keys() == found.keys() and all(_alike(value, found[key]) for key, value in made.items())
    if isinstance(made, list) and isinstance(found, list):
        return len(made) == len(found) and all(map(_alike, made, found))
    if isinstance(made, float) and isinstance(found, float):
        return math.isclose(made, found, rel_tol=1e-9, abs_tol=1e-9)
    return type(made) is type(found) and bool(made == found)
