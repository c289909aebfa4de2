"""Hostile data: markup, quotes, control characters and marks of direction show as text, and nothing runs."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from condvln.explorer import Site, episode_document
from condvln.explorer.agents import AgentResults
from tests.browser.driver import Page
from tests.condvln.explorer.made_rows import made_manifest

HOSTILE = (
    "<img src=x onerror=window.hacked=1>",
    "</script><script>window.hacked=1</script>",
    "\"'`;window.hacked=1;//${window.hacked=1}",
    "a\u202egnp.exe\u2066b\u200fc\u0000d\u001b[31m\u2028e\ufeff",
    "javascript:window.hacked=1",
    "__proto__",
    "x" * 3000,
)

SELECT = """const field = document.getElementById('filter-source');
field.value = arguments[0];
field.dispatchEvent(new Event('change'));"""


def made_hostile(out: Path) -> list[dict[str, Any]]:
    """Write a page all of whose texts are hostile, and return the rows of its episodes."""
    rows = []
    for k, made in enumerate(made_manifest(3)):
        row, text = copy.deepcopy(made), HOSTILE[k % len(HOSTILE)]
        row.update(instruction_text=f"If {text}, go to {text}.", split=text, source=text, scene_id=text, group_id=text)
        for condition in row["program"]["conditions"]:
            condition["label"] = condition["room"]["label"] = condition["room"]["anchor_label"] = text
        for leaf in row["program"]["leaves"]:
            for move in leaf["moves"]:
                move["label"] = text
        for leaf in row["leaves"]:
            leaf["object_id"] = text
        rows.append(row)
    site = Site(out)
    for text in HOSTILE:
        own = [row for row in rows if row["scene_id"] == text]
        item = {
            "id": text, "label": text, "raw": text, "room": 0, "center": [0, 0, 0], "shape": [[0, 0, 1, 0, 1, 1, 0, 1]],
            "low": 0, "high": 1, "geometry": "aabb", "parent": text, "support": text, "hidden": False, "seeable": True,
        }  # fmt: skip
        room = {
            "id": text, "label": text, "raw": text, "level": 0, "floor": 0, "ceiling": 2,
            "polygon": [[-1, -1], [3, -1], [3, 3], [-1, 3]], "annotation": "dataset", "complete": True,
        }  # fmt: skip
        proof = {"proven": False, "checked": {}, "conditions": [], "disagreements": [{"fact": text}]}
        documents = [episode_document(row, certificate=proof) for row in own]
        site.add_scene(text, text, own, documents, plan={"rooms": [room], "objects": [item], "floor": []})
    agents = [AgentResults(text, text, {str(rows[0]["episode_id"]): (1, {"spl": 1.0})}) for text in HOSTILE]
    statistics: dict[str, Any] = {
        "objects": [], "rooms": [], "relations": [[text, text, 1, 1] for text in HOSTILE],
        "funnel": [[text, text, 1, 1, 1, 1] for text in HOSTILE],
        "rejections": [
            {**dict.fromkeys(("source", "stage", "reason", "rule"), text), "count": 1, "places": [[text, 1]],
             "examples": [{**dict.fromkeys(("scene", "cell", "example"), text), "objects": [text]}]}
            for text in HOSTILE
        ],
        "gate": None, "left_out": dict.fromkeys(HOSTILE, 1),
        "drift": {
            "before": HOSTILE[0], "by": "split", "kept": 1, "gone": 1, "new": 1, "reworded": 1,
            "cells": [[text, text, 1, 2] for text in HOSTILE], "scenes": [[text, text, 1, 2] for text in HOSTILE],
        },
    }  # fmt: skip
    table = {
        "name": HOSTILE[0],
        "title": HOSTILE[1],
        "note": HOSTILE[2],
        "split": "s",
        "rows": [{HOSTILE[0]: HOSTILE[3]}],
        "headings": [HOSTILE[0]],
        "cells": [[text] for text in HOSTILE],
    }
    site.finish(HOSTILE[0], snapshot=HOSTILE[1], statistics=statistics, agents=agents, tables=[table])
    return rows


@pytest.fixture(scope="module")
def hostile(in_make_browser: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("hostile")
    return folder, made_hostile(folder)


def test_hostile_text_is_text(chromium: Any, hostile: tuple[Path, list[dict[str, Any]]]) -> None:
    folder, rows = hostile
    page = Page(chromium, folder)
    ids = [str(row["episode_id"]) for row in rows[: len(HOSTILE)]]
    addresses = [
        "#/browse",
        "#/statistics",
        "#/agents",
        "#/scenes",
        *(f"#/episode/{name}" for name in ids),
        "#/group/0",
    ]
    for address in addresses:
        page.open(address)
        assert page.run("return window.hacked === undefined"), address
        assert page.run("return Object.prototype.polluted === undefined && ({}).hacked === undefined")
        strange = (
            "script:not([src$='.js']), img:not([src^='frames/']), iframe, object, [onerror], a[href^='javascript']"
        )
        assert page.all(strange) == []
        hidden = page.run(
            "return /[\\u202a-\\u202e\\u2066-\\u2069\\u200f\\u0000\\u001b]/.test(document.body.innerText)"
        )
        assert not hidden, address
        assert not page.all("[role=alert]"), address
    page.open(f"#/episode/{ids[0]}")
    assert HOSTILE[0] in page.one(".instruction").text
    page.open(f"#/episode/{ids[3]}")
    assert "a⟨U+202E⟩gnp.exe⟨U+2066⟩b⟨U+200F⟩c⟨U+0000⟩d" in page.one(".instruction").text
    page.open("#/browse")
    for text in HOSTILE[:3]:
        page.run(SELECT, text)
        wanted = str(sum(row["source"] == text for row in rows))
        page.until("return document.getElementById('count').dataset.count === arguments[0]", wanted)
    page.note()
    assert page.messages == []
    assert page.outside() == []


def test_the_policy_forbids_what_is_elsewhere(chromium: Any, hostile: tuple[Path, list[dict[str, Any]]]) -> None:
    page = Page(chromium, hostile[0])
    page.open()
    # Each of these would ask for something; the policy stops it, and the console says so.
    for code in (
        "document.body.append(Object.assign(new Image(), {src: 'http://127.0.0.1:9/x.png'}))",
        "fetch('http://127.0.0.1:9/').catch(() => 0)",
        "document.body.append(Object.assign(document.createElement('script'), {src: 'http://127.0.0.1:9/x.js'}))",
        "document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.hacked = 1'}))",
    ):
        page.messages.clear()
        page.run(code)
        page.settle()
        assert any("Content Security Policy" in message for message in page.messages), code
    assert page.run("return window.hacked === undefined")
