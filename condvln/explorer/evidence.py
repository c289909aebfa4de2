"""What decides a condition: its witnesses or rivals, with the measure that the condition's predicate tests."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import shapely

from condvln.explorer.measures import RoomMeasures, bearing_criteria, decided, said_of
from condvln.instructions.referents import things_meant
from condvln.labels import vocabulary
from condvln.scene import Scene
from schemas.base import Json, Row
from schemas.config import Thresholds
from schemas.program import BEARINGS, Condition, Qualifier

__all__ = ["SceneFacts", "rule_of"]


class SceneFacts:
    """The relations of one scene, looked up by pairs of objects.

    Parameters
    ----------
    relations : rows of the table ``relations`` of the scene, points as lists
    """

    def __init__(self, scene: Scene, relations: Iterable[Row], thresholds: Thresholds | None = None) -> None:
        self._scene, self._thresholds = scene, thresholds or Thresholds()
        self._pairs: dict[tuple[str, str], Row] = {}
        self._rooms: dict[str, RoomMeasures] = {}
        self._meant: dict[tuple[str, str], tuple[str, ...]] = {}
        for row in relations:
            if row["kind"] == "canonical":
                self._pairs[row["subject"], row["target"]] = row

    def of(self, condition: Condition, start: Row, heading: float) -> Json:
        """Return the evidence for a condition as the page shows it.

        Parameters
        ----------
        start : position of the start with x, y and z, metres
        heading : degrees clockwise from north

        Returns
        -------
        ``rule``: what holds where the condition is true; ``things``: each object that the label may mean, with its role
        (``witness``, ``rival`` or ``elsewhere``), and for a relation the measures that decide it.
        """
        here = self._things(condition)
        things = []
        for name in dict.fromkeys((*condition.witnesses, *here)):
            role = "witness" if name in condition.witnesses else "rival"
            thing: Json = {"id": name, "role": role}
            if condition.qualifier is not None:
                thing |= self._measured(name, condition.qualifier, start, heading, role == "witness")
            things.append(thing)
        # The clearest witness and the rival that is nearest to being one come first.
        things.sort(key=_margin, reverse=condition.truth)
        things.sort(key=lambda thing: str(thing["role"]), reverse=True)
        if not things:
            things = self._elsewhere(condition)
        return {"rule": rule_of(condition.qualifier, self._thresholds), "things": things}

    def _elsewhere(self, condition: Condition) -> list[Json]:
        """Return the objects with the label in other rooms, the nearest to the condition's room first."""
        room = self._scene.room_of.get(condition.room.room_id)
        outline = (
            None if room is None or room.polygon is None or len(room.polygon) < 3 else shapely.Polygon(room.polygon)
        )
        found = []
        for item in self._scene.objects:
            if item.label != condition.label or item.room_id == condition.room.room_id:
                continue
            at = shapely.Point(float(item.center[0]), float(item.center[2]))
            apart = None if outline is None else _rounded(outline.distance(at))
            found.append({"id": item.object_id, "role": "elsewhere", "apart": apart})
        return sorted(found, key=lambda thing: (thing["apart"] or 0.0, thing["id"]))

    def _things(self, condition: Condition) -> tuple[str, ...]:
        key = condition.room.room_id, condition.label
        if key not in self._meant:
            known = key[0] in self._scene.room_of
            self._meant[key] = things_meant(self._scene, *key, vocabulary) if known else ()
        return self._meant[key]

    def _measured(self, name: str, qualifier: Qualifier, start: Row, heading: float, truth: bool) -> Json:
        subject = self._scene.object_of.get(name)
        if subject is None:
            return {}
        predicate = qualifier.predicate
        if predicate in BEARINGS:
            if subject.box is None:
                return {}
            place = np.array([start[axis] for axis in "xyz"], dtype=np.float64)
            criteria = bearing_criteria(predicate, place, heading, np.asarray(subject.box), self._thresholds)
            return decided(predicate, [criteria], truth)
        found: Json = {}
        surface = None
        for anchor in qualifier.anchor_ids:
            pair = self._pairs.get((name, anchor))
            if pair is not None:
                surface = pair["surface_distance"]
                found |= {"used": _rounded(pair["used_distance"]), "metric": pair["used_metric"]}
        measures = self._room(subject.room_id).criteria(predicate, name, qualifier.anchor_ids, surface)
        return found | decided(predicate, measures, truth)

    def _room(self, room_id: str) -> RoomMeasures:
        if room_id not in self._rooms:
            self._rooms[room_id] = RoomMeasures(self._scene.arrays(room_id), self._thresholds)
        return self._rooms[room_id]


def rule_of(qualifier: Qualifier | None, thresholds: Thresholds) -> str:
    """Return in words what a condition's predicate asks for."""
    if qualifier is None:
        return "the room holds such an object that can be seen"
    way = qualifier.predicate.removesuffix(" of")
    return str(said_of(qualifier.predicate)["rule"]).format(t=thresholds, way=way)


def _margin(thing: Json) -> float:
    margin = thing.get("margin")
    return -1.0 if margin is None else float(margin)


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 3)
