"""Checks of ``{episodes, instruction_vocab}`` documents (stock VLN-CE, ANSR-v1 and RxR guides) against what strict
loaders and their measures expect.

Allowed and required keys of an episode are those of ``VLNExtendedEpisode``, ``InstructionData``, ``RxRInstructionData``
and habitat-lab's ``VLNEpisode``, which are constructed from each record by keyword.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np

from condvln.export.tokens import PAD_INDEX, UNK_INDEX, Vocabulary, tokenize
from condvln.export.validation.findings import LintReport, check_keys, is_number, is_point, points, straight
from condvln.navigation.pathfinder import Pathfinder

__all__ = ["Document", "Kind", "PathfinderOf", "check_document"]

Kind = Literal["vlnce", "ansr", "rxr", "r2r"]

PathfinderOf = Callable[[dict[str, Any]], Pathfinder | None]
"""Returns the navmesh of an episode's scene; None if unknown."""


@dataclass
class Document:
    """The parts of a document that later checks need."""

    kind: Kind
    vocabulary: Vocabulary | None = None
    bert: bool = False
    """Whether the vocabulary is BERT's, so that tokens are word pieces between [CLS] and [SEP]."""
    scenes: set[str] = field(default_factory=set)
    starts: dict[str, list[float]] = field(default_factory=dict)
    goals: dict[str, list[tuple[list[float], float]]] = field(default_factory=dict)
    told: dict[tuple[str, str, tuple[float, ...]], str] = field(default_factory=dict)
    """Episode id by (scene, text, start)."""

    def merge(self, other: Document) -> None:
        """Merge another document of the same split, such as a shard, into this one."""
        self.vocabulary = self.vocabulary or other.vocabulary
        self.bert |= other.bert
        self.scenes |= other.scenes
        self.starts |= other.starts
        self.goals |= other.goals
        self.told |= other.told


_BERT_PAD, _BERT_UNK = "[PAD]", "[UNK]"
"""Special words of BERT's own vocabulary, which ``<split>_bertidx`` files have in place of R2R's."""

_TOP: Final = frozenset({"episodes", "instruction_vocab"})

_REQUIRED: Final = frozenset(
    {"episode_id", "trajectory_id", "scene_id", "start_position", "start_rotation", "instruction"}
)
_NOT_IN_RXR: Final = frozenset({"trajectory_id"})
"""Keys that RxR's loader does not require: followers' episodes have no trajectory."""
WITHHELD: Final = frozenset({"goals", "reference_path"})
"""Keys without which habitat-lab's loader fails, and VLN-CE's only when it scores. All episodes of a test split may
lack both.
"""
_ALLOWED: Final = (
    _REQUIRED
    | WITHHELD
    | {"info", "start_room", "shortest_paths", "scene_dataset_config", "additional_obj_config_paths"}
)
_INSTRUCTION: Final = frozenset({"instruction_text", "instruction_tokens"})
_RXR_INSTRUCTION: Final = frozenset(
    {
        "instruction_text",
        "instruction_id",
        "language",
        "annotator_id",
        "edit_distance",
        "timed_instruction",
        "instruction_tokens",
        "split",
    }
)
_GOAL: Final = frozenset({"position", "radius"})

_JOINT: Final = 0.1
"""Tolerance in metres between the ends of a reference path and start and goal."""
_NORM: Final = 1e-3
_UPRIGHT: Final = 1e-3
_STRAIGHT: Final = 0.01
"""Tolerance in metres by which a geodesic may be shorter than the straight line, because its ends are snapped."""
_ON_MESH: Final = 0.5
"""Largest height in metres of a point above the floor below it, from Habitat's is_navigable."""
_GEODESIC: Final = 0.02
"""Tolerance in metres, and as a share, between a stored geodesic and the navmesh's."""


