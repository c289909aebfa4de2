"""What the page says of a relation is what the facts of text decide; margins are differences of what it writes."""

from __future__ import annotations

import re
import sys
from collections import Counter
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.explorer.evidence import rule_of
from condvln.explorer.measures import Criterion, RoomMeasures, bearing_criteria, decided, said_of
from condvln.relations import relate_room, text_facts
from condvln.relations.directions import COMPASS, bearing_status, sighted
from condvln.scene import RoomArrays, SceneObject, round_mm
from schemas.config import Thresholds
from schemas.program import BEARINGS, QUALIFIER_ONLY, Anchor, Predicate, Qualifier, anchors_of

sys.path.insert(0, str(Path(__file__).parents[1] / "relations"))
from layered_rooms import layered_room

T = Thresholds()
ASKED = ("on", "in", "near", "above", "below", "higher than", "lower than", "far from", *COMPASS)
BY_SOURCE = ("on", "in")
"""Predicates that the source may decide where boxes do not."""


def thing(name: str, low: tuple[float, float, float], high: tuple[float, float, float]) -> SceneObject:
    box = round_mm([low, high])
    return SceneObject(name, "room", name, name, round_mm(box.mean(axis=0)), aabb=box)


def measured(predicate: str, *objects: SceneObject, surface: float | None = None) -> list[list[Criterion]]:
    room = RoomMeasures(RoomArrays.of("room", list(objects), 0.0), T)
    return room.criteria(predicate, objects[0].object_id, [one.object_id for one in objects[1:]], surface)


def test_a_false_near_says_by_how_much() -> None:
    lamp, bed = thing("lamp", (0, 0, 0), (0.2, 1, 0.2)), thing("bed", (2.81, 0, 0), (4, 0.5, 2))
    found = decided("near", measured("near", lamp, bed), False)
    assert found["says"] == (
        "distance on the ground 2.61 m; “not near” needs at least 2.25 m; so it is false, by 0.36 m "
        "(“near” needs: distance at most 0.50 m)"
    )
    assert (found["margin"], found["unit"]) == (0.36, "m")
    assert [one["name"] for one in found["criteria"] if one["decides"]] == ["distance on the ground"]


@pytest.mark.parametrize(("predicate", "truth"), [("south of", False), ("east of", True)])
def test_what_either_truth_needs_decides_neither(predicate: str, truth: bool) -> None:
    """The two are near enough for a compass word, by less than anything else; the direction decides all the same."""
    table, sofa = thing("table", (2.4, 0, 0), (2.8, 0.5, 0.4)), thing("sofa", (-0.2, 0, -0.2), (0.2, 0.5, 0.2))
    found = decided(predicate, measured(predicate, table, sofa), truth)
    (name,) = (one["name"] for one in found["criteria"] if one["decides"])
    assert found["unit"] == "°"
    assert found["says"].startswith(f"{name} ")
    assert (
        found["says"].endswith(f"so it is {str(truth).lower()}, by {found['margin']:g}°") or "needs:" in found["says"]
    )


def test_what_lies_between_the_bounds_is_said_to_be_neither() -> None:
    lamp, bed = thing("lamp", (0, 0, 0), (0.2, 1, 0.2)), thing("bed", (1.2, 0, 0), (4, 0.5, 2))
    found = decided("near", measured("near", lamp, bed), False)
    assert found["margin"] is None
    assert found["says"] == "distance on the ground 1.00 m: between the bounds, so text says neither"


def test_boxes_that_touch_do_not_deny_a_support() -> None:
    desk = thing("desk", (0, 0, 0), (1, 0.75, 0.5))
    over = thing("cup", (0.2, 0.8, 0.1), (0.3, 0.9, 0.2))
    half_in = thing("cup", (0.2, 0.7, 0.1), (0.3, 0.9, 0.2))
    for predicate, cup, name in (("on", over, "distance between the footprints"), ("in", half_in, "distance")):
        found = decided(predicate, measured(predicate, cup, desk), False)
        assert found["margin"] is None
        assert not any(one["decides"] for one in found["criteria"])
        assert found["says"] == f"{name} 0.00 m: the boxes do not decide it, only the source can"


def test_of_an_unknown_size_no_number_is_said() -> None:
    bed = thing("bed", (2, 0, 0), (4, 0.5, 2))
    pair = [
        Criterion("distance", np.nan, "m", ("≤", 0.5)),
        Criterion("distance on the ground", np.nan, "m", None, ("≥", 1.0)),
    ]
    found = decided("near", [pair], False)
    assert (found["says"], found["margin"]) == ("the size or place of one of the two is unknown", None)
    assert [one["value"] for one in found["criteria"]] == [None, None]
    assert decided("near", measured("near", thing("lamp", (0, 0, 0), (1, 1, 1)), bed), False)["says"] != found["says"]


