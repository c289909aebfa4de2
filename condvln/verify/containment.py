"""Find the objects in shut containers from the source's statements and from boxes, one object at a time.

The scene's own `parent`, `support` and `hidden` are not read, since they are to be verified.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final

from condvln.scene import SceneObject
from condvln.verify.surroundings import Point, Said, Thing
from condvln.verify.words import Words
from schemas.config.constants import (
    INSIDE_SHARE,
    LARGER_THAN_RECEPTACLE,
    OPEN_SHARE,
    REST_GAP,
    REST_SHARE,
    TOP_DEPTH,
)

__all__ = ["said_of", "shut_away"]

_MM: Final = 1000
FROM_SCANS: Final = ("gibson", "hm3d", "mp3d")
"""Families whose scenes are scans: what the scanner saw is not hidden."""
IN_FURNITURE: Final = "drawer"
"""Labels of objects whose top lies inside the furniture they belong to, so that nothing rests on it."""

_Box = tuple[Point, Point]


def shut_away(
    items: Sequence[SceneObject], family: str, label_of: Callable[[SceneObject], str], meaning: Words
) -> frozenset[str]:
    """Return the ids of objects that can't be seen because they are inside something shut, directly or via objects that
    they are in or on.
    """
    if family in FROM_SCANS:
        return frozenset()
    things = {item.object_id: _Holder(item, label_of(item), meaning) for item in items}
    found: set[str] = set()
    for name in things:
        reached: set[str] = set()
        ahead = [name]
        while ahead and name not in found:
            for holder, inside in _below(things[ahead.pop()], things):
                if inside and holder.shut:
                    found.add(name)
                elif holder.name not in reached:
                    reached.add(holder.name)
                    ahead.append(holder.name)
    return frozenset(found)


def said_of(items: Sequence[SceneObject], label_of: Callable[[SceneObject], str], meaning: Words) -> Said:
    """Return the source's own statements about where objects are; see `Said`."""
    things = {item.object_id: _Holder(item, label_of(item), meaning) for item in items}
    return {
        name: [(holder.name, inside) for holder, inside in _stated(thing, things)]
        for name, thing in things.items()
        if thing.item.receptacles
    }


class _Holder:
    """An object that may hold others: the kind of container that it is, whether it is shut, and its boxes in whole
    millimetres.
    """

    def __init__(self, item: SceneObject, label: str, meaning: Words) -> None:
        self.item = item
        self.name = item.object_id
        self.label = label
        self.kind = meaning.containers.get(label, "")
        self.shut = self.kind == "shut" and not (item.openness is not None and item.openness >= OPEN_SHARE)
        self.structure = label in meaning.structure
        thing = Thing.of(item, label)
        self.box = thing.box
        self.tops = [solid.box for solid in thing.solids() if solid.box is not None]
        self.links: list[tuple[_Holder, bool]] | None = None
        x, y, z = (0, 0, 0) if self.box is None else map(int.__sub__, self.box[1], self.box[0])
        self.area = max(x, 1) * max(z, 1)
        self.volume = float(max(x, 1)) * max(y, 1) * max(z, 1)
        self.middle = 0 if self.box is None else self.box[0][1] + self.box[1][1]
        """Twice the height of the middle of its box."""


def _below(thing: _Holder, things: dict[str, _Holder]) -> list[tuple[_Holder, bool]]:
    """Return the objects that `thing` is in or on, each with whether `thing` is in it (True) or on it (False)."""
    if thing.links is None:
        thing.links = list(_stated(thing, things)) if thing.item.receptacles is not None else []
        others = [x for x in things.values() if x is not thing and x.item.room_id == thing.item.room_id]
        if thing.box is not None and not thing.structure:
            others = [x for x in others if x.box is not None and not x.structure]
            if thing.item.receptacles is None:
                thing.links += [(x, True) for x in others if x.kind and _encloses(x, thing)]
            if not thing.links:
                thing.links += [(x, False) for x in others if x.label != IN_FURNITURE and _bears(x, thing)]
    return thing.links


def _stated(thing: _Holder, things: dict[str, _Holder]) -> Iterable[tuple[_Holder, bool]]:
    for name in thing.item.receptacles or ():
        holder = things.get(name)
        if holder is None or holder is thing or holder.structure:
            continue
        own, its = thing.box, holder.box
        if own is None or its is None:
            yield holder, holder.kind == "shut"
            continue
        if max(_sides(own)) > LARGER_THAN_RECEPTACLE * max(_sides(its)):
            continue
        if holder.kind == "shut":
            yield holder, own[0][1] <= its[1][1] - TOP_DEPTH * _MM + 1e-6
        else:
            yield holder, holder.kind == "open" and _share_inside(own, its) >= INSIDE_SHARE - 1e-6


def _encloses(holder: _Holder, thing: _Holder) -> bool:
    assert holder.box is not None
    assert thing.box is not None
    return holder.volume > thing.volume and _share_inside(thing.box, holder.box) >= INSIDE_SHARE - 1e-6


def _bears(holder: _Holder, thing: _Holder) -> bool:
    """Return whether `holder` supports `thing`: it is larger, its top is near the bottom of `thing`, and enough of
    `thing` is above it.
    """
    if holder.area <= thing.area or holder.middle >= thing.middle:
        return False
    own = thing.box
    assert own is not None
    shared = 0.0
    for top in holder.tops:
        if abs(own[0][1] - top[1][1]) <= REST_GAP * _MM + 1e-6:
            over = [max(min(own[1][k], top[1][k]) - max(own[0][k], top[0][k]), 0) for k in (0, 2)]
            shared = max(shared, over[0] * over[1] / thing.area)
    return shared >= REST_SHARE - 1e-6


def _share_inside(box: _Box, holder: _Box) -> float:
    """Return the share of the volume of `box` inside `holder`; each box counts as at least a millimetre thick."""
    share = 1.0
    for k in range(3):
        low, high = box[0][k], max(box[1][k], box[0][k] + 1)
        share *= max(min(high, holder[1][k]) - max(low, holder[0][k]), 0) / (high - low)
    return share


def _sides(box: _Box) -> list[int]:
    return [high - low for low, high in zip(*box, strict=True)]
