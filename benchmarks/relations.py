"""Relations of a room: arrays compared with a loop over pairs in plain Python, with the same formulas.

Both compute every metric, the canonical predicate, the semantic predicates and the facts fit for text of all ordered
pairs. Run as ``python benchmarks/relations.py``; it prints pairs per second and the ratio, measured in one run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from condvln.relations import (
    CANONICAL,
    COMPASS,
    TEXT_PREDICATES,
    RoomRelations,
    TextFacts,
    relate_room,
    text_facts,
)
from condvln.relations.solids import MeshSolid, solid_distance
from condvln.scene import RoomArrays, SceneObject, round_mm
from condvln.scene.meshes import WorldMesh
from schemas.config import Thresholds

SECONDS = 0.25
"""Least duration of each measurement, seconds."""

ROUNDS = 6
"""Number of measurements; the best counts, since other work on the machine only slows them down."""

T = Thresholds()


def furnished_room(count: int, seed: int = 0) -> RoomArrays:
    """Make a room of `count` boxes with ReplicaCAD's density: its apartments hold 24 objects on 70 m²."""
    rng = np.random.default_rng(seed)
    side = math.sqrt(70.0 * count / 24)
    objects = []
    for k in range(count):
        centre = round_mm(rng.uniform([0, 0.1, 0], [side, 1.8, side]))
        half = rng.uniform(0.05, 0.6, 3)
        objects.append(
            SceneObject(f"{k:04d}", "room", "thing", "thing", centre, aabb=round_mm([centre - half, centre + half]))
        )
    return RoomArrays.of("room", objects)


def meshes_of(room: RoomArrays) -> Callable[[SceneObject], WorldMesh]:
    """Return a ball of 320 triangles in each box, as a stand-in for furniture."""
    ball = trimesh.creation.icosphere(2, 1.0)
    faces = np.asarray(ball.faces, np.int32)

    def mesh(item: SceneObject) -> WorldMesh:
        assert item.aabb is not None
        return WorldMesh(np.asarray(ball.vertices) * (item.aabb[1] - item.aabb[0]) / 2 + item.center, faces, True)

    return mesh


def vectorised(room: RoomArrays) -> tuple[RoomRelations, TextFacts]:
    """Compute relations as the product does."""
    relations = relate_room(room, T)
    return relations, text_facts(relations, T)


def with_meshes(room: RoomArrays) -> tuple[RoomRelations, TextFacts]:
    """Compute relations as the product does, with surface distances of meshes."""
    relations = relate_room(room, T, meshes_of(room))
    return relations, text_facts(relations, T)


@dataclass(slots=True)
class Edge:
    """Everything that is known of one ordered pair."""

    delta: tuple[float, float, float]
    centre: float
    horizontal: float
    aabb: float
    sphere: float
    surface: float
    used: float
    used_metric: str
    azimuth: float
    elevation: float
    footprint_overlap: float
    degenerate: bool
    canonical: str
    semantic: set[str]
    status: dict[str, int]
    margin: dict[str, float]


def one_pair_at_a_time(room: RoomArrays) -> list[Edge]:
    """Compute the same relations in plain Python, one ordered pair after the other."""
    boxes = [
        (c.tolist(), low.tolist(), high.tolist(), float(radius))
        for c, low, high, radius in zip(room.centers, room.aabb_min, room.aabb_max, room.radius, strict=True)
    ]
    return [_edge(*a, *b, None) for i, a in enumerate(boxes) for j, b in enumerate(boxes) if i != j]


def one_pair_at_a_time_with_meshes(room: RoomArrays) -> list[Edge]:
    """Compute the same relations in plain Python; each pair within reach is measured, and trees are built once."""
    mesh = meshes_of(room)
    solids = [MeshSolid(mesh(item)) for item in room.objects]
    boxes = [
        (c.tolist(), low.tolist(), high.tolist(), float(radius))
        for c, low, high, radius in zip(room.centers, room.aabb_min, room.aabb_max, room.radius, strict=True)
    ]
    return [_edge(*a, *b, (solids[i], solids[j])) for i, a in enumerate(boxes) for j, b in enumerate(boxes) if i != j]


