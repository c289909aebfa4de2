"""Stock R2R_VLNCE v1-3 episodes for VLN-CE's strict loader; our own fields are under ``info``.

A split is two files: ``<split>.json.gz`` (episodes, then the vocabulary) and ``<split>_gt.json.gz`` (dense locations
and actions by episode id, for nDTW and imitation learning).
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import orjson

from condvln.export.densify import densify
from condvln.export.rows import Points, Row
from condvln.export.tokens import Vocabulary
from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.sources.family import FAMILIES
from schemas.config.constants import PATH_SPACING
from schemas.program import SHAPES

__all__ = [
    "FORWARD",
    "SCENE_PATTERNS",
    "DocumentWriter",
    "EncodedEpisode",
    "document_writer",
    "encode",
    "gold",
    "ground_truth",
    "instruction_json",
    "scene_file",
    "truth_writer",
    "vlnce_episode",
]

FORWARD: Final = 1
"""Index of the forward action in ground-truth actions: STOP 0, FORWARD 1, LEFT 2, RIGHT 3."""
_FRAGMENT: Final = attrgetter("fragment")
"""Returns the JSON of :class:`~condvln.export.rows.Points`; a function of Python would take longer."""
_INSTRUCTION: Final = b'"instruction":'

SCENE_PATTERNS: Final[Mapping[str, str]] = {"": "{family}/{scene}/{name}.glb"} | {
    name: family.scene_file for name, family in FAMILIES.items()
}
"""Pattern of ``scene_id`` by family, below the folder ``scene_datasets``; the entry ``""`` is the default."""


def scene_file(family: str, scene: str, patterns: Mapping[str, str] = SCENE_PATTERNS) -> str:
    """Return ``scene_id`` of a VLN-CE episode: the path of the scene's mesh below the folder of scene datasets."""
    pattern = patterns.get(family) or patterns.get("") or SCENE_PATTERNS[""]
    name = posixpath.basename(scene)
    return pattern.format(family=family, scene=scene, name=name, scan=name.partition("-")[2] or name)


def gold(row: Row) -> Row:
    """Return the gold leaf of a row."""
    index = row["gold_leaf"]
    leaf: Row = next(leaf for leaf in row["leaves"] if leaf["leaf"] == index)
    return leaf


def vlnce_episode(row: Row, scene_id: str, tokens: list[int]) -> dict[str, Any]:
    """Return the stock episode of a row of the episodes table.

    The goals are all goal points of the gold leaf, the nearest to the start first: evaluators take the minimum over
    them, sensors the first one, and with this order both agree at the start.
    """
    leaf = gold(row)
    return {
        "episode_id": row["episode_id"],
        "trajectory_id": row["episode_id"],
        "scene_id": scene_id,
        "start_position": row["start_position"],
        "start_rotation": row["start_rotation"],
        "info": _info(row, leaf),
        "goals": _goals(leaf["goals"], row["success_distance"]),
        "instruction": {"instruction_text": row["instruction_text"], "instruction_tokens": tokens},
        "reference_path": leaf["reference_path"],
    }


def _goals(points: Points | list[Any], radius: float) -> Any:
    """Return the goals of a stock episode as a list, or as JSON if the points are."""
    if not isinstance(points, Points) or not points:
        return [{"position": point, "radius": radius} for point in points]
    behind = b'],"radius":' + encode(radius) + b"}"
    inner = points.json[2:-2].replace(b"],[", behind + b',{"position":[')
    return orjson.Fragment(b'[{"position":[' + inner + behind + b"]")


