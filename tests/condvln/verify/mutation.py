"""Seeded faults in published files, each of which makes an episode wrong.

A mutator puts one fault into an episode as its files have it, or says that it does not apply. Faults
are carried through: where a truth is flipped, the gold leaf, its goals and the record follow, so that nothing but the
scene itself can tell. Those of the kind "said" get a new text, so that it agrees with the program.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from condvln.instructions import render, with_preamble
from condvln.instructions.rendering import names_compass
from condvln.relations import TextFacts
from condvln.scene import Scene
from condvln.verify.certificate import Certificate
from condvln.verify.files import Row
from condvln.verify.referents import SceneReferents
from condvln.verify.standpoint import heading_of, yaw_of
from condvln.verify.surfaces import Shapes
from condvln.verify.text_check import check_meaning
from condvln.verify.words import words
from schemas.evaluation import ManifestEpisode
from schemas.program import Program

Document = dict[str, Any]
LEAST = 0.99
"""Share of the mutants of each kind that must be caught."""


def problems(row: Row, scene: Scene, made_export: Any, shapes: Shapes) -> set[str]:
    """Facts of a text's meaning that the verifier finds wrong in a scene."""
    certificate = Certificate(row.manifest.episode_id, row.manifest.source, row.manifest.scene_id, row.split)
    referents = SceneReferents(scene, made_export.rules.thresholds, made_export.rules.anchor_size, shapes)
    check_meaning(row.manifest, referents, made_export.rules, certificate)
    return {disagreement.fact for disagreement in certificate.disagreements}


@dataclass
class Files:
    """One episode as its files have it."""

    manifest: Document
    record: Document
    truth: Document
    looking_truth: Document | None

    @classmethod
    def of(cls, row: Row) -> Files:
        assert row.record is not None
        assert row.truth is not None
        truths = [copy.deepcopy(dict(row.truth)), copy.deepcopy(row.looking_truth)]
        return cls(row.manifest.model_dump(mode="json"), copy.deepcopy(dict(row.record)), *truths)

    def row(self, split: str) -> Row:
        """As it is read back; the record along the looking path follows the stock one. Raises ValidationError where it
        is no manifest row any more.
        """
        looking = {**self.record, "reference_path": self.manifest["looking_path"]}
        manifest = ManifestEpisode.model_validate(self.manifest)
        return Row(split, manifest, self.record, self.truth, looking, self.looking_truth)

    # -- changes that are carried through ------------------------------------------------------------------------------

    def say(self, text: str) -> None:
        """Another text, in both files."""
        self.manifest["instruction_text"] = text
        self.manifest["words"] = self.record["info"]["words"] = len(text.split())
        self.record["instruction"]["instruction_text"] = text

    def word(self) -> None:
        """The text that the program as it is now would have."""
        program = Program.model_validate(self.manifest["program"])
        body = render(program, 0, self.manifest["instruction_id"])
        yaw = yaw_of(self.manifest["start_rotation"])
        assert yaw is not None
        if names_compass(program):
            nearest = round(heading_of(yaw) / 45.0) * 45.0 % 360.0
            body = with_preamble(body, nearest, 0, self.manifest["instruction_id"])
        self.say(body)

    def follow_truths(self) -> None:
        """Gold leaf and all that hangs on it, as the truths now have it."""
        self.take_leaf(Program.model_validate(self.manifest["program"]).gold_leaf())

    def take_leaf(self, gold: int) -> None:
        """Another gold leaf."""
        manifest, record = self.manifest, self.record
        leaf = manifest["leaves"][gold]
        manifest["gold_leaf"] = gold
        manifest["moves"] = record["info"]["moves"] = len(manifest["program"]["leaves"][gold]["moves"])
        leads = len(Program.model_validate(manifest["program"]).leads(gold))
        manifest["leads"] = record["info"]["leads"] = leads
        for name in ("geodesic_distance", "route_length"):
            manifest[name] = record["info"][name] = leaf[name]
        self.repeat_gold()

    def repeat_gold(self) -> None:
        """The record repeats the gold leaf of the manifest."""
        leaf = self.manifest["leaves"][self.manifest["gold_leaf"]]
        radius = self.manifest["success_distance"]
        self.record["goals"] = [{"position": goal, "radius": radius} for goal in leaf["goals"]]
        self.record["info"]["subgoals"] = [subgoal["position"] for subgoal in leaf["subgoals"]]
        self.record["reference_path"] = leaf["reference_path"]

    @property
    def conditions(self) -> list[Document]:
        found: list[Document] = self.manifest["program"]["conditions"]
        return found

    @property
    def leaves(self) -> list[Document]:
        found: list[Document] = self.manifest["program"]["leaves"]
        return found


@dataclass(frozen=True)
class World:
    """What a mutator may know of the scene, so that its fault is one."""

    scene: Scene
    facts: dict[str, TextFacts]

    def status(self, room_id: str, predicate: str, subject: str, target: str) -> int:
        order = {name: k for k, name in enumerate(self.scene.arrays(room_id).object_ids)}
        return int(self.facts[room_id].status[predicate][order[subject], order[target]])

    def denied(self, room_id: str, predicate: str, subject: str, target: str) -> bool:
        order = {name: k for k, name in enumerate(self.scene.arrays(room_id).object_ids)}
        if predicate not in self.facts[room_id].denied:
            return self.status(room_id, predicate, subject, target) == -1
        return bool(self.facts[room_id].denied[predicate][order[subject], order[target]])

    def objects_like(self, room_id: str, label: str) -> list[str]:
        meant = words().meant_by(label)
        return [o.object_id for o in self.scene.objects if o.room_id == room_id and o.label in meant]


Mutator = Callable[[Files, np.random.Generator, World], bool]
"""Puts one fault into the files; False where it does not apply."""

MUTATORS: dict[str, Mutator] = {}


def mutator(function: Mutator) -> Mutator:
    """Register a kind of fault under its function's name."""
    MUTATORS[function.__name__] = function
    return function


def pick(rng: np.random.Generator, items: Any) -> Any:
    """One of `items`; of a set by its sorted order, which is the same in every process."""
    items = sorted(items) if isinstance(items, set | frozenset) else list(items)
    return items[rng.integers(len(items))]
