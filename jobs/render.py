"""``condvln render``: images of a scene from a pose, or of an episode along its gold path."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from condvln.arrays import F64
from condvln.formats.streams import write_file
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, Follower
from condvln.sensors import cameras_of
from condvln.sensors.renderer import clip_gif, coloured_depth, coloured_instances, contact_sheet, png
from condvln.world import World, open_world
from jobs.compose import found_scene, refuse_export
from jobs.report import Report
from jobs.show import named_rows, world_of
from jobs.workspace import published
from schemas.config import CameraConfig, Config
from schemas.errors import UsageError

__all__ = ["ACTIONS", "render"]

Cameras = Mapping[str, CameraConfig]

ACTIONS: Final = {STOP: "stop", FORWARD: "forward", LEFT: "left", RIGHT: "right"}
SHEET: Final = 24
"""Most steps of an episode on a contact sheet; the first and the last are among them."""
LINE: Final = 150
"""Characters per line of text on a contact sheet."""
QUARTERS: Final = ((0.0, "north"), (90.0, "east"), (180.0, "south"), (270.0, "west"))


@dataclass(frozen=True, eq=False, slots=True)
class _Shots:
    """Poses to draw: feet (n, 3) metres, headings (n,) in radians counter-clockwise from −Z, and a caption for each."""

    world: World
    positions: F64
    headings: F64
    captions: Sequence[str]
    text: str


def render(
    config: Config,
    name: str,
    out: Path,
    *,
    camera: str = "streamvln",
    position: tuple[float, float, float] | None = None,
    heading: float | None = None,
) -> Report:
    """Draw a scene, or an episode of the published snapshot, and write it to `out`.

    Parameters
    ----------
    name : a scene as in the tables, with ``<family>/`` before it where several sources have one of that name; or the
        id of an episode, or its beginning
    out : ``.png`` for one sheet, ``.gif`` for a clip, else a folder with a PNG file of each camera and pose: colours,
        depth in millimetres, instance numbers
    camera : a preset of `condvln.sensors`
    position : metres, where the camera's agent stands in a scene; a place that can be stood on is drawn where None
    heading : degrees clockwise from north; the four quarters where None

    Raises
    ------
    UsageError : nothing has that name, an unknown preset, a pose for an episode, or `out` lies in the export
    InputError : the scene can't be read
    """
    if out.suffix not in ("", ".png", ".gif"):
        raise UsageError(f"{out} is neither .png nor .gif nor a folder", place="OUT", remedy="Change its suffix.")
    refuse_export(config.export, out.parent if out.suffix else out)
    cameras = cameras_of(camera)
    try:
        source, scene_id = found_scene(config, name)
    except UsageError as missing:
        shots = _episode(config, name, missing)
        if position is not None or heading is not None:
            raise UsageError(
                "no pose can be given for an episode", place="--position", remedy="Name a scene, or leave the pose out."
            ) from None
    else:
        shots = _scene(open_world(source, scene_id, config.agent), config.seed, position, heading)
    written = _write(out, cameras, shots)
    scene = shots.world.scene
    document: dict[str, Any] = {
        "scene": f"{scene.family}/{scene.scene_id}",
        "camera": camera,
        "poses": len(shots.positions),
        "files": [str(path) for path in written],
        "notes": list(shots.world.renderer.notes),
    }
    shown = f"{len(written)} files in {out}" if len(written) > 1 else str(written[0])
    lines = [f"{document['scene']}, {len(shots.positions)} poses: {shown}", *shots.world.renderer.notes]
    return Report(document, lines)


def _scene(world: World, seed: int, position: tuple[float, float, float] | None, heading: float | None) -> _Shots:
    if position is None:
        world.pathfinder.seed(seed)
        place = np.asarray(world.pathfinder.get_random_navigable_point(), np.float64)
    else:
        place = np.array(position, np.float64)
    asked = QUARTERS if heading is None else ((heading, f"{heading:g}°"),)
    x, y, z = place
    return _Shots(
        world,
        np.tile(place, (len(asked), 1)),
        np.array([-math.radians(degrees) for degrees, _ in asked]),
        [f"facing {name}" for _, name in asked],
        f"{world.scene.family}/{world.scene.scene_id} at ({x:.2f}, {y:.2f}, {z:.2f})",
    )


def _episode(config: Config, name: str, missing: UsageError) -> _Shots:
    snapshot = published(config)
    rows = [row for row in named_rows(snapshot, name) if row["episode_id"] is not None]
    if len(rows) != 1:
        what = str(missing.what) if not rows else f"{len(rows)} episodes begin with {name!r}"
        what += ", and no episode id begins with it" if not rows else ""
        raise UsageError(what, place="SCENE|EPISODE", remedy="condvln show CONFIG --sample 5 lists some episodes.")
    (row,) = rows
    world = world_of(config, row)
    leaf = next(leaf for leaf in row["leaves"] if leaf["leaf"] == row["gold_leaf"])
    stops = [_point(subgoal["position"]) for subgoal in leaf["subgoals"]] + [_point(leaf["goals"][0])]
    start, heading = _point(row["start_position"]), -math.radians(row["start_heading_degrees"])
    follower = Follower(world.pathfinder)
    actions = follower.follow(start, heading, stops).actions
    walk = follower.walk(start, heading, actions)
    return _Shots(
        world,
        walk.positions[: len(actions)].astype(np.float64),
        walk.headings[: len(actions)],
        [f"{step}: {ACTIONS[int(action)]}" for step, action in enumerate(actions)],
        str(row["instruction_text"]),
    )


def _point(value: Mapping[str, float]) -> list[float]:
    return [value["x"], value["y"], value["z"]]


def _write(out: Path, cameras: Cameras, shots: _Shots) -> list[Path]:
    if not out.suffix:
        return _folder(out, cameras, shots)
    renderer = shots.world.renderer
    views = [camera for name, camera in cameras.items() if name.startswith("rgb")]
    if out.suffix == ".gif":
        frames = [
            renderer.look(views[0], place, heading).rgb
            for place, heading in zip(shots.positions, shots.headings, strict=True)
        ]
        return [write_file(out, clip_gif(frames))]
    pictures, captions = [], []
    count = len(shots.positions)
    for number in np.unique(np.linspace(0, count - 1, min(count, SHEET)).round().astype(int)):
        for camera in views if count <= len(QUARTERS) else views[:1]:
            frame = renderer.look(camera, shots.positions[number], float(shots.headings[number]))
            pictures.append(frame.rgb)
            captions.append(shots.captions[number])
            if len(views) == 1 and count <= len(QUARTERS):
                pictures += [coloured_depth(frame.depth), coloured_instances(frame.instance)]
                captions += ["depth, white from 6 m", "instances"]
    columns = 12 if len(views) > 4 else 3 if count <= len(QUARTERS) and len(views) == 1 else 4
    heading = textwrap.wrap(shots.text, LINE)
    return [write_file(out, contact_sheet(pictures, captions, columns, heading))]


def _folder(out: Path, cameras: Cameras, shots: _Shots) -> list[Path]:
    """Write a PNG file for each pose and camera, and for a depth camera another PNG file with instance numbers; return
    the paths.
    """
    renderer = shots.world.renderer
    written: list[Path] = []
    digits = max(3, len(str(len(shots.positions))))
    for number, (place, heading) in enumerate(zip(shots.positions, shots.headings, strict=True)):
        for name, camera in cameras.items():
            if name.startswith("rgb"):
                frame = renderer.look(camera, place, float(heading))
                written.append(write_file(out / f"{number:0{digits}d}_{name}.png", png(frame.rgb)))
            else:
                frame = renderer.look(camera, place, float(heading), rgb=False)
                written.append(write_file(out / f"{number:0{digits}d}_{name}.png", png(frame.depth)))
                own = name.replace("depth", "instance", 1)
                written.append(write_file(out / f"{number:0{digits}d}_{own}.png", png(frame.instance)))
    return written
