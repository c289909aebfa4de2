"""The navmesh and the cameras agree: nobody stands inside of what is seen, and evidence in view has pixels."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.samples import make_samples
from condvln.scene import Scene
from condvln.sensors.camera import pixel_rays
from condvln.sources.registry import open_source
from condvln.world import World, label_priors, open_world
from schemas.config import AgentConfig, CameraConfig, InstructionsConfig
from schemas.program import CATEGORIES

pytestmark = pytest.mark.soak

AGENT = AgentConfig()
VOXEL = 0.05
FAMILIES = ("procthor", "replicacad")
SCENES = 3
POINTS = 1000


def cameras(pixels: int, *pitches: float) -> list[CameraConfig]:
    """Cameras that see all around, level or looking down by some angles in degrees."""
    return [
        CameraConfig(width=pixels, height=pixels, hfov=90, turn=turn, look_down=pitch, max_depth=None, normalized=False)
        for pitch in pitches or (0.0,)
        for turn in (0.0, 90.0, 180.0, -90.0)
    ]


@pytest.fixture(scope="module", params=FAMILIES)
def worlds(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[World]:
    folder = tmp_path_factory.mktemp("walkable")
    make_samples(folder, family=request.param, scenes=SCENES, seed=5)
    source = open_source(request.param, folder)
    return [open_world(source, name) for name in source.scene_ids()]


def test_nothing_is_seen_nearer_than_the_agents_radius(worlds: list[World]) -> None:
    views = cameras(64)
    rays = [pixel_rays(view) for view in views]
    nearest = []
    for world in worlds:
        world.pathfinder.seed(1)
        for _ in range(POINTS // (len(FAMILIES) * len(worlds))):
            place = np.asarray(world.pathfinder.get_random_navigable_point(), np.float64)
            for view, (columns, rows) in zip(views, rays, strict=True):
                depth = world.renderer.look(view, place, rgb=False).depth.astype(np.float64)
                height = view.eye_height + rows[:, None] * depth
                away = depth * np.hypot(columns, 1.0)
                seen = (depth > 0) & (height > AGENT.max_climb) & (height < AGENT.height)
                nearest.append(float(away[seen].min(initial=np.inf)))
    assert min(nearest) >= AGENT.radius - VOXEL


def test_evidence_in_view_has_pixels(worlds: list[World]) -> None:
    scenes: list[Scene] = [world.scene for world in worlds]
    priors = label_priors(scenes)
    wanted = InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 6), counterfactual_groups=0)
    found = []
    for world in worlds:
        number = {item.object_id: k + 1 for k, item in enumerate(world.scene.objects)}
        for row in world.episodes(instructions=wanted, priors=priors):
            heading = 2 * float(np.arctan2(row.start_rotation[1], row.start_rotation[3]))
            for evidence in row.evidence or ():
                condition = row.program.conditions[evidence.condition]
                if evidence.observability != "O0" or not condition.truth:
                    continue
                shown = {
                    int(k)
                    for view in cameras(256, 0.0, 60.0, -60.0)
                    for k in np.unique(world.renderer.look(view, row.start_position, heading, rgb=False).instance)
                }
                found.append(any(number[name] in shown for name in condition.witnesses))
    # A level camera of 90° misses what lies steeper than 45° below it, such as a book on a table beside the agent.
    assert len(found) >= 8
    assert all(found)
