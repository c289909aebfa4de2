"""Find out for each object what contains the object, what the object rests on, and whether a closed container hides it.

If the source states what an object is in or on, the source decides; otherwise boxes do. A container counts as shut
unless its source says that it is at least half open. The contents of a shut container can't be known in the room.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from condvln.arrays import F64
from condvln.labels import vocabulary
from condvln.scene.boxes import aabb_of, box_corners
from condvln.scene.scene import SceneObject
from schemas.config.constants import (
    INSIDE_SHARE,
    LARGER_THAN_RECEPTACLE,
    OPEN_SHARE,
    REST_GAP,
    REST_SHARE,
    TOP_DEPTH,
)

__all__ = ["SCANNED", "is_shut", "stated_holders", "with_containment"]


SCANNED: Final = frozenset({"mp3d", "gibson", "hm3d"})
"""Families annotated on scans of real buildings: what the scanner saw is not hidden."""

WITHOUT_TOP: Final = frozenset({"drawer"})
"""Labels of objects whose top lies inside other furniture, so that nothing rests on them."""

MM: Final = 1000.0
"""Boxes are compared in whole millimetres, in which sums and products are exact."""

THIN: Final = 1.0
"""Least thickness of a box in millimetres, so that volume shares of flat boxes are defined."""

SLACK: Final = 1e-6
"""Tolerance for shares, and for thresholds in millimetres after rounding."""


def is_shut(item: SceneObject) -> bool:
    """Return whether an object can be closed and is less than half open; unknown openness counts as closed."""
    return vocabulary.container(item.label) == "shut" and (item.openness is None or item.openness < OPEN_SHARE)


def with_containment(objects: Sequence[SceneObject], family: str) -> tuple[SceneObject, ...]:
    """Return the objects of a scene in the given order, with `parent`, `support` and `hidden` set; `objects` must
    already have rooms.

    Of several containers the smallest is the parent; any shut one hides. Structure (floors, walls) never contains or
    supports here. Parents and supports form no cycle.
    """
    links = _Links()
    of = {item.object_id: item for item in objects}
    for item in objects:
        if item.receptacles is not None:
            _stated(item, of, links)
    for members in _rooms(objects):
        _measured(members, links)
    hidden = set() if family in SCANNED else _hidden(of, links)
    parent = {name: min(around)[1] for name, around in links.inside.items()}
    support = {name: min(below)[1] for name, below in links.upon.items()}
    _without_cycles(parent, support)
    return tuple(
        replace(
            item,
            parent=parent.get(item.object_id),
            support=support.get(item.object_id),
            hidden=item.object_id in hidden,
        )
        for item in objects
    )


def stated_holders(objects: Sequence[SceneObject]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return two mappings from an object's id to the ids of other objects: those that the object is on, and those that
    the object is in. Each mapping has only the objects for which the source states this.
    """
    links, of = _Links(), {item.object_id: item for item in objects}
    for item in objects:
        _stated(item, of, links)
    upon, inside = ({k: [name for _, name in v] for k, v in found.items()} for found in (links.upon, links.inside))
    return upon, inside


@dataclass(frozen=True, slots=True)
class _Links:
    """For each object, by its id: the containers around the object, and the objects that it rests on. Each container or
    support is given as (rank, id); the lowest rank comes first.
    """

    inside: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    upon: dict[str, list[tuple[float, str]]] = field(default_factory=dict)


def _stated(item: SceneObject, of: Mapping[str, SceneObject], links: _Links) -> None:
    """Add the links that the source states for an object. A container's rank is its volume; a support's rank is the
    vertical distance between its top and the object.
    """
    for name in dict.fromkeys(item.receptacles or ()):
        holder = of.get(name)
        if holder is None or holder is item or vocabulary.is_structure(holder.label) or _too_large(item, holder):
            continue
        if _is_inside(item, holder):
            links.inside.setdefault(item.object_id, []).append(
                (_volume(None if holder.box is None else _mm(holder.box)), name)
            )
        else:
            gap = (
                0.0
                if item.box is None or holder.box is None
                else abs(float(_mm(item.box)[0, 1] - _mm(holder.box)[1, 1]))
            )
            links.upon.setdefault(item.object_id, []).append((gap, name))


def _is_inside(item: SceneObject, holder: SceneObject) -> bool:
    """Return whether `item` is inside `holder`, rather than on top of it; `holder` is a receptacle that the source
    states for `item`.

    Boxes of cabinets and drawers may cover a door alone, so being below the top suffices.
    """
    kind = vocabulary.container(holder.label)
    if kind is None:
        return False
    if item.box is None or holder.box is None:
        return kind == "shut"
    if kind == "shut":
        return bool(_mm(item.box)[0, 1] <= _mm(holder.box)[1, 1] - MM * TOP_DEPTH + SLACK)
    return float(_shares_inside(_mm(item.box)[None], _mm(holder.box)[None])[0, 0]) >= INSIDE_SHARE - SLACK


