"""The plan as an SVG file: everything of the episode is drawn to scale, bytes repeat, and text stays text."""

from __future__ import annotations

import copy
from typing import Any
from xml.etree import ElementTree

import pytest

from condvln.explorer import episode_document
from condvln.explorer.picture import GOLD, plan_picture
from tests.condvln.explorer.made_rows import made_manifest

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def episode() -> dict[str, Any]:
    return max(map(episode_document, made_manifest(4)), key=lambda one: len(one["leaves"]))


def plan(label: str = "sofa") -> dict[str, Any]:
    square = [0.0, 0.0, 2.0, 0.0, 2.0, 1.0, 0.0, 1.0]
    item = {"id": "o", "label": label, "center": [1.0, 0.4, 0.5], "shape": [square], "structure": False}
    room = {"label": "living room", "polygon": [[-1.0, -1.0], [4.0, -1.0], [4.0, 3.0], [-1.0, 3.0]]}
    return {"rooms": [room], "objects": [item], "floor": [[0.1, -1.0, -1.0, 4.0, -1.0, 4.0, 3.0]]}


def points(node: ElementTree.Element) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in (pair.split(",") for pair in node.attrib["points"].split())]


def test_ways_and_rooms_are_drawn_to_one_scale(episode: dict[str, Any]) -> None:
    data = plan_picture(plan(), episode)
    assert data == plan_picture(plan(), copy.deepcopy(episode))
    drawn = ElementTree.fromstring(data)
    ways = drawn.findall(f"{SVG}polyline")
    assert len(ways) == len(episode["leaves"])
    assert [way.attrib["stroke"] == GOLD for way in ways] == [False] * (len(ways) - 1) + [True], "gold lies on top"
    room = points(drawn.findall(f"{SVG}polygon")[0])
    scale = (room[1][0] - room[0][0]) / 5.0
    gold = next(leaf for leaf in episode["leaves"] if leaf["leaf"] == episode["gold"])
    for (x, y), corner in zip(points(ways[-1]), gold["path"], strict=True):
        assert (x - room[0][0]) / scale - 1.0 == pytest.approx(corner[0], abs=0.01)
        assert (y - room[0][1]) / scale - 1.0 == pytest.approx(corner[2], abs=0.01)
    width, height = float(drawn.attrib["width"]), float(drawn.attrib["height"])
    assert all(0 <= x <= width and 0 <= y <= height for node in ways for x, y in points(node))
    written = [node.text for node in drawn.findall(f"{SVG}text")]
    assert {str(leaf["leaf"]) for leaf in episode["leaves"]} <= set(written)
    assert "living room" in written


@pytest.mark.parametrize("label", ["<script>alert(1)</script>", "a & b", "\x00\x1b[1m", "\u202eevil", "]]>", "\ud800"])
def test_a_hostile_label_is_text(label: str, episode: dict[str, Any]) -> None:
    drawn = ElementTree.fromstring(plan_picture(plan(label), episode))
    assert {node.tag.removeprefix(SVG) for node in drawn.iter()} <= {
        "svg", "title", "rect", "path", "polygon", "polyline", "circle", "text"
    }  # fmt: skip
    assert not any(name.startswith("on") or "href" in name for node in drawn.iter() for name in node.attrib)
