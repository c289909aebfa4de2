"""Mutation test: an episode with one fault in its published files is never proven."""

from __future__ import annotations

import sys
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from condvln.relations import relate_scene, text_facts
from condvln.scene.meshes import MeshLibrary
from condvln.verify.certificate import Certificate
from condvln.verify.corpus import Corpus
from condvln.verify.files import Row
from condvln.verify.proof import prove_scene
from condvln.verify.surfaces import Shapes
from schemas.config import Thresholds

sys.path.insert(0, str(Path(__file__).parent))
from mutants import MUTATORS, Files, World

ROUNDS = 1
"""Times that each mutator is tried on each episode; some 2,400 mutants."""
SOAK_ROUNDS = 2
LEAST = 0.99
"""Share of mutants that must be caught."""


def _mutants(made_export, seed: int, rounds: int):
    """(scene id, mutator, row) of all mutants that are still rows; the count of those that are not, by mutator."""
    refused: Counter[str] = Counter()
    made: dict[str, list[tuple[str, Row]]] = {}
    rng = np.random.default_rng(seed)
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        relations = relate_scene(scene, Thresholds(), meshes=MeshLibrary(scene.root).world_mesh)
        world = World(scene, {room_id: text_facts(found, Thresholds()) for room_id, found in relations.items()})
        rows = made.setdefault(run.scene_id, [])
        for row in run.rows:
            if row.manifest.group_id is not None:
                continue  # mutants beside each other would be members of one group; they have a test of their own
            for name, mutate in MUTATORS.items():
                for _ in range(rounds):
                    files = Files.of(row)
                    if not mutate(files, rng, world):
                        continue
                    try:
                        rows.append((name, files.row(row.split)))
                    except ValidationError:
                        refused[name] += 1
    return made, refused


def _single(run) -> Row:
    """A sound row that is of no group."""
    return next(row for row in run.rows if row.manifest.group_id is None)


def _survivors(made_export, made) -> list[tuple[str, str, str]]:
    survivors = []
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        # The sound row goes first, so that the scene's navmesh is found; it must be proven beside all its mutants.
        rows = [_single(run), *(row for _, row in made[run.scene_id])]
        certificates = [
            Certificate(row.manifest.episode_id, row.manifest.source, row.manifest.scene_id, row.split) for row in rows
        ]
        surfaces = partial(made_export.surfaces.get, run.scene_id)
        prove_scene(rows, certificates, scene, surfaces, made_export.folder, made_export.rules, Shapes(scene.root))
        assert certificates[0].proven
        for (name, row), certificate in zip(made[run.scene_id], certificates[1:], strict=True):
            if certificate.proven:
                survivors.append((name, row.manifest.episode_id, row.manifest.instruction_text))
    return survivors


@pytest.mark.parametrize(("seed", "rounds"), [(0, ROUNDS), pytest.param(1, SOAK_ROUNDS, marks=pytest.mark.soak)])
def test_mutants_are_caught(made_export, seed: int, rounds: int) -> None:
    made, refused = _mutants(made_export, seed, rounds)
    tried = Counter(name for rows in made.values() for name, _ in rows) + refused
    survivors = _survivors(made_export, made)
    total = tried.total()
    print(
        f"\n{total} mutants of {len(tried)} kinds, {total - len(survivors)} caught ({refused.total()} no rows at all)"
    )
    for survivor in survivors:
        print(*survivor)
    assert set(tried) == set(MUTATORS), "every kind of fault was tried"
    assert total >= 2000
    assert total - len(survivors) >= LEAST * total
    assert not survivors, "a survivor is a hole in the verifier, or a mutator that makes no fault"


@pytest.mark.soak
def test_mutants_of_groups_are_caught(made_export) -> None:
    """One member is broken at a time, the others of its group are sound."""
    rng = np.random.default_rng(2)
    tried, survivors = 0, []
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        relations = relate_scene(scene, Thresholds(), meshes=MeshLibrary(scene.root).world_mesh)
        world = World(scene, {room_id: text_facts(found, Thresholds()) for room_id, found in relations.items()})
        groups = {}
        for row in run.rows:
            groups.setdefault(row.manifest.group_id, []).append(row)
        groups.pop(None, None)
        shapes = Shapes(scene.root)
        for name, mutate in MUTATORS.items():
            rows, broken = [_single(run)], []
            for members in groups.values():
                which = int(rng.integers(len(members)))
                files = Files.of(members[which])
                if not mutate(files, rng, world):
                    continue
                try:
                    mutant = files.row(members[which].split)
                except ValidationError:
                    continue
                broken.append(len(rows) + which)
                rows += [*members[:which], mutant, *members[which + 1 :]]
            certificates = [Certificate(r.manifest.episode_id, "replicacad", run.scene_id, r.split) for r in rows]
            surfaces = partial(made_export.surfaces.get, run.scene_id)
            prove_scene(rows, certificates, scene, surfaces, made_export.folder, made_export.rules, shapes)
            corpus = Corpus()
            for row, certificate in zip(rows[1:], certificates[1:], strict=True):
                corpus.check(row.manifest, row.split, certificate)
            tried += len(broken)
            survivors += [(name, rows[k].manifest.instruction_text) for k in broken if certificates[k].proven]
    print(f"\n{tried} mutants of members of groups")
    assert tried, "the made export has no counterfactual groups"
    assert not survivors