def _edge(
    ci: list[float],
    li: list[float],
    hi: list[float],
    ri: float,
    cj: list[float],
    lj: list[float],
    hj: list[float],
    rj: float,
    solids: tuple[MeshSolid, MeshSolid] | None,
) -> Edge:
    dx, dy, dz = (round(a - b, 3) for a, b in zip(ci, cj, strict=True))
    horizontal = math.sqrt(dx * dx + dz * dz)
    centre = math.sqrt(dx * dx + dy * dy + dz * dz)
    gaps = [max(li[k] - hj[k], lj[k] - hi[k], 0.0) for k in range(3)]
    aabb = math.sqrt(gaps[0] ** 2 + gaps[1] ** 2 + gaps[2] ** 2)
    sphere = max(0.0, centre - (ri + rj))
    if not math.isnan(aabb):
        used, used_metric = aabb, "aabb"
    elif not math.isnan(sphere):
        used, used_metric = sphere, "sphere"
    else:
        used, used_metric = centre, "centre"
    surface = math.nan
    if aabb <= T.surface_within:
        surface = round(aabb if solids is None else solid_distance(*solids), 3)
    shared = 1.0
    for k in (0, 2):
        shared *= max(min(hi[k], hj[k]) - max(li[k], lj[k]), 0.0)
    overlap = shared / min((hi[0] - li[0]) * (hi[2] - li[2]), (hj[0] - lj[0]) * (hj[2] - lj[2]))
    azimuth = math.degrees(math.atan2(-dz, dx)) if horizontal > 0 else math.nan
    elevation = math.degrees(math.atan2(dy, horizontal))
    if horizontal > 0:
        storey = 0 if abs(elevation) < T.level else 1 if elevation > 0 else 2
        canonical = CANONICAL[storey * 8 + int((azimuth + 22.5) % 360 // 45)]
    else:
        canonical = "up of" if dy > 0 else "down of" if dy < 0 else ""

    semantic = set()
    if used <= T.near:
        semantic.add("near")
    if used >= T.far:
        semantic.add("far from")
    for sign, higher, above in ((1, "higher than", "above"), (-1, "lower than", "below")):
        if sign * dy >= T.height:
            semantic.add(higher)
            if horizontal <= T.over_horizontal:
                semantic.add(above)

    status: dict[str, int] = {}
    margin: dict[str, float] = {}

    def note(predicate: str, true: bool, false: bool, when_true: float, when_false: float) -> None:
        status[predicate] = 1 if true else -1 if false else 0
        margin[predicate] = max(when_true, when_false)

    bound = used if math.isnan(surface) else surface
    note(
        "near",
        used <= T.near_true and surface <= T.near_true,
        used >= T.near_false and bound >= T.near_false,
        min(_rising(used, T.near, T.near_true), _rising(surface, T.near, T.near_true)),
        min(_rising(used, T.near, T.near_false), _rising(bound, T.near, T.near_false)),
    )
    note(
        "far from",
        used >= T.far_true,
        used <= T.far_false,
        _rising(used, T.far, T.far_true),
        _rising(used, T.far, T.far_false),
    )
    for up, higher, above in ((dy, "higher than", "above"), (-dy, "lower than", "below")):
        rise, fall = _rising(up, T.height, T.height_true), _rising(up, T.height, T.height_false)
        note(higher, up >= T.height_true, up <= T.height_false, rise, fall)
        note(
            above,
            up >= T.height_true and horizontal <= T.over_horizontal_true and overlap >= T.over_footprint_true,
            up <= T.height_false or horizontal >= T.over_horizontal_false,
            min(
                rise,
                _rising(horizontal, T.over_horizontal, T.over_horizontal_true),
                _rising(overlap, 0.0, T.over_footprint_true),
            ),
            max(fall, _rising(horizontal, T.over_horizontal, T.over_horizontal_false)),
        )
    clear = abs(elevation) < T.level and horizontal >= T.sector_horizontal_true
    clearance = _rising(horizontal, 0.0, T.sector_horizontal_true)
    for sector, predicate in enumerate(COMPASS):
        turn = (azimuth - 45.0 * sector) % 360.0
        deviation = min(turn, 360.0 - turn)
        note(
            predicate,
            deviation <= T.sector_true and clear,
            deviation > T.sector_false,
            min(_rising(deviation, T.sector_half_width, T.sector_true), clearance),
            _rising(deviation, T.sector_half_width, T.sector_false),
        )
    return Edge(
        delta=(-dx, -dy, -dz),
        centre=centre,
        horizontal=horizontal,
        aabb=aabb,
        sphere=sphere,
        surface=surface,
        used=used,
        used_metric=used_metric,
        azimuth=azimuth,
        elevation=elevation,
        footprint_overlap=overlap,
        degenerate=horizontal < T.degenerate_horizontal,
        canonical=canonical,
        semantic=semantic,
        status=status,
        margin=margin,
    )


def _rising(value: float, emitted: float, text: float) -> float:
    return (value - emitted) / (text - emitted)


def check_same(room: RoomArrays) -> None:
    """Check that both ways find the same relations; otherwise the comparison would mean nothing."""
    relations, facts = vectorised(room)
    pairs = [(i, j) for i in range(len(room)) for j in range(len(room)) if i != j]
    for (i, j), edge in zip(pairs, one_pair_at_a_time(room), strict=True):
        code = relations.canonical[i, j]
        assert edge.canonical == (CANONICAL[code] if code >= 0 else "")
        assert edge.semantic == {p for p, mask in relations.semantic.items() if mask[i, j]}
        assert edge.status == {p: facts.status[p][i, j] for p in edge.status}
        for p in TEXT_PREDICATES:
            assert edge.status[p] == 0 or math.isclose(edge.margin[p], facts.margin[p][i, j], abs_tol=1e-6)
        for field in ("centre", "horizontal", "aabb", "used", "azimuth", "elevation", "footprint_overlap"):
            assert math.isclose(getattr(edge, field), getattr(relations.metrics, field)[i, j], abs_tol=1e-9), field


def pairs_per_second(ways: Sequence[Callable[[RoomArrays], object]], room: RoomArrays) -> list[float]:
    """Return ordered pairs per second of each way, the best of some rounds; the ways alternate under the same load."""
    pairs = len(room) * (len(room) - 1)
    best = [0.0] * len(ways)
    for _ in range(ROUNDS):
        for k, work in enumerate(ways):
            done, start = 0, time.perf_counter()
            while time.perf_counter() - start < SECONDS:
                work(room)
                done += 1
            best[k] = max(best[k], done * pairs / (time.perf_counter() - start))
    return best


def main() -> None:
    """Print the comparison for rooms of 24 and 100 objects."""
    print("ordered pairs/s     objects           loop         arrays    ratio")
    for count in (24, 100):
        room = furnished_room(count)
        check_same(room)
        ways = (one_pair_at_a_time, vectorised, one_pair_at_a_time_with_meshes, with_meshes)
        speeds = pairs_per_second(ways, room)
        for name, (loop, arrays) in {"boxes": speeds[:2], "meshes": speeds[2:]}.items():
            print(f"{name:<16} {count:>10} {loop:>14,.0f} {arrays:>14,.0f} {arrays / loop:>7.1f}x")


if __name__ == "__main__":
    main()
