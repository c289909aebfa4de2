"""Stock R2R_VLNCE v1-3 episodes, as VLN-CE's strict loader takes them: our own fields are under ``info``.

A split is two files: ``<split>.json.gz`` (episodes, then the vocabulary) and ``<split>_gt.json.gz`` (dense locations
and actions by episode id, for nDTW and imitation learning).
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.export.densify import densify
from condvln.export.rows import Row
from condvln.export.tokens import Vocabulary
from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.sources.family import FAMILIES
from schemas.config.constants import PATH_SPACING
from schemas.program import SHAPES

__all__ = [
    "FORWARD",
    "SCENE_PATTERNS",
    "DocumentWriter",
    "document_writer",
    "encode",
    "gold",
    "ground_truth",
    "scene_file",
    "truth_writer",
    "vlnce_episode",
]

FORWARD: Final = 1
"""Index of the forward action in ground-truth actions: STOP 0, FORWARD 1, LEFT 2, RIGHT 3."""

SCENE_PATTERNS: Final[Mapping[str, str]] = {"": "{family}/{scene}/{name}.glb"} | {
    name: family.scene_file for name, family in FAMILIES.items()
}
"""``scene_id`` by family, below the folder ``scene_datasets``; the entry without a name is for families not listed."""


def scene_file(family: str, scene: str, patterns: Mapping[str, str] = SCENE_PATTERNS) -> str:
    """``scene_id`` of a VLN-CE episode: the path of the scene's mesh below the folder of scene datasets."""
    pattern = patterns.get(family) or patterns.get("") or SCENE_PATTERNS[""]
    return pattern.format(family=family, scene=scene, name=posixpath.basename(scene))


def gold(row: Row) -> Row:
    """The leaf that the truths of the conditions lead to."""
    index = row["gold_leaf"]
    leaf: Row = next(leaf for leaf in row["leaves"] if leaf["leaf"] == index)
    return leaf


def vlnce_episode(row: Row, scene_id: str, tokens: list[int]) -> dict[str, Any]:
    """One stock episode of a row of the episodes table.

    The goals are all goal points of the gold leaf, the one nearest to the start first: evaluators take the minimum over
    them, sensors the first, so that progress begins at 0.
    """
    leaf = gold(row)
    radius = row["success_distance"]
    return {
        "episode_id": row["episode_id"],
        "trajectory_id": row["episode_id"],
        "scene_id": scene_id,
        "start_position": row["start_position"],
        "start_rotation": row["start_rotation"],
        "info": _info(row, leaf),
        "goals": [{"position": point, "radius": radius} for point in leaf["goals"]],
        "instruction": {"instruction_text": row["instruction_text"], "instruction_tokens": tokens},
        "reference_path": leaf["reference_path"],
    }


def _info(row: Row, leaf: Row) -> dict[str, Any]:
    """Extra fields that stock loaders ignore. The gold leaf is only in the manifest."""
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
    """Dense locations of the gold leaf, and the actions with them where the row has both.

    ``locations`` of the row (what the follower went through, one more than its forward steps) come first; without
    them the reference path, cut to `PATH_SPACING` and rounded to 1 mm, stands in, and the actions are still
    those of the row.
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
    """JSON bytes; numbers in their shortest form, keys in the order given."""
    return orjson.dumps(document)


@dataclass
class DocumentWriter:
    """``{"episodes": […], "instruction_vocab": {…}}`` growing episode by episode."""

    entries: JsonArrayStream

    def add(self, episode: bytes) -> None:
        """Append one encoded episode."""
        self.entries.entry(episode)


@contextmanager
def document_writer(path: Path, vocabulary: Vocabulary | None) -> Iterator[DocumentWriter]:
    """A VLN-CE document under ``path``, whole or not there at all; RxR's has no vocabulary."""
    tail = b"" if vocabulary is None else b',"instruction_vocab":' + encode(vocabulary.document())
    with atomic_stream(path, closing=b"]" + tail + b"}") as stream:
        stream.write(b'{"episodes":[')
        yield DocumentWriter(JsonArrayStream(stream))


@contextmanager
def truth_writer(path: Path) -> Iterator[DocumentWriter]:
    """A ground-truth document under ``path``; entries are ``"<episode id>":{…}``."""
    with atomic_stream(path, closing=b"}") as stream:
        stream.write(b"{")
        yield DocumentWriter(JsonArrayStream(stream))
