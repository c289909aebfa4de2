"""Prove a folder of trajectories: replayed actions give the stored poses, walks end at their goals, and images show
what is visible from the poses.

The tables are read again and compared with the export's manifest, its navmeshes and the scenes. Walks are not planned
again: what is proven is that each one is a walk of its episode.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.image_files import encoders, jpeg, png16
from condvln.formats.regular_file import read_regular
from condvln.navigation.follower import STOP, ActionSpace, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.sensors import Renderer
from condvln.verify.layouts import DAMAGED, HUBS, WriteLayout, meaning_of, prove_layouts
from condvln.verify.trajectory_files import read_annotations, read_record, read_table, walks_with_poses
from schemas.base import Row
from schemas.config import CameraConfig
from schemas.evaluation import ManifestEpisode

__all__ = ["TrajectoryFault", "TrajectoryProof", "TrajectoryWorld", "prove_trajectories"]


_CAMERA: Final = ("width", "height", "hfov", "eye_height", "look_down")
_ANGLE: Final = 1e-9
"""Largest difference in a component of two equal rotations."""


@dataclass(frozen=True)
class TrajectoryFault:
    """What is wrong with a walk, or with the whole folder if `trajectory` is empty."""

    trajectory: str
    what: str

    def __str__(self) -> str:
        return f"{self.trajectory}: {self.what}" if self.trajectory else self.what


@dataclass(frozen=True)
class TrajectoryWorld:
    """What a folder's walks are compared with: the published episodes, and each scene's navmesh and images.

    episodes : the manifest's rows of the split, by episode id
    text : the instruction that a kind of walk of an episode has
    pathfinder, renderer : of an episode's scene
    write_layout : writes a layout once more
    render_every : of how many images one is rendered again; 0 for none
    """

    episodes: Mapping[int, ManifestEpisode]
    text: Callable[[ManifestEpisode, str], str]
    pathfinder: Callable[[ManifestEpisode], Pathfinder]
    renderer: Callable[[ManifestEpisode], Renderer]
    write_layout: WriteLayout
    render_every: int = 50


@dataclass
class TrajectoryProof:
    """How many walks, frames, images and layout rows were checked, of how many walks the words of each layout were
    replayed, how many images were rendered again, and which faults were found; what read the textures when the images
    were made, by kind of texture.
    """

    walks: int = 0
    frames: int = 0
    images: int = 0
    rendered: int = 0
    layout_rows: dict[str, int] = field(default_factory=dict)
    layout_walks: dict[str, int] = field(default_factory=dict)
    decoders: Mapping[str, str] = field(default_factory=dict)
    faults: list[TrajectoryFault] = field(default_factory=list)


def prove_trajectories(folder: Path, world: TrajectoryWorld) -> TrajectoryProof:
    """Check every walk of a folder; scenes are read one after the other.

    Raises
    ------
    MissingFileError, FormatError : the folder holds no trajectories, or a table can't be read
    """
    record = read_record(folder)
    cameras = {name: CameraConfig(**camera) for name, camera in record["cameras"].items()}
    images = record["config"] | {"encoders": record["encoders"]}
    proof = TrajectoryProof(decoders=record["decoders"])
    written = record["images_written"]
    space = ActionSpace(forward=images["forward"], turn=images["turn"])
    annotated = written and bool({*HUBS} & {*record["layouts"]})
    entries = {str(entry.get("trajectory")): entry for entry in read_annotations(folder)} if annotated else {}
    walks = read_table(folder, "trajectories").to_pylist()
    names = [walk["trajectory"] for walk in walks]
    if (annotated and sorted(entries) != sorted(names)) or len(set(names)) != len(names):
        proof.faults.append(TrajectoryFault("", "annotations.json and trajectories.parquet have different walks"))
    owners = {walk["trajectory"]: walk for walk in walks if walk["frames_of"] == walk["trajectory"]}
    for walk in walks:
        proof.walks += 1
        found = _Walk(walk, entries.get(walk["trajectory"]), world, space)
        proof.faults += [TrajectoryFault(walk["trajectory"], what) for what in _readable(found.faults(owners))]
    seen: set[str] = set()
    for name, rows in walks_with_poses(folder / "poses.parquet"):
        seen.add(name)
        walk = owners.get(name)
        if walk is None:
            proof.faults.append(TrajectoryFault(name, "poses.parquet has a walk that trajectories.parquet has not"))
            continue
        frames = _Frames(folder if written else None, walk, rows, cameras, images, world, space)
        proof.faults += [TrajectoryFault(name, what) for what in _readable(frames.faults(proof))]
    proof.faults += [TrajectoryFault(name, "the walk has no poses") for name in sorted(set(owners) - seen)]
    if written:
        layouts = prove_layouts(folder, record, walks, world.write_layout, sound=not proof.faults)
        proof.layout_rows = dict(layouts.rows)
        proof.faults += [TrajectoryFault(name, what) for name, what in layouts.faults]
        meant: dict[str, ActionSpace] = {}
        for name in layouts.words:
            try:
                meant[name] = meaning_of(folder, name)
            except DAMAGED as error:
                proof.faults.append(TrajectoryFault("", f"{name}: it does not say what its actions mean ({error})"))
        for walk in walks:
            words = {name: (size, layouts.words[name].get(walk["trajectory"])) for name, size in meant.items()}
            compared = _readable(_said(walk, words, world, space, proof))
            proof.faults += [TrajectoryFault(walk["trajectory"], what) for what in compared]
    left_out = read_table(folder, "left_out").to_pylist()
    proof.faults += [TrajectoryFault("", what) for what in _unaccounted(world.episodes, images, walks, left_out)]
    return proof


def _readable(faults: Iterator[str]) -> Iterator[str]:
    """Yield faults, and as the last one a value with which no comparison is possible, such as a list without items."""
    try:
        yield from faults
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        yield f"a value of its rows is damaged ({type(error).__name__}: {error})"


def _unaccounted(episodes: Iterable[int], config: Row, walks: Sequence[Row], left_out: Sequence[Row]) -> Iterator[str]:
    """Yield what is wrong with the number of walks of each episode: every wanted walk must be either made or recorded
    as left out. An oracle walk has the images of the direct walk; if that one is left out, so is the oracle walk.
    """
    made = Counter((walk["episode_id"], walk["kind"]) for walk in walks)
    out = Counter((row["episode_id"], row["kind"]) for row in left_out)
    kinds = {*config["walks"]} | ({"direct"} if "oracle" in config["walks"] else set())
    for episode in sorted(episodes):
        for kind in sorted(kinds):
            wanted = config["recoveries"] if kind == "recovery" else 1
            here, without = made[episode, kind], out[episode, "direct" if kind == "oracle" else kind]
            if here + without != wanted:
                yield f"the {kind} walks of episode {episode}: {here} made and {without} left out, of {wanted}"


def _said(
    walk: Row,
    words: Mapping[str, tuple[ActionSpace, list[int] | None]],
    world: TrajectoryWorld,
    space: ActionSpace,
    proof: TrajectoryProof,
) -> Iterator[str]:
    """Yield the layouts whose words, as their agents mean them, do not lead along the walk to its goal.

    words : by layout, the sizes of its actions, and the actions that the walk's samples say; None if there are no
        samples, or if these can't be read, which is a fault already
    """
    episode = world.episodes.get(int(walk["episode_id"]))
    if episode is None:
        return
    pathfinder = world.pathfinder(episode)
    start, heading = episode.start_position, _heading(episode)
    made = Follower(pathfinder, space).walk(start, heading, walk["executed"])
    for layout, (meant, actions) in words.items():
        if actions is None:
            continue
        replay = Follower(pathfinder, meant).walk(start, heading, actions)
        proof.layout_walks[layout] = proof.layout_walks.get(layout, 0) + 1
        left = float(pathfinder.distance_table(replay.positions[-1:], _goals(walk)).min())
        if not left <= episode.success_distance or actions[-1:] != [STOP]:
            yield (
                f"{layout}: its words lead to {left:.2f} m from the goal, since the agent that reads them takes steps "
                f"of {meant.forward:g} m and turns of {meant.turn:g}°"
            )
        elif not np.array_equal(replay.positions, made.positions) or not np.allclose(replay.headings, made.headings):
            yield f"{layout}: its words lead along other poses than the walk's"


class _Walk:
    """Compares the row of a walk with the walk's episode and with the walk's entry in ``annotations.json``."""

    def __init__(self, walk: Row, entry: Row | None, world: TrajectoryWorld, space: ActionSpace) -> None:
        self._walk, self._entry, self._world, self._space = walk, entry, world, space

    def faults(self, owners: Mapping[str, Row]) -> Iterator[str]:
        walk, entry = self._walk, self._entry
        episode = self._world.episodes.get(int(walk["episode_id"]))
        if episode is None:
            yield f"the export has no episode {walk['episode_id']}"
            return
        gold = next(leaf for leaf in episode.leaves if leaf.leaf == episode.gold_leaf)
        claimed = {
            "instruction is": (walk["instruction_text"], self._world.text(episode, walk["kind"])),
            "goals are": (
                [_point(goal).tolist() for goal in walk["goals"]],
                [list(map(float, goal)) for goal in gold.goals],
            ),
            "success distance is": (walk["success_distance"], episode.success_distance),
            "number of allowed actions is": (walk["max_steps"], episode.max_steps),
            "start rotation is": (
                [walk["start_rotation"][axis] for axis in "xyzw"],
                [*map(float, episode.start_rotation)],
            ),
            "navmesh is": (
                (walk["navmesh"], walk["navmesh_sha256"]),
                (episode.navmesh, episode.navmesh_sha256),
            ),
            "scene is": (walk["scene_id"], episode.scene_id),
        }
        yield from (f"the {what} not the episode's" for what, (own, its) in claimed.items() if own != its)
        owner = owners.get(walk["frames_of"])
        if owner is None:
            yield f"the images of {walk['frames_of']} are not there"
        elif [owner[key] for key in ("actions", "executed", "episode_id")] != [
            walk[key] for key in ("actions", "executed", "episode_id")
        ]:
            yield "the walk has the images of another walk"
        yield from self._actions()
        if entry is not None:
            yield from self._annotation(entry)
        yield from self._replayed(episode)

    def _actions(self) -> Iterator[str]:
        walk = self._walk
        actions, executed = np.array(walk["actions"]), np.array(walk["executed"])
        if not len(actions) == len(executed) == len(walk["repeats"]) == walk["n_frames"] or not len(actions):
            yield "actions, repeats and frames differ in number"
            return
        wrong = actions != executed
        if actions[-1] != STOP or executed[-1] != STOP or (executed[:-1] == STOP).any():
            yield "the walk does not end with its only STOP"
        if walk["kind"] != "recovery" and wrong.any():
            yield "an action is not the one that was taken"
        if (np.array(walk["repeats"])[wrong] != 0).any() or (np.array(walk["repeats"])[~wrong] < 1).any():
            yield "a frame of a mistake is a sample, or another one is not"

    def _annotation(self, entry: Row) -> Iterator[str]:
        walk = self._walk
        if [*entry["actions"][1:], STOP] != walk["actions"] or entry["actions"][:1] != [-1]:
            yield "annotations.json has other actions"
        if entry["instructions"] != [walk["instruction_text"]]:
            yield "annotations.json has another instruction"
        if entry["id"] != walk["episode_id"] or entry["kind"] != walk["kind"]:
            yield "annotations.json has another episode or kind"
        if entry["video"] != f"images/{walk['frames_of']}":
            yield "annotations.json names other images"
        if entry.get("repeats") != walk["repeats"]:
            yield "annotations.json has other repeats"

    def _replayed(self, episode: ManifestEpisode) -> Iterator[str]:
        pathfinder = self._world.pathfinder(episode)
        follower = Follower(pathfinder, self._space)
        walk = follower.walk(episode.start_position, _heading(episode), self._walk["executed"])
        left = float(pathfinder.distance_table(walk.positions[-1:], _goals(self._walk)).min())
        if not left <= episode.success_distance:
            yield f"the walk ends {left:.2f} m from the goal; it may end {episode.success_distance:g} m from it"
        if _point(self._walk["start_position"]).tolist() != walk.positions[0].astype(float).tolist():
            yield "the start is not the episode's"


class _Frames:
    """Checks the poses and images of one walk. `folder` is None for a recipe, which is a folder of trajectories without
    images.
    """

    def __init__(
        self,
        folder: Path | None,
        walk: Row,
        rows: list[dict[str, Any]],
        cameras: Mapping[str, CameraConfig],
        images: Row,
        world: TrajectoryWorld,
        space: ActionSpace,
    ) -> None:
        self._folder, self._walk, self._rows, self._cameras = folder, walk, rows, cameras
        self._images, self._world, self._space = images, world, space

    def faults(self, proof: TrajectoryProof) -> Iterator[str]:
        walk = self._walk
        count = walk["n_frames"]
        proof.frames += count
        # The number first: a list of a length that a damaged table claims may not fit into memory.
        names = sorted(self._cameras)
        if len(self._rows) != count * len(names) or [(row["frame"], row["camera"]) for row in self._rows] != [
            (frame, name) for frame in range(count) for name in names
        ]:
            yield "a frame has no pose, or more than one"
            return
        if any(row["episode_id"] != walk["episode_id"] or row["kind"] != walk["kind"] for row in self._rows):
            yield "a pose has another episode or kind than its walk"
        episode = self._world.episodes.get(int(walk["episode_id"]))
        if episode is None:
            return
        pathfinder = self._world.pathfinder(episode)
        replay = Follower(pathfinder, self._space).walk(episode.start_position, _heading(episode), walk["executed"])
        places = replay.positions[:count].astype(np.float64)
        distances = pathfinder.distance_table(replay.positions[:count], _goals(walk)).min(axis=1)
        leaves = {leaf.leaf for leaf in episode.leaves}
        yield from self._decisions(episode)
        found: set[str] = set()
        for row in self._rows:
            frame = row["frame"]
            found |= set(self._pose(row, places[frame], float(replay.headings[frame]), leaves))
            if row["distance_to_goal"] != float(distances[frame]):
                found.add(f"frame {frame}: the distance to the goal is another one")
            proof.images += 1
            fault = self._image(row, places[frame], float(replay.headings[frame]), episode, proof)
            if fault:
                found.add(f"frame {frame}, {row['camera']}: {fault}")
        yield from sorted(found)
        for name in sorted(self._cameras) if self._folder is not None else ():
            own = {Path(row["image"]).name for row in self._rows if row["camera"] == name}
            assert self._folder is not None
            here = self._folder / "images" / walk["trajectory"] / name
            if {path.name for path in here.glob("*")} != own:
                yield f"{here.relative_to(self._folder)}: the files are not the walk's frames"

    def _decisions(self, episode: ManifestEpisode) -> Iterator[str]:
        """Yield what is wrong with the leaf that the walk is for, and with what it looks for. Only a looking walk looks
        for evidence: at each frame for the first condition of the gold route that is not decided by then. It has no
        leaf until all are. That its decisions are justified is proven with the export.
        """
        frames = {row["frame"]: (row["leaf"], row["looks_for"]) for row in self._rows}
        if len({(row["frame"], row["leaf"], row["looks_for"]) for row in self._rows}) != len(frames):
            yield "the cameras of a frame disagree on the leaf, or on what is looked for"
        if self._walk["kind"] != "looking":
            if any(number is not None for _, number in frames.values()):
                yield "a walk that does not look first looks for evidence"
            return
        asked = [*zip(dict.fromkeys(episode.program.route()[0]), episode.looking_decided or (), strict=True)]
        for frame, told in sorted(frames.items()):
            open_ones = (number for number, decided in asked if decided > frame)
            number = next(open_ones, None)
            if told != ((episode.gold_leaf if number is None else -1), number):
                yield f"frame {frame}: the walk looks for another condition, or is for another leaf"
        if self._walk["actions"] != [*(episode.looking_actions or ())]:
            yield "the actions are not the episode's"

    def _pose(self, row: Row, place: F64, heading: float, leaves: set[int]) -> Iterator[str]:
        frame = row["frame"]
        if row["action"] != self._walk["actions"][frame] or row["executed"] != self._walk["executed"][frame]:
            yield f"frame {frame}: the action is not the walk's"
        if not np.array_equal(_point(row["position"]), place) or row["heading"] != heading:
            yield f"frame {frame}: the actions do not lead to this pose"
        turned = np.array([row["rotation"][axis] for axis in "xyzw"])
        if np.abs(turned - [0, math.sin(heading / 2), 0, math.cos(heading / 2)]).max() > _ANGLE:
            yield f"frame {frame}: the rotation is not that of the heading"
        if row["leaf"] not in leaves and row["looks_for"] is None:
            yield f"frame {frame}: the episode has no leaf {row['leaf']}"
        camera = self._cameras[row["camera"]]
        if any(row[key] != getattr(camera, key) for key in _CAMERA):
            yield f"camera {row['camera']} is not that of trajectories.json"

    def _image(
        self, row: Row, place: F64, heading: float, episode: ManifestEpisode, proof: TrajectoryProof
    ) -> str | None:
        suffix = "png" if row["camera"].startswith("depth") else "jpg"
        if row["image"] != f"images/{row['trajectory']}/{row['camera']}/{row['frame'] + 1:03d}.{suffix}":
            return "the image is not that of the frame"
        fault = None if self._folder is None else self._file(self._folder / row["image"], row)
        every = self._world.render_every
        if fault or not every or int(hashlib.sha256(row["image"].encode()).hexdigest(), 16) % every:
            return fault
        same_encoder = self._images["encoders"].get(suffix) == encoders()[suffix]
        if self._folder is None and not same_encoder:
            return None  # the recipe's hash is that of a file which is not written here
        proof.rendered += 1
        frame = self._world.renderer(episode).look(self._cameras[row["camera"]], place, heading)
        data = (
            jpeg(frame.rgb, self._images["jpeg_quality"])
            if suffix == "jpg"
            else png16(frame.depth, self._images["png_level"])
        )
        other = "the pose shows another image"
        if same_encoder and hashlib.sha256(data).hexdigest() != row["sha256"]:
            return other
        file = data if self._folder is None else read_regular(self._folder / row["image"])
        shown = _millimetres(frame.depth) if suffix == "png" else frame.rgb.astype(np.int64)
        return None if _shows(file, data, shown) else other

    def _file(self, path: Path, row: Row) -> str | None:
        """Return what is wrong with an image's file."""
        from PIL import Image

        camera = self._cameras[row["camera"]]
        try:
            data = read_regular(path)
        except OSError as error:
            return f"the image can't be read: {error.strerror}"
        if len(data) != row["bytes"] or hashlib.sha256(data).hexdigest() != row["sha256"]:
            return "the image is not the one that was written"
        try:
            with Image.open(io.BytesIO(data)) as image:
                if image.size != (camera.width, camera.height):
                    return "the image has another size"
                image.load()
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            return f"the image can't be decoded: {error}"
        return None


def _pixels(data: bytes) -> NDArray[np.int64]:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.array(image, np.int64)


def _millimetres(depth: NDArray[np.float32]) -> NDArray[np.int64]:
    found: NDArray[np.int64] = np.clip(np.rint(depth * np.float32(1000)), 0, 65535).astype(np.int64)
    return found


def _shows(file: bytes, ours: bytes, shown: NDArray[np.int64]) -> bool:
    """Return whether an image file, of any encoder, has the pixels that are shown. PNG keeps them; a JPEG file may lose
    half as much again as `ours`, the file that is written here, and one level.
    """
    found = _pixels(file)
    if found.ndim == 2 or found.shape != shown.shape:
        return bool(np.array_equal(found, shown))
    lost, least = (float(np.square(one - shown).mean()) ** 0.5 for one in (found, _pixels(ours)))
    return bool(lost <= 1.5 * least + 1)


def _point(row: Row) -> F64:
    return np.array([row[axis] for axis in "xyz"], np.float64)


def _goals(walk: Row) -> F64:
    return np.array([_point(goal) for goal in walk["goals"]])


def _heading(episode: ManifestEpisode) -> float:
    return 2.0 * math.atan2(episode.start_rotation[1], episode.start_rotation[3]) % (2.0 * math.pi)
