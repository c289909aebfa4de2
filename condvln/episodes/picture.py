"""Draw one episode: the plan from above with what the instruction asks about, the first view, the text and a legend."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.episodes.footprint import Footprint
from condvln.episodes.observability import places_at
from condvln.formats.streams import write_figure
from condvln.instructions.referents import things_meant
from condvln.labels import vocabulary
from condvln.navigation.follower import FORWARD, VLN_CE
from condvln.scene import Room, Scene, SceneObject
from condvln.scene.scene import STRUCTURE, SceneGeometry
from schemas.program import Condition, Program

__all__ = ["Label", "draw_episode", "place_labels", "wall_lines"]


GAP: Final = 2.0
"""Least distance between two labels, pixels."""
STEP: Final = 7.0
"""Distance between two rings of positions that are tried, pixels."""
RINGS: Final = 40
"""Number of rings that are tried for a label that must be placed."""
NEARBY: Final = 2
"""The same for a label that may be left out."""
DIRECTIONS: Final = 16
"""Number of positions on a ring."""
LED: Final = 12.0
"""Shift in pixels from which a line joins a label to its place."""


@dataclass(frozen=True)
class Label:
    """A text to write at the place (x, z), in metres. A label that is not `needed` is left out if there is no room for
    it.
    """

    text: str
    x: float
    z: float
    colour: str = "#333333"
    size: float = 6.0
    needed: bool = False
    bold: bool = False


def place_labels(axes: Axes, labels: Sequence[Label], marks: Iterable[tuple[float, float, float]] = ()) -> list[Text]:
    """Add labels to a plan, the needed ones first, and return the texts that were added.

    The limits and the position of `axes` must be final, since the labels are placed by their sizes in pixels.

    Parameters
    ----------
    marks : x, z in metres, and the radius in pixels of what no label may cover
    """
    frame = np.array(axes.get_window_extent().extents)
    taken: list[F64] = []
    for x, z, radius in marks:
        column, row = axes.transData.transform((x, z))
        taken.append(np.array([column - radius, row - radius, column + radius, row + radius]))
    added = []
    for label in sorted(labels, key=lambda one: not one.needed):
        text = axes.text(
            label.x,
            label.z,
            label.text,
            color=label.colour,
            fontsize=label.size,
            weight="bold" if label.bold else "normal",
            ha="center",
            va="center",
            zorder=6,
        )
        box = np.array(text.get_window_extent().padded(GAP).extents)
        shift = _free_shift(box, np.array(taken).reshape(-1, 4), frame, RINGS if label.needed else NEARBY)
        if shift is None:
            text.remove()
            continue
        taken.append(box + np.tile(shift, 2))
        anchor = axes.transData.transform((label.x, label.z))
        place = axes.transData.inverted().transform(anchor + shift)
        text.set_position((float(place[0]), float(place[1])))
        if np.hypot(*shift) >= LED:
            axes.plot([label.x, place[0]], [label.z, place[1]], color=label.colour, linewidth=0.6, alpha=0.6, zorder=5)
        added.append(text)
    return added


def _free_shift(box: F64, taken: F64, frame: F64, rings: int) -> F64 | None:
    """Return the shortest of the tried shifts (2,), in pixels, that moves a box (left, bottom, right, top) to a place
    within the frame where it overlaps no box of `taken`; None if no tried shift does.
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    radii = STEP * np.arange(1, rings + 1)
    shifts = np.concatenate([np.zeros((1, 2)), (radii[:, None, None] * unit).reshape(-1, 2)])
    boxes = box + np.tile(shifts, 2)
    inside = (boxes[:, :2] >= frame[:2]).all(axis=1) & (boxes[:, 2:] <= frame[2:]).all(axis=1)
    apart = (boxes[:, None, :2] >= taken[None, :, 2:]) | (boxes[:, None, 2:] <= taken[None, :, :2])
    free = inside & apart.any(axis=2).all(axis=1)
    return np.asarray(shifts[int(np.argmax(free))], np.float64) if free.any() else None


GOLD: Final = "#1b7f3b"
OTHER: Final = "#b3541e"
START: Final = "#20409a"
FLOOR: Final = "#e8eef5"
WALL: Final = "#4a5361"
ROOM: Final = "#9aa5b5"
FURNITURE: Final = "#d6d1c7"
STOP: Final = "#f2d16b"
WITNESS: Final = "#b18be0"
RIVAL: Final = "#e3d5f3"
ANCHOR: Final = "#8fd0cf"
ASKED: Final = "#6a3fa0"
LEGEND: Final = {
    "floor": "where an agent can walk",
    "wall": "wall",
    "room": "outline of a room",
    STOP: "goal or stop of a leaf",
    WITNESS: "makes a condition true (✔, its number)",
    RIVAL: "has the condition's label, does not make it true (✘)",
    ANCHOR: "what a condition compares with",
    FURNITURE: "other objects",
    "start": "start, and the heading there",
    "gold": "path to the gold leaf; ★ its goal, ○ its stops",
    "other": "path to another leaf; ✕ its goal, ○ its stops",
    "looking": "looking path to the gold leaf; ◇ where a condition is decided",
}
"""What each mark of the plan means."""

