"""Routes that no person would give are refuted: back into a room, too many stops, long detours."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from condvln.navigation.pathfinder import Pathfinder
from condvln.verify.certificate import Certificate
from condvln.verify.program_check import check_program
from condvln.verify.proof import prove_scene
from condvln.verify.surfaces import Shapes
from schemas.evaluation import ManifestEpisode
from schemas.program import ObjectRef


def refuted(row: ManifestEpisode, fact: str, leaf: int, moves: tuple[ObjectRef, ...]) -> list[str]:
    """Where a fact does not hold, of a row whose leaf has these stops."""
    leaves = list(row.program.leaves)
    leaves[leaf] = leaves[leaf].model_copy(update={"moves": moves})
    certificate = Certificate(row.episode_id, row.source, row.scene_id, row.split)
    check_program(
        row.model_copy(update={"program": row.program.model_copy(update={"leaves": tuple(leaves)})}), certificate
    )
    return [d.place for d in certificate.disagreements if d.fact == fact]


def test_a_leaf_that_comes_back_to_a_room_is_refuted(made_export) -> None:
    tried = 0
    for row in (row.manifest for row in made_export.rows):
        stops = {move.room.room_id: move for leaf in row.program.leaves for move in leaf.moves}
        if len(stops) < 2:
            continue
        one, other = list(stops.values())[:2]
        assert refuted(row, "room_order", 1, (one, other, one)) == ["leaf 1"]
        assert refuted(row, "room_order", 0, (one, one, other)) == []
        assert refuted(row, "room_order", 0, (one, other, other)) == []
        tried += 1
    assert tried > 20


def test_three_moves_beside_four_leaves_are_refuted(made_export) -> None:
    for row in (row.manifest for row in made_export.rows):
        stop = row.program.leaves[0].goal
        expected = ["leaf 1"] if len(row.program.leaves) == 4 else []
        assert refuted(row, "most_moves", 1, (stop,) * 3) == expected
        assert refuted(row, "most_moves", 1, (stop,) * 2) == []


def test_two_rooms_of_a_type_and_two_conditions_of_a_label_are_refuted(made_export) -> None:
    tried = 0
    for row in (row.manifest for row in made_export.rows):
        first, *others = row.program.conditions
        for k, other in enumerate(others, start=1):
            if other.room.room_id == first.room.room_id:
                continue
            for fact, update in (
                ("room_types", {"room": other.room.model_copy(update={"label": first.room.label})}),
                ("labels_apart", {"label": first.label}),
            ):
                conditions = [*row.program.conditions]
                conditions[k] = other.model_copy(update=update)
                program = row.program.model_copy(update={"conditions": tuple(conditions)})
                for changed in (False, True):
                    certificate = Certificate(row.episode_id, row.source, row.scene_id, row.split)
                    check_program(row.model_copy(update={"program": program}) if changed else row, certificate)
                    assert (fact in {d.fact for d in certificate.disagreements}) == changed, (fact, changed)
                tried += 1
    assert tried > 20


@pytest.mark.parametrize(("factor", "slack"), [(1.0, 0.0), (1.2, 0.5)])
def test_detours_are_found_leaf_by_leaf(made_export, factor: float, slack: float) -> None:
    """Under a tighter bound than that of the export, just the leaves beyond it are refuted."""
    rules = made_export.rules
    episodes = rules.episodes.model_copy(update={"detour_factor": factor, "detour_slack": slack})
    run = made_export.runs[0]
    scene = made_export.scenes[run.scene_id]
    assert not scene.single_room
    rows = [row for row in run.rows if row.manifest.group_id is None][:8]
    certificates = [Certificate(r.manifest.episode_id, "replicacad", run.scene_id, r.split) for r in rows]
    prove_scene(
        rows,
        certificates,
        scene,
        lambda: made_export.surfaces[run.scene_id],
        made_export.folder,
        replace(rules, episodes=episodes),
        Shapes(scene.root),
    )
    pathfinder, beyond = Pathfinder.load(scene.root / scene.navmesh.path), 0
    for row, certificate in zip(rows, certificates, strict=True):
        expected = []
        for k, leaf in enumerate(row.manifest.leaves):
            ends = [stop.position for stop in leaf.subgoals[: len(row.manifest.program.leads(k))]]
            places = [row.manifest.start_position, *ends]
            legs = sum(pathfinder.geodesic_distance(*leg) for leg in pairwise(places))
            shortest = legs + min(pathfinder.geodesic_distance(places[-1], goal) for goal in leaf.goals)
            if leaf.route_length > factor * shortest + slack + 0.001:
                expected.append(f"leaf {k}")
        assert [d.place for d in certificate.disagreements] == expected
        assert all(d.fact == "detour" for d in certificate.disagreements)
        beyond += len(expected)
    assert beyond
