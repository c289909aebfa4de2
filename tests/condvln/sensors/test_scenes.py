"""Whole scenes: images against rays that are cast through the scene's geometry, which another reader has read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from condvln.samples import make_samples
from condvln.scene import SceneObject
from condvln.scene.scene import STRUCTURE
from condvln.sensors import Renderer, open_renderer
from condvln.sensors.assembly import BOXES, MARGIN, NO_STAGE, NO_WALLS, OWNERS_BY_BOX
from condvln.sensors.camera import camera_pose
from condvln.sensors.renderer import Frame
from condvln.sources.registry import open_source
from condvln.world import World, open_world
from schemas.config import CameraConfig
from tests.condvln.sensors.made_rooms import F64, rays
from tests.condvln.sensors.ray_caster import RayCaster

FAMILIES = ("replicacad", "procthor", "ithor", "robothor", "mp3d")
CAMERA = CameraConfig(width=96, height=72, hfov=79.0)


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, World]:
    root = tmp_path_factory.mktemp("seen")
    found = {}
    for family in FAMILIES:
        make_samples(root / family, family=family, scenes=1, seed=7)
        source = open_source(family, root / family)
        found[family] = open_world(source, source.scene_ids()[0])
    return found


def poses(world: World, count: int, seed: int = 0) -> Iterator[tuple[F64, float]]:
    """Places on the navmesh and headings."""
    rng = np.random.default_rng(seed)
    world.pathfinder.seed(seed)
    for _ in range(count):
        yield world.pathfinder.get_random_navigable_point(), float(rng.uniform(0, 2 * np.pi))


def assert_equal_images(frame: Frame, caster: RayCaster, owners: NDArray[np.integer], eye: F64, rotation: F64) -> None:
    depth, face = caster.first_front(eye, rays(CAMERA, rotation).reshape(-1, 3))
    depth, face = depth.reshape(frame.depth.shape), face.reshape(frame.depth.shape)
    same = np.abs(frame.depth - depth) < 1e-3
    assert same.mean() >= 0.999
    owner = np.where(face >= 0, owners[face], STRUCTURE) + 1
    # Two faces that coincide have one depth and two owners.
    assert (owner == frame.instance)[same].mean() >= 0.999


@pytest.mark.parametrize("family", FAMILIES)
def test_images_are_what_rays_meet(worlds: dict[str, World], family: str) -> None:
    world = worlds[family]
    geometry = world.geometry
    renderer = open_renderer(world.scene, geometry)
    own = renderer.surfaces
    if geometry.approximate:  # boxes that hold things are drawn open
        caster, owners = RayCaster(own.corners + own.origin), own.owner
    else:
        caster, owners = RayCaster(geometry.vertices[geometry.faces]), geometry.owner
    drawn = CAMERA.model_copy(update={"look_down": 12.0})
    seen = 0
    for position, heading in poses(world, 6):
        eye, rotation = camera_pose(drawn, position, heading)
        frame = renderer.look(drawn, position, heading)
        if family == "mp3d":  # the scan names no objects; boxes do
            frame = Frame(frame.rgb, frame.depth, np.zeros_like(frame.instance), frame.label)
        assert_equal_images(frame, caster, owners, eye, rotation)
        seen += int((frame.depth > 0).sum())
    assert seen > 0.5 * 6 * CAMERA.width * CAMERA.height


def test_notes_say_what_is_not_as_it_would_be_seen(worlds: dict[str, World]) -> None:
    def notes(family: str) -> tuple[str, ...]:
        return open_renderer(worlds[family].scene, worlds[family].geometry).notes

    assert notes("replicacad") == ()
    assert notes("procthor") == notes("ithor") == (BOXES,)
    assert notes("mp3d") == (OWNERS_BY_BOX,)


def test_a_scan_s_things_are_told_by_their_boxes(worlds: dict[str, World]) -> None:
    """Every seen pixel of an object is in its box, and most objects are found."""
    world = worlds["mp3d"]
    renderer = open_renderer(world.scene, world.geometry)
    found = set()
    for position, heading in poses(world, 30):
        eye, rotation = camera_pose(CAMERA, position, heading)
        frame = renderer.look(CAMERA, position, heading)
        points = eye + rays(CAMERA, rotation) * frame.depth[..., None]
        for instance in np.unique(frame.instance[frame.instance > 0]):
            item = world.scene.objects[instance - 1]
            found.add(item.object_id)
            away = (points[frame.instance == instance] - item.obb.center) @ item.obb.rotation
            assert (np.abs(away) <= item.obb.half_extents + MARGIN + 1e-4).all()
    assert len(found) > 5


@pytest.mark.parametrize("family", FAMILIES)
def test_nothing_is_nearer_than_the_agent_s_radius(worlds: dict[str, World], family: str) -> None:
    """Where one can stand, the camera is not in a wall: the navmesh and the eyes know one building."""
    world = worlds[family]
    renderer = open_renderer(world.scene, world.geometry)
    camera = CameraConfig(width=16, height=4, hfov=90.0, eye_height=0.5)
    for position, heading in poses(world, 50, seed=3):
        for quarter in range(4):
            frame = renderer.look(camera, position, heading + quarter * np.pi / 2, rgb=False)
            # Depth is along the axis: at 45° it is the distance by the root of 2. A voxel is 0.05 m.
            directions = rays(camera, np.eye(3))
            ground = np.hypot(directions[..., 0], directions[..., 2]) * frame.depth
            assert ground[frame.depth > 0].min(initial=9.0) > world.agent.radius - 0.05


def test_scenes_without_walls_or_stage_say_so(worlds: dict[str, World]) -> None:
    scene = worlds["procthor"].scene
    renderer = open_renderer(scene, None)
    assert renderer.notes == (BOXES, NO_WALLS)
    assert len(renderer.surfaces.corners) > 12
    nothing = open_renderer(replace(scene, rooms=(), objects=()), None)
    assert not nothing.look(CAMERA, [0, 0, 0]).depth.any()
    bare = replace(worlds["replicacad"].scene, stage=())
    assert open_renderer(bare, None).notes == (NO_STAGE,)


@pytest.mark.parametrize(("label", "rests", "is_seen"), [("sofa", 0.5, True), ("dining table", 0.0, False)])
def test_what_is_on_a_seat_is_seen_from_above_and_what_is_under_a_table_is_not(
    worlds: dict[str, World], label: str, rests: float, is_seen: bool
) -> None:
    """Both are inside the box, which a sofa's back or a table's top makes higher than the thing."""
    scene = worlds["procthor"].scene
    room = scene.rooms[0]
    centre = np.array([0.0, room.floor_y, 0.0])

    def thing(name: str, word: str, bottom: float, half: float, top: float) -> SceneObject:
        low, high = centre + np.array([-half, bottom, -half]), centre + np.array([half, top, half])
        box = np.array([low, high])
        return replace(scene.objects[0], object_id=name, label=word, center=box.mean(axis=0), aabb=box, obb=None,
                       room_id=room.room_id)  # fmt: skip

    things = (thing("a", label, 0.0, 0.8, 1.0), thing("b", "book", rests, 0.1, rests + 0.1))
    renderer = open_renderer(replace(scene, objects=things), None)
    down = CAMERA.model_copy(update={"look_down": 60.0})
    frame = renderer.look(down, centre + np.array([0.0, 0.0, 0.9]))
    assert bool((frame.instance == 2).any()) == is_seen
    assert (frame.instance == 1).any()


@pytest.mark.parametrize(("deep", "is_seen"), [(0.25, True), (0.02, False)])
def test_what_is_partly_in_a_larger_box_is_seen_through_it(
    worlds: dict[str, World], deep: float, is_seen: bool
) -> None:
    """A book stands behind a plant, partly within its box: lines of sight to that part are free, so it has pixels."""
    scene = worlds["procthor"].scene
    room = scene.rooms[0]
    centre = np.array([0.0, room.floor_y, 0.0])

    def thing(name: str, word: str, middle: F64, size: F64) -> SceneObject:
        box = np.array([middle - size / 2, middle + size / 2])
        return replace(scene.objects[0], object_id=name, label=word, center=middle, aabb=box, obb=None, hidden=False,
                       room_id=room.room_id)  # fmt: skip

    size = np.array([0.3, 0.3, 0.2])
    plant = thing("a", "plant", centre + np.array([0.0, 1.25, 0.0]), np.array([0.6, 0.6, 0.6]))
    book = thing("b", "book", centre + np.array([0.0, 1.25, -0.3 - size[2] * (0.5 - deep)]), size)
    frame = open_renderer(replace(scene, objects=(plant, book)), None).look(CAMERA, centre + np.array([0.0, 0.0, 2.0]))
    assert (frame.instance == 1).any()
    assert bool((frame.instance == 2).any()) == is_seen


def test_equal_scenes_give_equal_images(worlds: dict[str, World], tmp_path: Path) -> None:
    world = worlds["replicacad"]
    one, other = (open_renderer(world.scene, world.geometry) for _ in range(2))
    for position, heading in poses(world, 3):
        first, second = (r.look(CAMERA, position, heading) for r in (one, other))
        assert (first.rgb == second.rgb).all()
        assert (first.instance == second.instance).all()
    assert isinstance(one, Renderer)