def test_each_fact_of_text_has_a_margin() -> None:
    tally: Counter[tuple[str, bool]] = Counter()
    for seed in range(7):
        arrays = RoomArrays.of("room", layered_room(np.random.default_rng(seed)), 0.0)
        relations = relate_room(arrays, T)
        facts, measures = text_facts(relations, T), RoomMeasures(arrays, T)
        names = arrays.object_ids
        for predicate in ASKED:
            status = facts.status[predicate]
            denied = facts.denied.get(predicate, status == -1)
            for i, j in np.argwhere((status == 1) | denied):
                truth = bool(status[i, j] == 1)
                surface = float(relations.surface[i, j])
                pairs = measures.criteria(predicate, names[i], [names[j]], None if np.isnan(surface) else surface)
                found = decided(predicate, pairs, truth)
                if found["margin"] is None:
                    assert predicate in BY_SOURCE, (predicate, truth, names[i], names[j], found["says"])
                    continue
                tally[predicate, truth] += 1
                (deciding,) = (one for one in found["criteria"] if one["decides"])
                bound = float(re.findall(r"-?[\d.]+", deciding["true" if truth else "false"])[0])
                value = abs(deciding["value"]) if "within" in deciding["true"] and truth else deciding["value"]
                assert found["margin"] == pytest.approx(abs(value - bound), abs=1e-9)
                assert found["says"].split(" (")[0].endswith(f"so it is {str(truth).lower()}, by {written(found)}")
    assert all(
        tally[predicate, truth] for predicate in ("near", "on", "north of", "far from") for truth in (True, False)
    )


def written(found: dict[str, object]) -> str:
    digits = {"m": 2, "°": 1, "%": 0}[str(found["unit"])]
    return f"{found['margin']:.{digits}f}{'' if found['unit'] == '°' else ' '}{found['unit']}"


@settings(max_examples=60)
@given(
    place=st.tuples(*[st.floats(-4, 4)] * 2), low=st.tuples(*[st.floats(-4, 4)] * 2),
    size=st.tuples(*[st.floats(0.05, 2)] * 2), heading=st.floats(0, 360), direction=st.sampled_from(BEARINGS),
)  # fmt: skip
def test_each_bearing_of_text_has_a_margin(
    place: tuple[float, float], low: tuple[float, float], size: tuple[float, float], heading: float, direction: str
) -> None:
    start = np.array([place[0], 0.0, place[1]])
    box = np.array([[low[0], 0.0, low[1]], [low[0] + size[0], 1.0, low[1] + size[1]]])
    status = int(bearing_status(sighted(start[None], box, T), direction, [heading], T)[0, 0])
    if status:
        found = decided(direction, [bearing_criteria(direction, start, heading, box, T)], status == 1)
        assert found["margin"] is not None


@pytest.mark.parametrize("predicate", sorted({*get_args(Predicate)} - {*QUALIFIER_ONLY}))
def test_each_predicate_of_a_condition_has_a_rule_and_a_measure(predicate: Predicate) -> None:
    objects = [
        thing("one", (0, 0, 0), (1, 1, 1)),
        thing("two", (2, 0, 0), (3, 1, 1)),
        thing("three", (4, 0, 0), (5, 1, 1)),
    ]
    anchors = tuple(Anchor(object_id=one.object_id, label="x") for one in objects[1 : 1 + anchors_of(predicate)])
    rule = rule_of(Qualifier(predicate=predicate, anchors=anchors), T)
    assert rule
    assert not re.search(r"[{}]", rule)
    if predicate in BEARINGS or predicate in COMPASS:
        assert f" of {predicate.removesuffix(' of')} " in rule
    if predicate in BEARINGS:
        pairs = [bearing_criteria(predicate, np.zeros(3), 0.0, np.asarray(objects[1].box), T)]
    else:
        pairs = measured(predicate, *objects[: 1 + anchors_of(predicate)])
    assert decided(predicate, pairs, True)["criteria"]


def test_without_words_of_its_own_a_predicate_is_said_by_its_bounds() -> None:
    one, other = thing("one", (0, 0, 0), (1, 0.3, 1)), thing("other", (0, 0.6, 0), (2, 1, 2))
    assert said_of("under")["rule"].startswith(f"off floor at most {1000 * T.on_floor:g} mm, room below at least 0 mm")
    assert "; false: apart at least" in said_of("under")["rule"]
    found = decided("under", measured("under", one, other), True)
    assert [one["name"] for one in found["criteria"]] == ["off floor", "room below", "covered", "apart"]
    assert [one["unit"] for one in found["criteria"]] == ["m", "m", "%", "m"]


def test_without_criteria_nothing_is_said() -> None:
    one, other = thing("one", (0, 0, 0), (1, 1, 1)), thing("other", (2, 0, 0), (3, 1, 1))
    assert decided("closest to", measured("closest to", one, other), True) == {}
    assert measured("near", one) == []