class EncodedEpisode(NamedTuple):
    """The JSON of an episode before and after the value of ``instruction``, which is all that its variants differ
    in.
    """

    head: bytes
    tail: bytes

    @classmethod
    def of(cls, row: Row, scene_id: str) -> EncodedEpisode:
        """Return the JSON of the stock episode of a row of the episodes table."""
        whole = encode({**vlnce_episode(row, scene_id, []), "instruction": None})
        # No text can have this key: its quotes would be escaped.
        head, _, tail = whole.partition(_INSTRUCTION + b"null")
        return cls(head + _INSTRUCTION, tail)

    def with_instruction(self, instruction: bytes) -> bytes:
        """Return the JSON of the whole episode; `instruction` is JSON too."""
        return self.head + instruction + self.tail


def instruction_json(text: bytes, tokens: bytes) -> bytes:
    """Return the JSON of a stock episode's instruction from that of its parts."""
    return b'{"instruction_text":' + text + b',"instruction_tokens":' + tokens + b"}"


def _info(row: Row, leaf: Row) -> dict[str, Any]:
    """Return an episode's extra fields under ``info``, which stock loaders ignore. The gold leaf is not among them;
    only the manifest has it.
    """
    shape = SHAPES[row["category"]]
    return {
        "geodesic_distance": row["geodesic_distance"],
        "route_length": row["route_length"],
        "subgoals": [subgoal["position"] for subgoal in leaf["subgoals"]],
        "success_distance": row["success_distance"],
        "max_steps": row["max_steps"],
        "category": row["category"],
        "depth": shape.depth,
        "chain": shape.chain,
        "composition": row["composition"],
        "observability": row["observability"],
        "evidence_in_view": row["evidence_in_view"],
        "observability_approximate": row["observability_approximate"],
        "moves": row["moves"],
        "words": row["words"],
        "instruction_id": row["instruction_id"],
        "group_id": row["group_id"],
        "episode_hash": row["episode_hash"],
        "start_heading_degrees": row["start_heading_degrees"],
        "navmesh_sha256": row["navmesh_sha256"],
    }


def ground_truth(row: Row) -> dict[str, Any]:
    """Return the dense locations of the gold path, and the actions if the row has them.

    The row's ``locations`` (positions of the follower, one more than its forward steps) are preferred. Without them,
    the reference path is densified to `PATH_SPACING` and rounded to 1 mm; the actions are still the row's.
    """
    walked = row.get("locations")
    locations = walked if walked else densify(gold(row)["reference_path"], PATH_SPACING).round(3).tolist()
    truth: dict[str, Any] = {"locations": locations}
    actions = row.get("actions")
    if actions:
        truth["actions"] = actions
        truth["forward_steps"] = actions.count(FORWARD)
    else:
        truth["forward_steps"] = len(locations) - 1
    return truth


def encode(document: object) -> bytes:
    """Return JSON bytes; numbers in their shortest form, keys in the given order. The document may have
    :class:`~condvln.export.rows.Points`.
    """
    return orjson.dumps(document, default=_FRAGMENT)


@dataclass
class DocumentWriter:
    """Writes ``{"episodes": […], "instruction_vocab": {…}}`` episode by episode."""

    entries: JsonArrayStream

    def add(self, episode: bytes) -> None:
        """Append one encoded episode."""
        self.entries.entry(episode)


@contextmanager
def document_writer(path: Path, vocabulary: Vocabulary | None) -> Iterator[DocumentWriter]:
    """Return a context manager that writes a VLN-CE document atomically to ``path``; RxR's documents have no
    vocabulary.
    """
    tail = b"" if vocabulary is None else b',"instruction_vocab":' + encode(vocabulary.document())
    with atomic_stream(path, closing=b"]" + tail + b"}") as stream:
        stream.write(b'{"episodes":[')
        yield DocumentWriter(JsonArrayStream(stream))


@contextmanager
def truth_writer(path: Path) -> Iterator[DocumentWriter]:
    """Return a context manager that writes a ground-truth document to ``path``; entries are ``"<episode id>":{…}``."""
    with atomic_stream(path, closing=b"}") as stream:
        stream.write(b"{")
        yield DocumentWriter(JsonArrayStream(stream))
