"""Stock R2R_VLNCE v1-3 episodes for VLN-CE's strict loader, with our own fields under ``info``, and their variants.

A split is two files: ``<split>.json.gz`` (episodes, then the vocabulary) and ``<split>_gt.json.gz`` (dense locations
and actions by episode id, for nDTW and imitation learning).

ANSR-v1 adds top-level ``subgoals``, as the public evaluators of conditional episodes read them (source of the keys:
dataset type ``ANSR-v1`` of the VLN-Zero and Open-Nav forks). The key is always present, ``[]`` if the gold branch has
one move. RxR's trainers write predictions by ``instruction_id``, a number; ours is the episode's id. The oracle-linear
twin is the same episode with the gold branch as a plain instruction.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.export.tables import Row
from condvln.export.tokens import Vocabulary
from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.navigation.points import densify
from condvln.sources.family import FAMILIES
from schemas.config.constants import PATH_SPACING
from schemas.program import SHAPES

__all__ = [
    "FORWARD",
    "RXR_LANGUAGES",
    "ansr_episode",
    "document_stream",
    "encode",
    "gold",
    "ground_truth",
    "looking_episode",
    "looking_truth",
    "oracle_episode",
    "rxr_episode",
    "scene_file",
    "truth_stream",
    "vlnce_episode",
]

FORWARD: Final = 1
"""Index of the forward action in ground-truth actions: STOP 0, FORWARD 1, LEFT 2, RIGHT 3."""

_INFO: Final = (
    "geodesic_distance", "route_length", "subgoals", "success_distance", "max_steps", "category", "depth", "chain",
    "composition", "observability", "evidence_in_view", "observability_approximate", "moves", "leads",
    "words", "instruction_id", "group_id", "episode_hash", "start_heading_degrees", "navmesh_sha256",
)  # fmt: skip
"""Keys of an episode's ``info``, in the order of the files."""

RXR_LANGUAGES: Final = {"en": "en-US", "es": "es-ES"}
"""RxR's name of a language."""


def scene_file(family: str, scene: str) -> str:
    """Return ``scene_id`` of a VLN-CE episode: the path of the scene's mesh below the folder of scene datasets."""
    pattern = FAMILIES[family].scene_file if family in FAMILIES else "{family}/{scene}/{name}.glb"
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
        "goals": [{"position": point, "radius": row["success_distance"]} for point in leaf["goals"]],
        "instruction": {"instruction_text": row["instruction_text"], "instruction_tokens": tokens},
        "reference_path": leaf["reference_path"],
    }


def looking_episode(stock: Row, row: Row) -> dict[str, Any]:
    """Return a stock episode, or a variant of it, with the looking path as its reference path."""
    return {**stock, "reference_path": row["looking_path"]}


def ansr_episode(stock: Row, row: Row) -> dict[str, Any]:
    """Return the ANSR-v1 episode of a stock episode: with the gold leaf's subgoals in order, whose radius is the
    success distance.
    """
    radius = row["success_distance"]
    return {**stock, "subgoals": [{"position": s["position"], "radius": radius} for s in gold(row)["subgoals"]]}


def rxr_episode(stock: Row, row: Row, split: str, language: str = "en") -> dict[str, Any]:
    """Return the RxR guide episode of a stock episode: the text under RxR's keys, without tokens (agents use their own
    encoder).

    Ids are texts: RxR's loader compares them with texts and looks them up as keys of the ground truth; VLN-CE's makes
    texts of them first.
    """
    name = str(row["episode_id"])
    instruction = {
        "instruction_id": name,
        "instruction_text": row["instruction_text"],
        "language": RXR_LANGUAGES[language],
        "annotator_id": "0",
        "edit_distance": 0.0,
        "timed_instruction": [],
        "instruction_tokens": [],
        "split": split,
    }
    return {**stock, "episode_id": name, "trajectory_id": name, "instruction": instruction}


def oracle_episode(stock: Row, text: str, tokens: list[int]) -> dict[str, Any]:
    """Return the oracle-linear twin of a stock episode."""
    return {**stock, "instruction": {**stock["instruction"], "instruction_text": text, "instruction_tokens": tokens}}


def _info(row: Row, leaf: Row) -> dict[str, Any]:
    """Return an episode's extra fields under ``info``, which stock loaders ignore. The gold leaf is not among them;
    only the manifest has it.
    """
    shape = SHAPES[row["category"]]
    own = {
        "subgoals": [subgoal["position"] for subgoal in leaf["subgoals"]],
        "depth": shape.depth,
        "chain": shape.chain,
    }
    return {name: own[name] if name in own else row[name] for name in _INFO}


def ground_truth(row: Row) -> dict[str, Any]:
    """Return the dense locations of the gold path, and the actions if the row has them.

    The row's ``locations`` (positions of the follower, one more than its forward steps) are preferred. Without them,
    the reference path is densified to `PATH_SPACING` and rounded to 1 mm; the actions are still the row's.
    """
    return _truth(row.get("locations"), gold(row)["reference_path"], row.get("actions"))


def looking_truth(row: Row) -> dict[str, Any]:
    """Return the same of the looking path."""
    return _truth(row.get("looking_locations"), row["looking_path"], row["looking_actions"])


def _truth(walked: list[Any] | None, path: list[Any], actions: list[int] | None) -> dict[str, Any]:
    locations = walked if walked else densify(path, PATH_SPACING).round(3).tolist()
    truth: dict[str, Any] = {"locations": locations}
    if actions:
        truth["actions"] = actions
        truth["forward_steps"] = actions.count(FORWARD)
    else:
        truth["forward_steps"] = len(locations) - 1
    return truth


def encode(document: object) -> bytes:
    """Return JSON bytes; numbers in their shortest form, keys in the given order."""
    return orjson.dumps(document)


@contextmanager
def document_stream(path: Path, vocabulary: Vocabulary | None) -> Iterator[JsonArrayStream]:
    """Return a context manager that writes ``{"episodes": […], "instruction_vocab": {…}}`` atomically to ``path``,
    episode by episode; RxR's documents have no vocabulary.
    """
    tail = b"" if vocabulary is None else b',"instruction_vocab":' + encode(vocabulary.document())
    with atomic_stream(path, closing=b"]" + tail + b"}") as stream:
        stream.write(b'{"episodes":[')
        yield JsonArrayStream(stream)


@contextmanager
def truth_stream(path: Path) -> Iterator[JsonArrayStream]:
    """Return a context manager that writes a ground-truth document to ``path``; entries are ``"<episode id>":{…}``."""
    with atomic_stream(path, closing=b"}") as stream:
        stream.write(b"{")
        yield JsonArrayStream(stream)
