"""Checks the texts of a published snapshot against its raw tables, by plain loops.

Counts faults of four kinds, each of which should be 0: text that names what is hidden or can't be seen; absence of a
label that something hidden or nameless in the room may bear; "above" and "below" of what rests on the other; and goal
points of counters with corners that are farther from their arms than ``goals.reach_at_most``.

``python -m benchmarks.what_is_said CONFIG`` after ``condvln generate CONFIG``; exits 1 where a count is not 0.
"""

from __future__ import annotations

import math
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from condvln.labels import vocabulary
from factory.snapshot import Snapshot
from jobs.configuration import load_config
from jobs.workspace import published

AIR: Final = 0.10
"""Least vertical gap between an object that is above and the one below, metres."""
SCANS: Final = ("mp3d", "gibson")

Row = Mapping[str, Any]


def check(snapshot: Snapshot, reach: float) -> tuple[Counter[str], Counter[str]]:
    """Count how often each kind of claim was checked, and how often it is wrong."""
    seen: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    for family in sorted(snapshot.manifest.tables["instructions"].partitions):
        scenes: dict[str, dict[str, Row]] = defaultdict(dict)
        for item in snapshot.table("objects", partition=family).to_pylist():
            scenes[item["scene_id"]][item["object_id"]] = item
        unseen = {
            (row["scene_id"], row["object_id"])
            for row in snapshot.table("visibility", partition=family).to_pylist()
            if row["seeable"] is False
        }
        for row in snapshot.table("instructions", partition=family).to_pylist():
            things = scenes[row["scene_id"]]
            for name in sorted(set(named(row))):
                seen["things named"] += 1
                faults["things named that are hidden"] += shut_in(name, things, family)
                faults["things named that can't be seen"] += (row["scene_id"], name) in unseen
            for condition in row["conditions"]:
                if condition["qualifier"] is None and not condition["truth"]:
                    seen["absence claims"] += 1
                    faults["absence claims in doubt"] += in_doubt(condition, things, family)
            for subject, predicate, anchor in stacked(row):
                seen["above and below"] += 1
                upper, lower = (subject, anchor) if predicate == "above" else (anchor, subject)
                faults["above of what rests"] += rests(things[upper], things[lower], things)
        for row in snapshot.table("episodes", partition=family).to_pylist() if has_episodes(snapshot, family) else ():
            for leaf in row["leaves"]:
                item = scenes[row["scene_id"]][leaf["object_id"]]
                for goal in leaf["goals"] if item["parts"] else ():
                    seen["goal points of counters with corners"] += 1
                    nearest = min(to_part(goal, part) for part in item["parts"])
                    faults["goal points too far from the arms"] += nearest > reach + 0.002
    return seen, faults


def has_episodes(snapshot: Snapshot, family: str) -> bool:
    """Whether a family has episodes; scenes without a navmesh have instructions only."""
    return "episodes" in snapshot.manifest.tables and family in snapshot.manifest.tables["episodes"].partitions


def named(row: Row) -> Iterator[str]:
    """Yield targets, anchors, witnesses, and the objects that rooms are named by."""
    for one in (*row["conditions"], *(move for leaf in row["leaves"] for move in leaf["moves"])):
        yield from one.get("witnesses") or ()
        yield from (anchor["object_id"] for anchor in (one["qualifier"] or {"anchors": ()})["anchors"])
        yield from filter(None, (one.get("object_id"), one["room"]["anchor_id"]))


def stacked(row: Row) -> Iterator[tuple[str, str, str]]:
    """Yield (subject, "above" or "below", anchor) of everything that the text says is so."""
    for one in (*row["conditions"], *(move for leaf in row["leaves"] for move in leaf["moves"])):
        qualifier = one["qualifier"]
        if qualifier is not None and qualifier["predicate"] in ("above", "below"):
            for name in one["witnesses"] if "witnesses" in one else (one["object_id"],):
                yield name, qualifier["predicate"], qualifier["anchors"][0]["object_id"]


def shut_in(name: str, things: Mapping[str, Row], family: str) -> bool:
    """Whether the source or the table says that the object is in something closed, or in or on something that is."""
    if things[name]["hidden"]:
        return True
    ahead, met = [name], set()
    while ahead and family not in SCANS:
        item = things[ahead.pop()]
        for holder in (things[x] for x in item["receptacles"] or () if x in things and x not in met):
            met.add(holder["object_id"])
            shut = vocabulary.container(holder["label"]) == "shut" and (holder["openness"] or 0.0) < 0.5
            if shut and below_the_top(item, holder):
                return True
            ahead.append(holder["object_id"])
    return False


def below_the_top(item: Row, holder: Row) -> bool:
    """Whether the object is in the holder rather than on its top; without boxes it counts as in it."""
    low, high = item["aabb_min"], holder["aabb_max"]
    return low is None or high is None or bool(low["y"] <= high["y"] - 0.05 and size(item) <= 2.0 * size(holder))


def size(item: Row) -> float:
    """Return the longest side of an object."""
    return max(item["aabb_max"][k] - item["aabb_min"][k] for k in "xyz")


def in_doubt(condition: Row, things: Mapping[str, Row], family: str) -> bool:
    """Whether some object in the room has the label or may have it."""
    words = vocabulary.overlapping(condition["label"])
    for item in things.values():
        if item["room_id"] == condition["room"]["room_id"]:
            longest = None if item["aabb_min"] is None else size(item)
            if item["label"] in words or words & vocabulary.may_be(item["label"], family, longest):
                return True
    return False


def rests(upper: Row, lower: Row, things: Mapping[str, Row]) -> bool:
    """Whether one object is on the other according to the source or the tables, or with less than 0.1 m of air
    between."""
    ahead, met = [upper], set()
    while ahead:
        item = ahead.pop()
        for name in (*(item["receptacles"] or ()), item["support"], item["parent"]):
            if name == lower["object_id"]:
                return True
            if name in things and name not in met:
                met.add(name)
                ahead.append(things[name])
    return bool(upper["aabb_min"]["y"] - lower["aabb_max"]["y"] < AIR - 1e-6)


def to_part(point: Row, part: Row) -> float:
    """Return the horizontal distance from a point to an upright box that is rotated about the vertical axis, metres."""
    turn = part["rotation"]
    angle = 2.0 * math.atan2(turn["y"], turn["w"])
    x, z = point["x"] - part["center"]["x"], point["z"] - part["center"]["z"]
    along = math.cos(angle) * x - math.sin(angle) * z, math.sin(angle) * x + math.cos(angle) * z
    beyond = [max(abs(value) - part["half_extents"][k], 0.0) for value, k in zip(along, "xz", strict=True)]
    return math.hypot(*beyond)


def main() -> None:
    """Print both counts."""
    if len(sys.argv) < 2:
        print("python -m benchmarks.what_is_said CONFIG", file=sys.stderr)
        return
    config = load_config(Path(sys.argv[1]))
    seen, faults = check(published(config), config.goals.reach_at_most)
    for name, count in sorted(seen.items()):
        print(f"{name}: {count:,}")
    for name, count in sorted(faults.items()):
        print(f"fault: {name}: {count:,}")
    sys.exit(1 if faults.total() else 0)


if __name__ == "__main__":
    main()
