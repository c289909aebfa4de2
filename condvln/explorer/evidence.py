"""What decides a condition: its witnesses or rivals, with the measure that the condition's predicate tests."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from condvln.instructions.referents import things_meant
from condvln.labels import vocabulary
from condvln.scene import Scene, SceneObject
from schemas.config import Thresholds
from schemas.program import BEARINGS, Condition, Qualifier

__all__ = ["SceneFacts", "rule_of"]

Row = Mapping[str, Any]
Document = dict[str, Any]
_SECTORS: Final = {
    name: 45.0 * k
    for k, name in enumerate(("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east"))
}
_BEARINGS: Final = {"ahead": 0.0, "right": 90.0, "behind": 180.0, "left": 270.0}
_METRES, _DEGREES, _SHARE = "m", "°", "share"


class SceneFacts:
    """The relations of one scene, looked up by pairs of objects.

    Parameters
    ----------
    relations : rows of the table ``relations`` of the scene, points as lists
    """

    def __init__(self, scene: Scene, relations: Iterable[Row], thresholds: Thresholds | None = None) -> None:
        self._scene, self._thresholds = scene, thresholds or Thresholds()
        self._pairs: dict[tuple[str, str], Row] = {}
        self._edges: dict[tuple[str, str, str], Row] = {}
        self._meant: dict[tuple[str, str], tuple[str, ...]] = {}
        for row in relations:
            if row["kind"] == "canonical":
                self._pairs[row["subject"], row["target"]] = row
            elif row["kind"] == "semantic":
                self._edges[row["subject"], row["target"], row["predicate"]] = row

    def of(self, condition: Condition, start: Row, heading: float) -> Document:
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
            thing: Document = {"id": name, "role": role}
            if condition.qualifier is not None:
                thing |= self._measured(name, condition.qualifier, start, heading)
            things.append(thing)
        if not things:
            room = condition.room.room_id
            elsewhere = [o for o in self._scene.objects if o.label == condition.label and o.room_id != room]
            things = [{"id": item.object_id, "role": "elsewhere"} for item in elsewhere]
        return {"rule": rule_of(condition.qualifier, self._thresholds), "things": things}

    def _things(self, condition: Condition) -> tuple[str, ...]:
        key = condition.room.room_id, condition.label
        if key not in self._meant:
            known = key[0] in self._scene.room_of
            self._meant[key] = things_meant(self._scene, *key, vocabulary) if known else ()
        return self._meant[key]

    def _measured(self, name: str, qualifier: Qualifier, start: Row, heading: float) -> Document:
        subject = self._scene.object_of.get(name)
        if subject is None:
            return {}
        if qualifier.predicate in BEARINGS:
            off = _turned(subject, start, heading)
            return {"measure": "bearing", "value": _rounded(off), "unit": _DEGREES}
        found: Document = {}
        for anchor in qualifier.anchor_ids:
            pair, edge = self._pairs.get((name, anchor)), self._edges.get((name, anchor, qualifier.predicate))
            if pair is not None:
                measure, value, unit = _deciding(qualifier.predicate, pair)
                found |= {"measure": measure, "value": _rounded(value), "unit": unit}
                found |= {"used": _rounded(pair["used_distance"]), "metric": pair["used_metric"]}
            if edge is not None:
                found |= {"emitted": True, "in_text": edge["true_in_text"], "margin": _rounded(edge["margin"])}
        return found


def rule_of(qualifier: Qualifier | None, thresholds: Thresholds) -> str:
    """Return in words what a condition's predicate asks for."""
    if qualifier is None:
        return "the room holds such an object that can be seen"
    t, predicate = thresholds, qualifier.predicate
    rules = {
        "near": f"distance ≤ {t.near_true:g} m, denied from {t.near_false:g} m",
        "far from": f"distance ≥ {t.far_true:g} m, denied up to {t.far_false:g} m",
        "higher than": f"centre ≥ {t.height_true:g} m higher, denied below {t.height_false:g} m",
        "lower than": f"centre ≥ {t.height_true:g} m lower, denied below {t.height_false:g} m",
        "above": f"centre ≥ {t.height_true:g} m higher and ≤ {t.over_horizontal_true:g} m apart on the ground",
        "below": f"centre ≥ {t.height_true:g} m lower and ≤ {t.over_horizontal_true:g} m apart on the ground",
        "on": "rests on it",
        "in": "lies in it",
        "under": "stands under it",
        "between": "stands between the two",
        "closest to": "the closest of its kind",
    }
    if predicate in _BEARINGS:
        return f"bearing at the start within 30° of {predicate}"
    return rules.get(predicate, f"direction within 15° of {predicate.removesuffix(' of')}")


def _deciding(predicate: str, pair: Row) -> tuple[str, float | None, str]:
    if predicate in ("near", "far from", "closest to"):
        return "distance", pair["used_distance"], _METRES
    if predicate in ("higher than", "lower than", "above", "below"):
        return "height difference", None if pair["delta"] is None else -pair["delta"][1], _METRES
    sector = _SECTORS.get(predicate.removesuffix(" of"))
    if sector is not None:
        azimuth = pair["azimuth"]
        off = None if azimuth is None else abs((azimuth - sector + 180.0) % 360.0 - 180.0)
        return "off the direction", off, _DEGREES
    if predicate in ("on", "in", "under"):
        return "footprint overlap", pair["footprint_overlap"], _SHARE
    return "distance", pair["used_distance"], _METRES


def _turned(item: SceneObject, start: Row, heading: float) -> float:
    """Return the bearing of an object from the start, degrees clockwise from straight ahead, −180 to 180."""
    east, north = float(item.center[0]) - start["x"], start["z"] - float(item.center[2])
    return (math.degrees(math.atan2(east, north)) - heading + 180.0) % 360.0 - 180.0


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 3)
