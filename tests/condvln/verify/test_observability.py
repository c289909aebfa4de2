"""What is told to be visible is refuted where the scene hides it, and where it does not."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np

from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.verify.certificate import Certificate
from condvln.verify.files import Row
from condvln.verify.proof import prove_scene
from condvln.verify.surfaces import Shapes
from tests.condvln.episodes.floors import box_triangles, surfaces_of

SIGHT = {"surfaces", "observability", "first_view"}


def proven(made_export, run, rows: list[Row], geometry) -> list[Certificate]:
    scene = made_export.scenes[run.scene_id]
    certificates = [Certificate(r.manifest.episode_id, run.source, run.scene_id, r.split) for r in rows]
    rules, shapes = made_export.rules, Shapes(scene.root)
    prove_scene(rows, certificates, scene, lambda: geometry, made_export.folder, rules, shapes)
    return certificates


def refuted(certificate: Certificate) -> set[str]:
    return SIGHT & {d.fact for d in certificate.disagreements}


def changed(row: Row, **changes: object) -> Row:
    return dataclasses.replace(row, manifest=row.manifest.model_copy(update=changes))


def only(*boxes: tuple[np.ndarray, np.ndarray]) -> SceneGeometry:
    """Exact surfaces of these boxes (low, high), and of nothing else."""
    return surfaces_of([(STRUCTURE, box_triangles(low, high)) for low, high in boxes])


def test_among_other_walls_other_things_are_seen(made_export) -> None:
    opened = shut = 0
    for run in made_export.runs[:8]:
        rows = list(run.rows)
        far = np.array([500.0, 0.0, 500.0])
        nothing = proven(made_export, run, rows, only((far, far + 1.0)))
        # A shell about everybody's head: 2 cm wide, from the start's eye.
        eyes = [np.array(row.manifest.start_position) + np.array([0.0, 1.25, 0.0]) for row in rows]
        blind = proven(made_export, run, rows, only(*((eye - 0.02, eye + 0.02) for eye in eyes)))
        for row, free, masked in zip(rows, nothing, blind, strict=True):
            levels = [evidence.observability for evidence in row.manifest.evidence]
            assert "surfaces" not in refuted(free) | refuted(masked)
            # Nothing hides, so no level is worse than it was; nothing is seen from the start, so none is the best.
            if levels.count("O0") == len(levels):
                assert "observability" not in refuted(free)
            if "O0" in levels:
                assert "observability" in refuted(masked)
                shut += 1
            opened += "observability" in refuted(free)
    assert opened >= 10
    assert shut >= 5


def test_stops_from_which_nothing_is_seen_are_refuted(made_export) -> None:
    """A shell about the head of everybody who stops: every episode leads to a stop that is not recognised."""
    run = made_export.runs[0]
    rows = list(run.rows)[:12]
    places = {goal for row in rows for leaf in row.manifest.leaves for goal in leaf.goals}
    eyes = [np.array(place) + np.array([0.0, 1.25, 0.0]) for place in sorted(places)]
    for blind, certificates in (
        (False, proven(made_export, run, rows, made_export.surfaces[run.scene_id])),
        (True, proven(made_export, run, rows, only(*((eye - 0.02, eye + 0.02) for eye in eyes)))),
    ):
        for row, certificate in zip(rows, certificates, strict=True):
            named = [d.found for d in certificate.disagreements if d.fact == "stop_seen"]
            assert len(named) == blind
            assert not blind or {leaf.object_id for leaf in row.manifest.leaves} <= {*named[0]}


def test_both_numbers_are_told(made_export) -> None:
    run, row = next(
        (run, r)
        for run in made_export.runs
        for r in run.rows
        if r.manifest.observability == "O2" and r.manifest.group_id is None
    )
    evidence = tuple(e.model_copy(update={"observability": "O0"}) for e in row.manifest.evidence)
    (certificate,) = proven(
        made_export,
        run,
        [changed(row, evidence=evidence, observability="O0")],
        made_export.surfaces[run.scene_id],
    )
    wrong = [d for d in certificate.disagreements if d.fact == "observability"]
    worse = [e for e in row.manifest.evidence if e.observability != "O0"]
    assert [(d.claimed, d.found["level"], d.place) for d in wrong] == [
        ("O0", e.observability, f"condition {e.condition}") for e in worse
    ]
    for disagreement in wrong:
        shares = {name: found for name, found in disagreement.found.items() if name != "level"}
        assert shares
        assert all(name.startswith(("thing ", "floor ")) for name in shares)
        assert all(0.0 <= share <= 1.0 for found in shares.values() for share in found)


def test_without_the_surfaces_that_an_episode_rests_on_nothing_is_taken_on_trust(made_export) -> None:
    run = made_export.runs[0]
    for certificate in proven(made_export, run, run.rows, None):
        assert refuted(certificate) == {"surfaces"}


def test_rows_that_say_nothing_of_it_are_held_to_no_level(made_export) -> None:
    run = made_export.runs[0]
    nothing = dict.fromkeys(("observability", "evidence_in_view", "observability_approximate"))
    silent = [
        dataclasses.replace(
            changed(row, evidence=None, **nothing),
            record={**row.record, "info": {**row.record["info"], **nothing}},
            looking_record={**row.looking_record, "info": {**row.looking_record["info"], **nothing}},
        )
        for row in run.rows
    ]
    scene = made_export.scenes[run.scene_id]
    certificates = [Certificate(r.manifest.episode_id, run.source, run.scene_id, r.split) for r in silent]
    surfaces = partial(made_export.surfaces.get, run.scene_id)
    prove_scene(silent, certificates, scene, surfaces, made_export.folder, made_export.rules, Shapes(scene.root))
    assert all(certificate.proven and not SIGHT & {*certificate.checked} for certificate in certificates)


def test_a_row_whose_ways_are_refuted_is_not_asked_what_it_sees(made_export) -> None:
    """A hostile path of a million kilometres would be compared every 5 cm."""
    run = made_export.runs[0]
    row = run.rows[0]
    far = tuple(
        leaf.model_copy(update={"reference_path": (leaf.reference_path[0], (1e9, 0.0, 0.0), *leaf.reference_path[1:])})
        for leaf in row.manifest.leaves
    )
    (certificate,) = proven(made_export, run, [changed(row, leaves=far)], made_export.surfaces[run.scene_id])
    assert not certificate.proven
    assert not SIGHT & {*certificate.checked}


def test_what_the_scene_does_not_have_is_never_seen(made_export) -> None:
    run = made_export.runs[0]
    row = next(r for r in run.rows if r.manifest.evidence[0].observability != "O2")
    program = row.manifest.program
    gone = tuple(
        condition.model_copy(
            update={
                "witnesses": tuple("nowhere" for _ in condition.witnesses),
                "room": condition.room.model_copy(update={"room_id": "nowhere"}),
            }
        )
        for condition in program.conditions
    )
    mutant = changed(row, program=program.model_copy(update={"conditions": gone}))
    (certificate,) = proven(made_export, run, [mutant], made_export.surfaces[run.scene_id])
    assert "observability" in refuted(certificate)


def test_presence_that_nobody_can_deny_is_refuted_with_either_truth(made_export) -> None:
    """A pen is never recognised on the floor: nobody can see that there is none."""
    asked = 0
    for run in made_export.runs:
        for row in run.rows:
            conditions = row.manifest.program.conditions
            k = next((k for k, one in enumerate(conditions) if one.qualifier is None), None)
            if k is None:
                continue
            asked += 1
            pen = conditions[k].model_copy(update={"label": "pen"})
            program = row.manifest.program.model_copy(
                update={"conditions": (*conditions[:k], pen, *conditions[k + 1 :])}
            )
            surfaces = made_export.surfaces[run.scene_id]
            sound, changed_one = proven(made_export, run, [row, changed(row, program=program)], surfaces)
            assert "absence_seen" not in {d.fact for d in sound.disagreements}
            assert [d.place for d in changed_one.disagreements if d.fact == "absence_seen"] == [f"condition {k}"]
            break
    assert asked > 2


def test_a_relation_of_what_is_not_there_is_refuted_as_its_absence_is(made_export) -> None:
    """ "A pen near the sink" is false where there is no pen, which nobody can see. Of a true one nothing is asked."""
    asked = 0
    for run in made_export.runs:
        for row in run.rows:
            conditions = row.manifest.program.conditions
            k = next((k for k, one in enumerate(conditions) if one.qualifier is not None and not one.is_bearing), None)
            if k is None:
                continue
            asked += 1
            surfaces = made_export.surfaces[run.scene_id]
            for truth in (False, True):
                said = {"label": "pen", "definite": False, "truth": truth, "witnesses": ("pen",) * truth}
                pen = conditions[k].model_copy(update=said)
                changes = {"conditions": (*conditions[:k], pen, *conditions[k + 1 :])}
                program = row.manifest.program.model_copy(update=changes)
                (found,) = proven(made_export, run, [changed(row, program=program)], surfaces)
                places = [d.place for d in found.disagreements if d.fact == "absence_seen"]
                assert places == ([] if truth else [f"condition {k}"])
            break
    assert asked > 2
