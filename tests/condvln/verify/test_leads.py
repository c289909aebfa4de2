"""Leads are proven: where they end, what is seen from there, and that subgoals and text have them."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from condvln.verify.certificate import Certificate
from condvln.verify.proof import prove_scene
from condvln.verify.surfaces import Shapes

sys.path.insert(0, str(Path(__file__).parent))
from mutants_of_leads import (
    lead_at_the_wall,
    lead_elsewhere_in_one_leaf,
    lead_nowhere,
    lead_reached_elsewhere,
    lead_to_another_room,
    leave_a_lead_out,
    pass_a_lead_by,
)
from mutation import Files, World


def _faults(made_export, mutate) -> list[set[str]]:
    """The facts that fail for each episode with leads, with one fault in it."""
    found = []
    for run in made_export.runs:
        scene, rng = made_export.scenes[run.scene_id], np.random.default_rng(0)
        mutants = []
        for row in run.rows:
            files = Files.of(row)
            if row.manifest.leads and row.manifest.group_id is None and mutate(files, rng, World(scene, {})):
                mutants.append(files.row(row.split))
        sound = next(row for row in run.rows if row.manifest.group_id is None)
        rows = [sound, *mutants]
        certificates = [Certificate(row.manifest.episode_id, "", run.scene_id, row.split) for row in rows]
        surfaces = partial(made_export.surfaces.get, run.scene_id)
        prove_scene(rows, certificates, scene, surfaces, made_export.folder, made_export.rules, Shapes(scene.root))
        assert certificates[0].proven
        found += [{one.fact for one in certificate.disagreements} for certificate in certificates[1:]]
    return found


@pytest.mark.parametrize(
    ("mutate", "facts"),
    [
        (lead_to_another_room, {"leads", "text_conditions", "text_reading"}),
        (leave_a_lead_out, {"leaf_objects"}),
        (pass_a_lead_by, {"leaf_objects"}),
        (lead_nowhere, {"lead_place"}),
        (lead_elsewhere_in_one_leaf, {"lead_place"}),
        (lead_at_the_wall, {"lead_place"}),
        (lead_reached_elsewhere, {"lead_place"}),
        (lead_nowhere, {"lead_seen"}),
    ],
)
def test_faults_of_leads_are_found(made_export, mutate, facts: set[str]) -> None:
    found = _faults(made_export, mutate)
    assert len(found) > 10
    caught = [bool(facts & its) for its in found]
    # Evidence may be in view from the start too; then the fault is found by the place alone.
    assert sum(caught) > 0.5 * len(found) if facts == {"lead_seen"} else all(caught)


def test_most_programs_over_several_rooms_have_leads(made_export) -> None:
    programs = [row.manifest.program for row in made_export.rows]
    led = [program for program in programs if any(branch.lead is not None for branch in program.branches)]
    assert len(led) > 0.5 * len(programs)
    for row in made_export.rows:
        for leaf in row.manifest.leaves:
            stops = (*(stop.object_id for stop in leaf.subgoals), leaf.object_id)
            assert stops == row.manifest.program.stops(leaf.leaf)
