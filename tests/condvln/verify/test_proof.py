"""Whole proofs: everything made is proven, a moved object is not, and the command tells both numbers."""

from __future__ import annotations

import dataclasses
import re
import shutil
from functools import partial
from itertools import permutations
from pathlib import Path

import numpy as np
import orjson
import pytest

from condvln import verify
from condvln.episodes.footprint import Footprint
from condvln.episodes.goals import blocked_footprints
from condvln.export.contents import CERTIFICATES, SUMMARY
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import OrientedBox, Scene, SceneObject
from condvln.verify.certificate import FACTS, Certificate
from condvln.verify.footprints import Ground, Obstacles
from condvln.verify.proof import find_navmesh, prove_scene
from condvln.verify.surfaces import Shapes
from jobs.verify import verify_export
from schemas.errors import MissingFileError, PathEscapeError


def prove(made_export, run, scene: Scene) -> list[Certificate]:
    certificates = [Certificate(r.manifest.episode_id, run.source, run.scene_id, r.split) for r in run.rows]
    surfaces = partial(made_export.surfaces.get, run.scene_id)
    prove_scene(run.rows, certificates, scene, surfaces, made_export.folder, made_export.rules, Shapes(scene.root))
    return certificates


def moved(item: SceneObject, by: np.ndarray) -> SceneObject:
    obb = item.obb
    return dataclasses.replace(
        item,
        center=item.center + by,
        aabb=None if item.aabb is None else item.aabb + by,
        obb=None if obb is None else OrientedBox(obb.center + by, obb.half_extents, obb.rotation),
    )


@pytest.mark.parametrize("most_goals", [2, pytest.param(4, marks=pytest.mark.soak)])
def test_an_object_moved_in_the_source_refutes_every_episode_that_goes_to_it(made_export, most_goals: int) -> None:
    rng = np.random.default_rng(0)
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        goals = sorted({leaf.object_id for row in run.rows for leaf in row.manifest.leaves})
        for name in goals[:most_goals]:
            angle = rng.uniform(0, 2 * np.pi)
            by = np.round([2 * np.cos(angle), 0, 2 * np.sin(angle)], 3)
            objects = tuple(moved(o, by) if o.object_id == name else o for o in scene.objects)
            certificates = prove(made_export, run, dataclasses.replace(scene, objects=objects))
            for row, certificate in zip(run.rows, certificates, strict=True):
                if any(leaf.object_id == name for leaf in row.manifest.leaves):
                    assert not certificate.proven


def test_a_group_that_lacks_a_member_is_refuted(made_export) -> None:
    run = next(run for run in made_export.runs if any(row.manifest.group_id for row in run.rows))
    gone = next(row for row in run.rows if row.manifest.group_id)
    left = dataclasses.replace(run, rows=[row for row in run.rows if row is not gone])
    for row, certificate in zip(left.rows, prove(made_export, left, made_export.scenes[run.scene_id]), strict=True):
        of_group = row.manifest.group_id == gone.manifest.group_id
        assert ("group" in {d.fact for d in certificate.disagreements}) == of_group


def test_obstacles_and_grounds_are_those_of_the_generator(made_export) -> None:
    rng = np.random.default_rng(1)
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        pathfinder = Pathfinder.load(scene.root / scene.navmesh.path)
        theirs = {item.object_id for item, _ in blocked_footprints(scene, pathfinder, 0.2)}
        assert {*Obstacles(scene, pathfinder, 0.2).object_ids} == theirs
        points = rng.uniform(-6, 6, (50, 3))
        for item in scene.objects:
            box = Footprint.of(item)
            if box is not None:
                np.testing.assert_allclose(Ground(item).distances(points), box.distance(points), atol=1e-9)
                assert Ground(item).half_round == pytest.approx(box.half_perimeter)