LOW, HIGH = 0.3, 1.8
"""Metres above the floor between which walls are cut, so that doorways stay open."""
TEXT_SIZES: Final = (9, 8, 7, 6, 5, 4)
"""Sizes of the text in points; the first one with which the text does not reach the legend is used, or else the last.
"""
MARK: Final = 9.0
"""Radius in pixels of a mark that no label covers."""


def draw_episode(
    path: Path,
    scene: Scene,
    floor: Sequence[F64],
    episode: Mapping[str, Any],
    tree: str = "",
    *,
    program: Program | None = None,
    walls: F64 | None = None,
    view: NDArray[np.uint8] | None = None,
) -> None:
    """Write a picture of one episode, a row of the table EPISODES, as a PNG file. Parts for which the data are missing
    are left out.

    Parameters
    ----------
    floor : polygons (k, 3) of the navmesh
    episode : the row as plain Python values
    tree : the instruction's tree as text
    program : the instruction, whose conditions are marked
    walls (n, 2, 2) : lines x, z in metres, as of `wall_lines`
    view (h, w, 3) : what is seen at the start
    """
    figure = Figure(figsize=(15, 9), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2, width_ratios=(2, 1), height_ratios=(3, 3, 2) if view is not None else (0.01, 5, 2))
    plan = figure.add_subplot(grid[:, 0])
    shown, words, key = (figure.add_subplot(grid[k, 1]) for k in range(3))
    roles = dict(_roles(scene, episode, program))
    drawn = {"floor"} if len(floor) else set()
    drawn |= _draw_building(plan, scene, floor, walls)
    drawn |= _draw_things(plan, scene, roles)
    drawn |= _draw_paths(plan, episode)
    plan.set_aspect("equal")
    plan.margins(0.02)
    plan.invert_yaxis()  # north (−Z) is up
    plan.set_xlabel("x, metres (east →)")
    plan.set_ylabel("z, metres (north ↑)")
    plan.set_title(f"{scene.family}/{scene.scene_id} · {episode['category']} · episode {episode['episode_id']}")
    for axes in (shown, words, key):
        axes.axis("off")
    if view is not None:
        shown.imshow(view)
        shown.set_title("first view, at the start", fontsize=9)
    conditions = "" if program is None else "\n".join(_conditions(program, episode))
    text = words.text(0, 1, f"{episode['instruction_text']}\n\n{tree}\n\n{conditions}", va="top", wrap=True)
    text.set_in_layout(False)
    legend = key.legend(
        handles=[_handle(mark) for mark in LEGEND if mark in drawn],
        loc="lower left",
        fontsize=8,
        frameon=False,
        borderpad=0,
    )
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for size in TEXT_SIZES:
        text.set_fontsize(size)
        if text.get_window_extent().y0 >= legend.get_window_extent().y1:
            break
    start = episode["start_position"]
    marks = [(start["x"], start["z"], MARK)]
    for leaf in episode["leaves"]:
        ends = [stop["position"] for stop in leaf["subgoals"]] + [leaf["reference_path"][-1]]
        marks += [(end["x"], end["z"], MARK) for end in ends]
    place_labels(plan, [*_labels(scene, episode, program, roles)], marks)
    write_figure(figure, path, dpi=110)


def wall_lines(scene: Scene, geometry: SceneGeometry | None) -> F64:
    """Return the walls cut at breast height: lines (n, 2, 2) of x, z in metres; none where walls are unknown.

    A triangle of the building that is upright and reaches from LOW to HIGH above the floor of a room counts as a wall.
    """
    none = np.empty((0, 2, 2))
    if geometry is None or not len(geometry.faces):
        return none
    corners = geometry.vertices[geometry.faces[geometry.owner == STRUCTURE]].astype(np.float64)
    if not len(corners):
        return none
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    upright = np.abs(normal[:, 1]) <= 0.1 * np.linalg.norm(normal, axis=1)
    low, high = corners[..., 1].min(axis=1), corners[..., 1].max(axis=1)
    levels = np.unique([room.floor_y for room in scene.rooms if np.isfinite(room.floor_y)] or [float(low.min())])
    across = ((low[:, None] <= levels + LOW) & (high[:, None] >= levels + HIGH)).any(axis=1)
    flat = corners[upright & across][..., [0, 2]]
    if not len(flat):
        return none
    # The longest side of the flat triangle is the wall.
    sides = np.stack([flat[:, [0, 1]], flat[:, [1, 2]], flat[:, [2, 0]]], axis=1)
    longest = np.argmax(np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=2), axis=1)
    return np.asarray(np.unique(sides[np.arange(len(sides)), longest].round(3), axis=0), np.float64)


