"""Draw a top-down picture of one episode: floor, furniture, start, and the path to every leaf."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from condvln.episodes.footprint import Footprint
from condvln.scene import Scene

__all__ = ["draw_episode"]

F64 = NDArray[np.float64]

GOLD: Final = "#1b7f3b"
OTHER: Final = "#b3541e"
FLOOR: Final = "#e8eef5"
FURNITURE: Final = "#c9c3b8"
NAMED: Final = "#f2d16b"


def draw_episode(path: Path, scene: Scene, floor: Sequence[F64], episode: Mapping[str, Any], tree: str = "") -> None:
    """Write a top-down PNG of one EPISODES row.

    Parameters
    ----------
    floor : polygons (k, 3) of the navmesh
    episode : the row as plain Python values
    tree : the instruction's tree as text, set beside the map
    """
    figure = Figure(figsize=(13, 8), layout="constrained")
    FigureCanvasAgg(figure)
    plan, words = figure.subplots(1, 2, width_ratios=(2, 1))
    plan.add_collection(
        PolyCollection([p[:, [0, 2]] for p in floor], facecolors=FLOOR, edgecolors="white", linewidths=0.3)
    )
    for room in scene.rooms:
        if room.polygon is not None:
            ring = np.concatenate([room.polygon, room.polygon[:1]])
            plan.plot(ring[:, 0], ring[:, 1], color="#8a94a3", linewidth=1.5)
            x, z = room.polygon.mean(axis=0)
            plan.text(x, z, room.label, color="#5b6675", ha="center", fontsize=11, alpha=0.8)
    named = {leaf["object_id"] for leaf in episode["leaves"]}
    named |= {s["object_id"] for leaf in episode["leaves"] for s in leaf["subgoals"]}
    for item in scene.objects:
        box = Footprint.of(item)
        if box is None:
            continue
        colour = NAMED if item.object_id in named else FURNITURE
        for part in box.parts or (box,):
            corners = part.center + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * part.half) @ part.axes
            plan.fill(corners[:, 0], corners[:, 1], facecolor=colour, edgecolor="#6f6a60", linewidth=0.6, alpha=0.85)
        plan.text(*box.center, item.label, fontsize=6, ha="center", va="center", color="#333333")
    for leaf in episode["leaves"]:
        gold = leaf["leaf"] == episode["gold_leaf"]
        line = np.array([[p["x"], p["z"]] for p in leaf["reference_path"]])
        colour = GOLD if gold else OTHER
        plan.plot(line[:, 0], line[:, 1], color=colour, linewidth=2.4 if gold else 1.4, linestyle="-" if gold else "--")
        for stop in leaf["subgoals"]:
            plan.plot(stop["position"]["x"], stop["position"]["z"], "o", color=colour, markersize=6, fillstyle="none")
        goal = leaf["reference_path"][-1]
        plan.plot(goal["x"], goal["z"], "*" if gold else "X", color=colour, markersize=14 if gold else 9)
        plan.text(goal["x"], goal["z"], f" leaf {leaf['leaf']}", color=colour, fontsize=9, weight="bold")
    start, heading = episode["start_position"], np.radians(episode["start_heading_degrees"])
    plan.annotate(
        "",
        xy=(start["x"] + 0.6 * np.sin(heading), start["z"] - 0.6 * np.cos(heading)),
        xytext=(start["x"], start["z"]),
        arrowprops={"arrowstyle": "-|>", "linewidth": 2, "color": "#20409a"},
    )
    plan.plot(start["x"], start["z"], "s", color="#20409a", markersize=8)
    plan.set_aspect("equal")
    plan.invert_yaxis()  # north (−Z) is up
    plan.set_xlabel("x, metres (east →)")
    plan.set_ylabel("z, metres (north ↑)")
    plan.set_title(f"{scene.family}/{scene.scene_id} · {episode['category']} · episode {episode['episode_id']}")
    words.axis("off")
    words.text(0, 1, f"{episode['instruction_text']}\n\n{tree}", va="top", wrap=True, fontsize=10, family="sans-serif")
    figure.savefig(path, dpi=110)