_BERT_START, _BERT_END, _BERT_WORDS = 101, 102, 30_522
"""The token indices of ``[CLS]`` and ``[SEP]``, and the size of BERT's uncased vocabulary, used in
``<split>_bertidx`` files.
"""


def _is_bert(tokens: list[int]) -> bool:
    """Return whether `tokens` are BERT's: they begin with [CLS], and only padding follows [SEP]."""
    said = [token for token in tokens if token != PAD_INDEX]
    ends = said[:1] == [_BERT_START] and (said[-1] == _BERT_END or len(said) == len(tokens))
    return ends and all(0 < token < _BERT_WORDS for token in said)


def check_document(report: LintReport, content: dict[str, Any], pathfinder_of: PathfinderOf | None = None) -> Document:
    """Check one document; if ``pathfinder_of`` is given, also check it against the navmeshes of its scenes."""
    episodes = content.get("episodes")
    if not isinstance(episodes, list):
        report.add("episodes", "wrong-type", "not a list")
        return Document("vlnce")
    for key in sorted(set(content) - _TOP):
        report.add(key, "unknown-top-key", f"unknown key {key!r}")
    if not episodes:
        report.add("episodes", "no-episodes", "there is none")
    document = Document(_kind(report.file, episodes))
    document.vocabulary = _vocabulary(report, content.get("instruction_vocab"), document)
    withheld = all(isinstance(one, dict) and not one.keys() & WITHHELD for one in episodes)
    checks = EpisodeChecks(report, document, pathfinder_of, withheld=bool(episodes) and withheld)
    if episodes and withheld:
        report.add("episodes", "goals-withheld", "no episode has goals or a reference path")
    for number, episode in enumerate(episodes):
        report.episode = ""
        checks.check(f"episodes[{number}]", episode)
    report.episode = ""
    return document


def _kind(file: str, episodes: list[Any]) -> Kind:
    records = [episode for episode in episodes if isinstance(episode, dict)]
    if not records:  # an empty split: only the file's name tells the format
        return "rxr" if "_guide." in file or "_follower." in file else "vlnce"
    if 2 * sum("subgoals" in record for record in records) > len(records):
        return "ansr"
    told = [record["instruction"] for record in records if isinstance(record.get("instruction"), dict)]
    # A single wrong key does not change the file's format.
    if 2 * sum("language" in instruction for instruction in told) > len(told):
        return "rxr"
    return "vlnce"


def _vocabulary(report: LintReport, found: Any, document: Document) -> Vocabulary | None:
    if found is None and document.kind == "rxr":
        return None
    if not isinstance(found, dict) or not isinstance(found.get("word_list"), list):
        report.add("instruction_vocab", "missing-vocabulary", "no instruction_vocab.word_list")
        return None
    words = found["word_list"]
    place = "instruction_vocab"
    if not all(isinstance(word, str) for word in words):
        report.add(f"{place}.word_list", "wrong-type", "not a list of words")
        return None
    document.bert = words[:1] == [_BERT_PAD] and _BERT_UNK in words
    if len(set(words)) != len(words) or not (document.bert or words[:2] == ["<pad>", "<unk>"]):
        report.add(f"{place}.word_list", "vocabulary-inconsistent", "does not begin <pad>, <unk>, or repeats a word")
        return None
    index = {word: number for number, word in enumerate(words)}
    wanted: dict[str, Any] = {
        "word2idx_dict": index,
        "stoi": index,
        "itos": words,
        "num_vocab": len(words),
        "UNK_INDEX": words.index(_BERT_UNK) if document.bert else UNK_INDEX,
        "PAD_INDEX": PAD_INDEX,
    }
    for key, value in wanted.items():
        if key in found and found[key] != value:
            report.add(f"{place}.{key}", "vocabulary-inconsistent", f"{key} does not agree with word_list")
    return None if document.bert else Vocabulary(tuple(words))