def _roles(scene: Scene, episode: Mapping[str, Any], program: Program | None) -> Iterator[tuple[str, str]]:
    """Yield pairs (object id, colour). If an id occurs several times, its last colour counts."""
    conditions = () if program is None else program.conditions
    for condition in conditions:
        yield from ((name, ANCHOR) for name in _anchors(condition))
    for leaf in episode["leaves"]:
        yield from ((stop["object_id"], STOP) for stop in leaf["subgoals"])
        yield leaf["object_id"], STOP
    for condition in conditions:
        yield from ((name, RIVAL) for name in _rivals(scene, condition))
    for condition in conditions:
        yield from ((name, WITNESS) for name in condition.witnesses)


def _anchors(condition: Condition) -> tuple[str, ...]:
    return () if condition.qualifier is None else tuple(condition.qualifier.anchor_ids)


def _rivals(scene: Scene, condition: Condition) -> list[str]:
    if condition.room.room_id not in scene.room_of:
        return []
    meant = things_meant(scene, condition.room.room_id, condition.label, vocabulary)
    return [name for name in meant if name not in condition.witnesses]


def _draw_building(plan: Axes, scene: Scene, floor: Sequence[F64], walls: F64 | None) -> set[str]:
    drawn = set()
    plan.add_collection(
        PolyCollection([p[:, [0, 2]] for p in floor], facecolors=FLOOR, edgecolors="white", linewidths=0.3)
    )
    for room in scene.rooms:
        if room.polygon is not None:
            ring = np.concatenate([room.polygon, room.polygon[:1]])
            plan.plot(ring[:, 0], ring[:, 1], color=ROOM, linewidth=1, linestyle=":")
            drawn.add("room")
    if walls is not None and len(walls):
        plan.add_collection(LineCollection([*walls], colors=WALL, linewidths=2))
        drawn.add("wall")
    return drawn


def _draw_things(plan: Axes, scene: Scene, roles: Mapping[str, str]) -> set[str]:
    drawn = set()
    # What the instruction speaks of lies on top of the furniture that it may be on.
    for item in sorted(scene.objects, key=lambda item: item.object_id in roles):
        box = Footprint.of(item)
        if box is None or vocabulary.is_structure(item.label):
            continue
        colour = roles.get(item.object_id, FURNITURE)
        drawn.add(colour)
        for part in box.parts or (box,):
            corners = part.center + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * part.half) @ part.axes
            edge = ASKED if colour in (WITNESS, RIVAL) else "#6f6a60"
            wide = 1.4 if item.object_id in roles else 0.5
            plan.fill(corners[:, 0], corners[:, 1], facecolor=colour, edgecolor=edge, linewidth=wide, alpha=0.85)
    return drawn


def _draw_paths(plan: Axes, episode: Mapping[str, Any]) -> set[str]:
    drawn = {"start"}
    for leaf in sorted(episode["leaves"], key=lambda leaf: leaf["leaf"] == episode["gold_leaf"]):
        gold = leaf["leaf"] == episode["gold_leaf"]
        line = np.array([[p["x"], p["z"]] for p in leaf["reference_path"]])
        colour = GOLD if gold else OTHER
        plan.plot(line[:, 0], line[:, 1], color=colour, linewidth=2.4 if gold else 1.4, linestyle="-" if gold else "--")
        for stop in leaf["subgoals"]:
            plan.plot(stop["position"]["x"], stop["position"]["z"], "o", color=colour, markersize=6, fillstyle="none")
        plan.plot(*line[-1], "*" if gold else "X", color=colour, markersize=14 if gold else 9)
        drawn.add("gold" if gold else "other")
    if episode.get("looking_path"):
        line = np.array([[p["x"], p["z"]] for p in episode["looking_path"]])
        plan.plot(line[:, 0], line[:, 1], color=GOLD, linewidth=1.6, linestyle=":")
        moved = np.cumsum(np.array(episode["looking_actions"]) == FORWARD) * VLN_CE.forward
        walked = np.append(0.0, moved)[list(episode["looking_decided"])]
        places = places_at(np.insert(line, 1, 0.0, axis=1), walked)
        plan.plot(places[:, 0], places[:, 2], "D", color=GOLD, markersize=6, fillstyle="none")
        drawn.add("looking")
    start, heading = episode["start_position"], np.radians(episode["start_heading_degrees"])
    plan.annotate(
        "",
        xy=(start["x"] + 0.6 * np.sin(heading), start["z"] - 0.6 * np.cos(heading)),
        xytext=(start["x"], start["z"]),
        arrowprops={"arrowstyle": "-|>", "linewidth": 2, "color": START},
    )
    plan.plot(start["x"], start["z"], "s", color=START, markersize=8)
    return drawn


