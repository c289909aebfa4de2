"""Mutants of scenes: what an episode speaks of is put out of sight, and the episode is no longer proven."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from condvln.scene import Scene, SceneObject
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.verify.certificate import Certificate
from condvln.verify.files import Row, SceneRun
from condvln.verify.proof import prove_scene
from condvln.verify.surfaces import Shapes

sys.path.insert(0, str(Path(__file__).parent))
from mutation import pick

FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]])
ENDS = np.array([[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
FACTS = {"seeable", "referent_unique", "anchor_unique", "condition_truth", "condition_decided", "witnesses"}


def _case(item: SceneObject) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a shut case around an object, 2 cm outside of it."""
    low, high = item.aabb[0] - 0.02, item.aabb[1] + 0.02
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    return corners, np.concatenate([FACES, ENDS])


def _cased(geometry: SceneGeometry, item: SceneObject) -> SceneGeometry:
    corners, faces = _case(item)
    return SceneGeometry(
        np.concatenate([geometry.vertices, corners]),
        np.concatenate([geometry.faces, faces + len(geometry.vertices)]),
        np.concatenate([geometry.owner, np.full(len(faces), STRUCTURE)]),
        geometry.approximate,
    )


def _shut_in(scene: Scene, item: SceneObject) -> Scene:
    """The scene with a refrigerator around an object, as its annotation has it."""
    around = np.array([item.aabb[0] - 0.02, item.aabb[1] + 0.02])
    fridge = SceneObject("shut", item.room_id, "refrigerator", "refrigerator", around.mean(axis=0), aabb=around)
    return dataclasses.replace(scene, objects=(*scene.objects, fridge))


def _used(row: Row) -> set[str]:
    """Objects without which the text means something else: stops, anchors, and witnesses that are alone."""
    program = row.manifest.program
    found = {move.object_id for leaf in program.leaves for move in leaf.moves}
    for condition in program.conditions:
        found |= set(condition.witnesses)
        if condition.qualifier is not None:
            found |= {*condition.qualifier.anchor_ids}
    return found


def _proven(made_export, run: SceneRun, row: Row, scene, surfaces) -> Certificate:
    certificate = Certificate(row.manifest.episode_id, "replicacad", run.scene_id, row.split)
    shapes = Shapes(scene.root)
    prove_scene([row], [certificate], scene, lambda: surfaces, made_export.folder, made_export.rules, shapes)
    return certificate


def _mutants(made_export, rounds: int):
    rng = np.random.default_rng(3)
    for run in made_export.runs:
        rows = [row for row in run.rows if row.manifest.group_id is None]
        for row in rows[:: max(1, len(rows) // rounds)]:
            yield run, row, made_export.scenes[run.scene_id].object_of[pick(rng, _used(row))]


@pytest.mark.parametrize("rounds", [6, pytest.param(1000, marks=pytest.mark.soak)])
def test_an_episode_that_speaks_of_what_nobody_sees_is_not_proven(made_export, rounds: int) -> None:
    tried, survivors = 0, []
    for run, row, item in _mutants(made_export, rounds):
        scene, surfaces = made_export.scenes[run.scene_id], made_export.surfaces[run.scene_id]
        mutants = {
            "unseeable": (scene, _cased(surfaces, item)),
            "shut receptacle": (_shut_in(scene, item), surfaces),
        }
        for name, (mutant, around) in mutants.items():
            certificate = _proven(made_export, run, row, mutant, around)
            tried += 1
            facts = {d.fact for d in certificate.disagreements}
            if not facts & FACTS:
                survivors.append((name, item.object_id, row.manifest.instruction_text))
    print(f"\n{tried} scenes with something out of sight, {tried - len(survivors)} caught")
    assert tried
    assert not survivors