@pytest.mark.parametrize("forwards", [True, False])
def test_leaves_are_apart_in_both_directions(made_export, monkeypatch: pytest.MonkeyPatch, forwards: bool) -> None:
    """Paths that are a fifth as long in one direction bring leaves together, whichever leaf comes first."""
    plain = Pathfinder.geodesic_distances

    def shorter(self: Pathfinder, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        metres = plain(self, starts, ends)
        return np.where((starts[:, 0] < ends[:, 0]) == forwards, metres / 5, metres)

    monkeypatch.setattr(Pathfinder, "geodesic_distances", shorter)
    close = 0
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        pathfinder = Pathfinder.load(scene.root / scene.navmesh.path)
        for row, certificate in zip(run.rows, prove(made_export, run, scene), strict=True):
            separation = 2 * row.manifest.success_distance + 0.5
            lines = [np.inf]
            for one, other in permutations(row.manifest.leaves, 2):
                pairs = np.array([(a, b) for a in one.goals for b in other.goals])
                near = shorter(pathfinder, pairs[:, 0], pairs[:, 1]) < separation
                lines.extend(np.linalg.norm(pairs[near, 0] - pairs[near, 1], axis=1))
            # Goals that are farther apart in a straight line can't be nearer along a path: they are not looked at.
            refuted = "leaves_apart" in {disagreement.fact for disagreement in certificate.disagreements}
            assert (min(lines) < separation) <= refuted <= (min(lines) < separation + 0.15)
            close += refuted
    assert close


def test_a_navmesh_outside_of_the_export_is_refused(made_export) -> None:
    scene = next(iter(made_export.scenes.values()))
    for path in ("../elsewhere.navmesh", "/etc/passwd"):
        with pytest.raises(PathEscapeError):
            find_navmesh(scene, made_export.folder, path)
    with pytest.raises(MissingFileError):
        find_navmesh(dataclasses.replace(scene, navmesh=None), made_export.folder, "none.navmesh")


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.fixture
def export(made_export, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made_export.folder, tmp_path / "export"))


def certificates_in(export: Path) -> list[dict]:
    paths = sorted((export / CERTIFICATES).glob("*.jsonl"))
    return [orjson.loads(line) for path in paths for line in path.read_bytes().splitlines()]


def test_a_sound_export_has_a_certificate_of_each_episode(made_export, export: Path) -> None:
    report = verify_export(made_export.config, export)
    assert report.exit_code == 0
    found = certificates_in(export)
    assert sorted(c["episode_id"] for c in found) == sorted(row.manifest.episode_id for row in made_export.rows)
    assert all(c["proven"] and not c["disagreements"] and {*c["checked"]} <= {*FACTS} for c in found)
    summary = orjson.loads((export / CERTIFICATES / SUMMARY).read_bytes())
    assert summary["episodes"] == summary["proven"] == len(found)
    again = verify_export(made_export.config, export)
    assert again.document == report.document


def test_a_wrong_fact_is_told_with_both_numbers_and_exit_code_3(made_export, export: Path) -> None:
    split = next(p.stem for p in sorted((export / "manifest").glob("*.jsonl")) if p.stat().st_size)
    path = export / "manifest" / f"{split}.jsonl"
    rows = [orjson.loads(line) for line in path.read_bytes().splitlines()]
    true = rows[0]["leaves"][0]["geodesic_distance"]
    rows[0]["leaves"][0]["geodesic_distance"] = true + 0.5
    path.write_bytes(b"".join(orjson.dumps(row) + b"\n" for row in rows))
    report = verify_export(made_export.config, export)
    assert report.exit_code == 3
    (line,) = [line for line in report.lines if "geodesic_distance of leaf 0" in line]
    assert str(rows[0]["episode_id"]) in line
    assert f"the files say {true + 0.5}, found {true}" in line
    (broken,) = [c for c in certificates_in(export) if not c["proven"]]
    assert {"fact": "geodesic_distance", "place": "leaf 0", "claimed": true + 0.5, "found": true} in broken[
        "disagreements"
    ]


def test_a_scene_that_is_gone_proves_nothing_and_the_others_are_proven(
    made_export, export: Path, tmp_path: Path
) -> None:
    source = made_export.config.sources[0]
    root = Path(shutil.copytree(source.root, tmp_path / "scenes"))
    gone = made_export.runs[0].scene_id
    for path in root.rglob(f"{gone}.scene_instance.json"):
        path.unlink()
    config = made_export.config.model_copy(update={"sources": (source.model_copy(update={"root": root}),)})
    report = verify_export(config, export)
    assert report.exit_code == 3
    for certificate in certificates_in(export):
        facts = {d["fact"] for d in certificate["disagreements"]}
        assert facts == ({"readable"} if certificate["scene_id"] == gone else set())


def test_every_fault_of_a_phrase_is_a_fact() -> None:
    """A certificate takes no other name: a fault without one would stop the proof of its whole scene."""
    folder = Path(verify.__file__).parent
    named = {name for file in folder.glob("*.py") for name in re.findall(r'Problem\(\s*"(\w+)"', file.read_text())}
    assert len(named) > 10
    assert named <= {*FACTS}