def _labels(
    scene: Scene, episode: Mapping[str, Any], program: Program | None, roles: Mapping[str, str]
) -> Iterator[Label]:
    """Yield the labels of the plan, the most important first."""
    for leaf in episode["leaves"]:
        gold = leaf["leaf"] == episode["gold_leaf"]
        colour, goal = GOLD if gold else OTHER, leaf["reference_path"][-1]
        name = _noun(scene.object_of.get(leaf["object_id"]))
        yield Label(f"leaf {leaf['leaf']}{name}", goal["x"], goal["z"], colour, 9, needed=True, bold=True)
        for number, stop in enumerate(leaf["subgoals"], start=1):
            name = _noun(scene.object_of.get(stop["object_id"]) or scene.room_of.get(stop["object_id"]))
            place = stop["position"]
            yield Label(f"stop {number}{name}", place["x"], place["z"], colour, 7.5, needed=True)
    for number, condition in enumerate(() if program is None else program.conditions, start=1):
        yield from _labels_of(scene, number, condition)
    for room in scene.rooms:
        if room.polygon is not None:
            x, z = room.polygon.mean(axis=0)
            yield Label(room.label, float(x), float(z), "#5b6675", 11)
    others = [item for item in scene.objects if item.object_id not in roles and not vocabulary.is_structure(item.label)]
    boxes = [(box, item) for item in others if (box := Footprint.of(item)) is not None]
    for box, item in sorted(boxes, key=lambda pair: -float(np.prod(pair[0].half))):
        yield Label(item.label, float(box.center[0]), float(box.center[1]))


def _labels_of(scene: Scene, number: int, condition: Condition) -> Iterator[Label]:
    marked = False
    for names, sign in ((condition.witnesses, "✔"), (_rivals(scene, condition), "✘")):
        for item in (scene.object_of[name] for name in names if name in scene.object_of):
            marked = True
            x, _, z = item.center.tolist()
            yield Label(f"{number}{sign}{_noun(item)}", x, z, ASKED, 8, needed=True, bold=sign == "✔")
    room = scene.room_of.get(condition.room.room_id)
    if not marked and room is not None and room.polygon is not None:
        x, z = room.polygon.mean(axis=0)
        yield Label(f"{number}✘ no {condition.label} here", float(x), float(z), ASKED, 8, needed=True)
    for item in (scene.object_of[name] for name in _anchors(condition) if name in scene.object_of):
        x, _, z = item.center.tolist()
        yield Label(f"{number}{_noun(item)}", x, z, "#2a7876", 8, needed=True)


def _noun(item: SceneObject | Room | None) -> str:
    return "" if item is None else f" {item.label}"


def _conditions(program: Program, episode: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each condition: its number, its truth, and from where its evidence is seen."""
    seen = {one["condition"]: one for one in episode.get("evidence") or ()}
    where = {"O0": "seen from the start", "O1": "seen on the way that all leaves share", "O2": "seen after a detour"}
    for number, condition in enumerate(program.conditions):
        known = seen.get(number)
        told = "not on the gold route" if known is None else where[known["observability"]]
        if known is not None and known["in_view"]:
            told = "seen in the first view"
        yield f"{number + 1}{'✔' if condition.truth else '✘'} {condition.label} ({condition.room.label}): {told}"


def _handle(mark: str) -> Line2D | Patch:
    """Return the legend's entry of a mark."""
    lines: dict[str, dict[str, Any]] = {
        "wall": {"color": WALL, "linewidth": 2},
        "room": {"color": ROOM, "linewidth": 1, "linestyle": ":"},
        "start": {"color": START, "marker": "s", "linewidth": 0},
        "gold": {"color": GOLD, "linewidth": 2.4, "marker": "*", "markersize": 10},
        "other": {"color": OTHER, "linewidth": 1.4, "linestyle": "--", "marker": "X"},
        "looking": {"color": GOLD, "linewidth": 1.6, "linestyle": ":", "marker": "D", "fillstyle": "none"},
    }
    if mark in lines:
        return Line2D([], [], label=LEGEND[mark], **lines[mark])
    return Patch(facecolor=FLOOR if mark == "floor" else mark, edgecolor="#6f6a60", label=LEGEND[mark])