def _measured(members: Sequence[SceneObject], links: _Links) -> None:
    """Add the links that follow from the boxes of one room's objects. The links give containers and supports to objects
    for which the source states none.
    """
    things = [item for item in members if item.box is not None and not vocabulary.is_structure(item.label)]
    if not things:
        return
    boxes = np.array([_mm(item.box) for item in things if item.box is not None])
    volumes = np.array([_volume(box) for box in boxes])
    silent = [k for k, item in enumerate(things) if item.receptacles is None]
    holders = [k for k, item in enumerate(things) if vocabulary.container(item.label) is not None]
    if silent and holders:
        share = _shares_inside(boxes[silent], boxes[holders])
        for row, column in np.argwhere((share >= INSIDE_SHARE - SLACK) & (volumes[holders] > volumes[silent][:, None])):
            holder = holders[column]
            around = links.inside.setdefault(things[silent[row]].object_id, [])
            around.append((float(volumes[holder]), things[holder].object_id))
    linked = {*links.inside, *links.upon}
    free = [k for k, item in enumerate(things) if item.object_id not in linked]
    for k, below, share_over in _resting(things, boxes, free):
        links.upon.setdefault(things[k].object_id, []).append((-share_over, things[below].object_id))


def _resting(things: Sequence[SceneObject], boxes: F64, free: Sequence[int]) -> Iterator[tuple[int, int, float]]:
    """Yield (object, support, share): the indices of an object and of a support, and the share of the object's
    footprint that is over the support. Supports are larger than the object and just below it.
    """
    bearing = [(k, item) for k, item in enumerate(things) if item.label not in WITHOUT_TOP]
    tops = [(k, _mm(aabb_of(box_corners(part)))) for k, item in bearing for part in item.parts]
    tops += [(k, boxes[k]) for k, item in bearing if not item.parts]
    if not tops:
        return
    owner = np.array([k for k, _ in tops])
    slabs = np.array([box for _, box in tops])
    ground = boxes[:, :, [0, 2]]
    area = np.prod(np.maximum(ground[:, 1] - ground[:, 0], THIN), axis=1)
    centre_y = boxes[:, :, 1].mean(axis=1)
    for k in free:
        level = np.abs(boxes[k, 0, 1] - slabs[:, 1, 1]) <= MM * REST_GAP + SLACK
        candidates = np.flatnonzero(level & (owner != k) & (area[owner] > area[k]) & (centre_y[owner] < centre_y[k]))
        shared: dict[int, float] = {}
        for c in candidates:
            slab = slabs[c][:, [0, 2]]
            sides = np.minimum(ground[k, 1], slab[1]) - np.maximum(ground[k, 0], slab[0])
            part = float(np.prod(np.clip(sides, 0.0, None) / np.maximum(ground[k, 1] - ground[k, 0], THIN)))
            shared[int(owner[c])] = max(shared.get(int(owner[c]), 0.0), part)
        yield from ((k, below, share) for below, share in shared.items() if share >= REST_SHARE - SLACK)


def _hidden(of: Mapping[str, SceneObject], links: _Links) -> set[str]:
    """Return the ids of the objects inside shut containers, and of everything in or on these objects."""
    above: dict[str, list[str]] = {}
    for upward in (links.inside, links.upon):
        for name, others in upward.items():
            for _, below in others:
                above.setdefault(below, []).append(name)
    ahead = [name for name, around in links.inside.items() if any(is_shut(of[holder]) for _, holder in around)]
    hidden: set[str] = set()
    while ahead:
        name = ahead.pop()
        if name not in hidden:
            hidden.add(name)
            ahead += above.get(name, ())
    return hidden


def _without_cycles(parent: dict[str, str], support: dict[str, str]) -> None:
    """Remove the links by which an object would contain or support itself, in order of object id."""
    for links in (support, parent):
        for name in sorted(links):
            seen: set[str] = set()
            ahead = [links[name]]
            while ahead:
                at = ahead.pop()
                if at == name:
                    del links[name]
                    break
                if at not in seen:
                    seen.add(at)
                    ahead += [up[at] for up in (parent, support) if at in up]


def _rooms(objects: Sequence[SceneObject]) -> list[list[SceneObject]]:
    rooms: dict[str, list[SceneObject]] = {}
    for item in objects:
        rooms.setdefault(item.room_id, []).append(item)
    return [sorted(rooms[name], key=lambda item: item.object_id) for name in sorted(rooms)]


def _too_large(item: SceneObject, holder: SceneObject) -> bool:
    """Return whether the source must be wrong in claiming that `item` is in or on `holder`, because `item` is too
    large: simulators sometimes name a plate as the receptacle of the counter below the plate.
    """
    if item.box is None or holder.box is None:
        return False
    longest = [float(np.max(box[1] - box[0])) for box in (_mm(item.box), _mm(holder.box))]
    return longest[0] > LARGER_THAN_RECEPTACLE * longest[1]


def _mm(box: F64) -> F64:
    """Return a box (2, 3) in whole millimetres."""
    whole: F64 = np.rint(box * MM)
    return whole


def _volume(box: F64 | None) -> float:
    return float("inf") if box is None else float(np.prod(np.maximum(box[1] - box[0], THIN)))


def _shares_inside(boxes: F64, holders: F64) -> F64:
    """Return a table (n, m) of shares: how much of the volume of each of the boxes (n, 2, 3) lies in each of the
    holders (m, 2, 3).
    """
    low, high = boxes[:, 0], np.maximum(boxes[:, 1], boxes[:, 0] + THIN)
    sides = np.minimum(high[:, None], holders[None, :, 1]) - np.maximum(low[:, None], holders[None, :, 0])
    share: F64 = np.prod(np.clip(sides, 0.0, None) / (high - low)[:, None], axis=2)
    return share