class EpisodeChecks:
    """Checks the episodes of a file in turn, and adds what later checks need to ``document``, the file's record."""

    def __init__(
        self,
        report: LintReport,
        document: Document,
        pathfinder_of: PathfinderOf | None,
        *,
        withheld: bool = False,
    ) -> None:
        self._report = report
        self._document = document
        self._pathfinder_of = pathfinder_of
        self._length: int | None = None
        self._id_named = False
        ansr = {"subgoals"} if document.kind == "ansr" else set()
        rxr = _NOT_IN_RXR if document.kind == "rxr" else frozenset()
        self._required = (_REQUIRED - rxr) | (frozenset() if withheld else WITHHELD) | ansr
        self._withheld = withheld
        self._allowed = _ALLOWED | ansr
        self._instruction_keys = _RXR_INSTRUCTION if document.kind == "rxr" else _INSTRUCTION

    def check(self, place: str, episode: Any) -> None:
        """Run all checks of one episode; each check assumes that the ones before it passed."""
        if not isinstance(episode, dict):
            self._report.add(place, "wrong-type", f"not an object but {type(episode).__name__}")
            return
        name = episode.get("episode_id")
        if isinstance(name, str | int) and not isinstance(name, bool):
            place = f"episode {name}"
            self._report.episode = str(name)
        check_keys(self._report, place, episode, self._required, self._allowed)
        self._check_ids(place, episode)
        self._check_scene(place, episode)
        start = self._check_start(place, episode)
        self._check_rotation(place, episode)
        goals = self._check_goals(place, episode, "goals")
        if "subgoals" in episode:
            self._check_goals(place, episode, "subgoals")
        self._check_reference(place, episode, start, goals)
        self._check_geodesic(place, episode, start, goals)
        self._check_instruction(place, episode, start)
        self._check_navmesh(place, episode, start, goals)

    def _check_ids(self, place: str, episode: dict[str, Any]) -> None:
        for key in ("episode_id", "trajectory_id"):
            value = episode.get(key)
            if key in episode and (isinstance(value, bool) or not isinstance(value, str | int)):
                self._report.add(f"{place}.{key}", "wrong-type", f"{value!r} is neither a number nor text")
        name = str(episode.get("episode_id"))
        if self._document.kind == "rxr" and type(episode.get("episode_id")) is int and not self._id_named:
            self._id_named = True
            self._report.add(f"{place}.episode_id", "id-not-text", f"{name} is a number")
        if "episode_id" in episode:
            if not self._id_named and not name.isdecimal():
                self._id_named = True  # where one id is text, all are
                self._report.add(f"{place}.episode_id", "id-not-integer", f"{name!r} is not a whole number")
            if name in self._document.starts:
                self._report.add(place, "duplicate-id", f"id {name} occurs twice")
            self._document.starts.setdefault(name, [])

    def _check_scene(self, place: str, episode: dict[str, Any]) -> None:
        scene = episode.get("scene_id")
        if "scene_id" not in episode:
            return
        if not isinstance(scene, str):
            self._report.add(f"{place}.scene_id", "wrong-type", f"{scene!r} is not text")
            return
        parts = scene.split("/")
        doubled = any(a == b for a, b in pairwise(parts)) and len(parts) > 3
        bad = scene.startswith("/") or "\\" in scene or ".." in parts or "" in parts or doubled
        if bad or not scene.endswith((".glb", ".json", ".ply")) or len(parts) < 2:
            self._report.add(f"{place}.scene_id", "scene-path", f"{scene!r}")
        elif scene.startswith("data/"):
            self._report.add(f"{place}.scene_id", "scene-prefix", f"{scene!r}")
        self._document.scenes.add(scene)

    def _check_start(self, place: str, episode: dict[str, Any]) -> list[float] | None:
        if "start_position" not in episode:
            return None
        start = episode["start_position"]
        if not points(self._report, f"{place}.start_position", [start]):
            return None
        self._document.starts[str(episode.get("episode_id"))] = start
        return list(start)

    def _check_rotation(self, place: str, episode: dict[str, Any]) -> None:
        if "start_rotation" not in episode:
            return
        rotation, place = episode["start_rotation"], f"{place}.start_rotation"
        if not is_point(rotation, 4):
            self._report.add(place, "wrong-type", f"not four numbers: {rotation!r:.60}")
            return
        if not all(math.isfinite(part) for part in rotation):
            self._report.add(place, "not-finite", f"{rotation}")
            return
        norm = math.hypot(*rotation)
        if abs(norm - 1.0) > _NORM:
            self._report.add(place, "rotation-norm", f"its norm is {norm:.4f}")
            return
        first, second, third, fourth = (abs(part) for part in rotation)
        if first > _UPRIGHT or third > _UPRIGHT:
            swapped = second <= _UPRIGHT and fourth <= _UPRIGHT
            code = "rotation-order" if swapped else "rotation-tilted"
            self._report.add(place, code, f"{rotation} is not a rotation about +y")

    def _check_goals(self, place: str, episode: dict[str, Any], key: str) -> list[tuple[list[float], float]]:
        goals, place = episode.get(key), f"{place}.{key}"
        if key not in episode:
            return []
        if not isinstance(goals, list) or (not goals and key == "goals"):
            self._report.add(place, "wrong-type", "not a list of goals" if goals != [] else "there is no goal")
            return []
        sound = []
        for number, goal in enumerate(goals):
            here = f"{place}[{number}]"
            if not check_keys(self._report, here, goal, frozenset({"position"}), _GOAL):
                continue
            radius = goal.get("radius")
            if radius is not None and not (is_number(radius) and math.isfinite(radius) and radius > 0):
                self._report.add(f"{here}.radius", "goal-radius", f"{radius!r}")
                radius = None
            if points(self._report, f"{here}.position", [goal["position"]]):
                sound.append((goal["position"], float(radius) if radius is not None else math.inf))
        if key == "goals":
            self._document.goals[str(episode.get("episode_id"))] = sound
        return sound

    def _check_reference(
        self, place: str, episode: dict[str, Any], start: list[float] | None, goals: list[tuple[list[float], float]]
    ) -> None:
        path, place = episode.get("reference_path"), f"{place}.reference_path"
        if "reference_path" not in episode or not points(self._report, place, path):
            return
        if not isinstance(path, list) or len(path) < 2:
            self._report.add(place, "reference-short", f"{len(path or [])} points")
            return
        if start is not None and straight(path[0], start) > _JOINT:
            self._report.add(place, "reference-start", f"begins {straight(path[0], start):.2f} m from the start")
        if goals:
            off = min(straight(path[-1], position) for position, _ in goals)
            if off > _JOINT:
                self._report.add(place, "reference-goal", f"ends {off:.2f} m from the nearest goal")

    def _check_geodesic(
        self, place: str, episode: dict[str, Any], start: list[float] | None, goals: list[tuple[list[float], float]]
    ) -> None:
        info = episode.get("info")
        if info is not None and not isinstance(info, dict):
            self._report.add(f"{place}.info", "wrong-type", f"not an object but {type(info).__name__}")
            return
        place = f"{place}.info.geodesic_distance"
        if (self._withheld or self._document.kind == "rxr") and (not info or "geodesic_distance" not in info):
            return  # RxR never has it
        if not info or "geodesic_distance" not in info:
            self._report.add(place, "missing-geodesic", "is missing")
            return
        distance = info["geodesic_distance"]
        if not is_number(distance) or not math.isfinite(distance) or distance < 0:
            self._report.add(place, "geodesic-invalid", f"{distance!r}")
            return
        if start is None or not goals:
            return
        line = min(straight(start, position) for position, _ in goals)
        if distance < line - _STRAIGHT:
            self._report.add(place, "geodesic-too-short", f"{distance:.2f} m, but {line:.2f} m in a straight line")
        if any(distance < radius for _, radius in goals if math.isfinite(radius)):
            self._report.add(place, "start-is-goal", f"the start is {distance:.2f} m from the goal, inside its radius")

    def _check_instruction(self, place: str, episode: dict[str, Any], start: list[float] | None) -> None:
        if "instruction" not in episode:
            return
        instruction, place = episode["instruction"], f"{place}.instruction"
        required = frozenset({"instruction_text"})
        if not check_keys(self._report, place, instruction, required, self._instruction_keys):
            return
        text = instruction["instruction_text"]
        if not isinstance(text, str):
            self._report.add(f"{place}.instruction_text", "wrong-type", f"{text!r} is not text")
            return
        if not tokenize(text):
            self._report.add(f"{place}.instruction_text", "empty-text", "the text has no words")
        if start is not None and isinstance(episode.get("scene_id"), str):
            self._document.told[episode["scene_id"], text, tuple(start)] = str(episode.get("episode_id"))
        if self._document.kind != "rxr":
            self._check_tokens(f"{place}.instruction_tokens", instruction.get("instruction_tokens"), text)

    def _check_tokens(self, place: str, tokens: Any, text: str) -> None:
        if tokens is None:
            return
        if not isinstance(tokens, list) or not all(type(token) is int for token in tokens):
            self._report.add(place, "wrong-type", "not a list of whole numbers")
            return
        self._length = len(tokens) if self._length is None else self._length
        # Unpadded files are valid too; padding to different lengths is not, since loaders can't stack it.
        if len(tokens) != self._length and PAD_INDEX in tokens:
            self._report.add(place, "token-length", f"{len(tokens)} tokens, {self._length} before")
        vocabulary = self._document.vocabulary
        if self._document.bert and not _is_bert(tokens):
            self._report.add(place, "token-range", "not word pieces of BERT between [CLS] and [SEP]")
        if vocabulary is None or _is_bert(tokens):
            return
        outside = [token for token in tokens if not 0 <= token < len(vocabulary.words)]
        if outside:
            self._report.add(place, "token-range", f"{outside[0]} of {len(vocabulary.words)} words")
            return
        wanted = vocabulary.encode(text)[: len(tokens)]
        if [token for token in tokens if token != PAD_INDEX] != wanted:
            self._report.add(place, "token-mismatch", "the tokens are not those of the text")
        elif UNK_INDEX in tokens:
            words = [word for word in tokenize(text) if word not in vocabulary.words]
            self._report.add(place, "unknown-words", f"{', '.join(words[:5])}")

    def _check_navmesh(
        self, place: str, episode: dict[str, Any], start: list[float] | None, goals: list[tuple[list[float], float]]
    ) -> None:
        if self._pathfinder_of is None or start is None or not goals:
            return
        pathfinder = self._pathfinder_of(episode)
        if pathfinder is None:
            return
        if not pathfinder.is_navigable(np.array(start), _ON_MESH):
            self._report.add(f"{place}.start_position", "start-off-mesh", f"{start}")
            return
        positions = np.array([position for position, _ in goals])
        off = [p.tolist() for p in positions if not pathfinder.is_navigable(p, _ON_MESH)]
        if off:
            self._report.add(f"{place}.goals", "goal-off-mesh", f"{off[0]}")
            return
        found = float(pathfinder.geodesic_distance(np.array(start), positions))
        if not math.isfinite(found):
            self._report.add(place, "unreachable", "there is no path from the start to a goal")
            return
        info = episode.get("info")
        told = info.get("geodesic_distance") if isinstance(info, dict) else None
        if is_number(told) and told is not None and abs(told - found) > _GEODESIC * (1 + found):
            self._report.add(
                f"{place}.info.geodesic_distance", "geodesic-differs", f"{told:.3f} m, navmesh {found:.3f} m"
            )
