"""``condvln verify`` of texts without an episode: all are proven, and mutants of them are caught."""

from __future__ import annotations

import copy
import io
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from condvln.instructions import names_compass, render
from condvln.sources.registry import open_source
from condvln.verify.certificate import VerifierRules
from condvln.verify.corpus import Corpus
from condvln.verify.proof import prove_texts
from condvln.verify.surfaces import Shapes
from jobs.generate import run_generate
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config
from schemas.program import CATEGORIES, Program
from tests.jobs.conftest import made_config, remove

Row = dict[str, Any]
FAMILIES = ("gibson", "mp3d")
PARTS = ("category", "conditions", "branches", "leaves")


@cache
def made(family: str, folder: Path) -> Config:
    """The configuration of a run over made scans of a family without navmeshes and graphs, after it."""
    config = made_config(folder / family, family, 3, 5, episodes=8)
    remove(folder / family / "data", "*.glb", "*.navmesh", "*_connectivity.json")
    run_generate(config, inline=True, console=Console(file=io.StringIO()))
    return config


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("texts")


def rows_of(config: Config) -> list[Row]:
    family = config.sources[0].family
    return [row for row in published(config).table("instructions", partition=family).to_pylist() if row["text"]]


@pytest.mark.parametrize("family", FAMILIES)
def test_all_texts_are_proven(family: str, runs: Path) -> None:
    config = made(family, runs)
    assert config.export is not None
    report = verify_export(config, config.export)
    count = len(rows_of(config))
    assert count >= 30
    assert report.document["texts"] == {"texts": count, "proven": count}, report.lines
    assert report.exit_code == 0, report.lines


def test_directions_of_a_start_that_is_not_there_are_said_to_be_unproven(runs: Path) -> None:
    """Neither wrong nor silent: the rest of such a text is proven, and still refuted where it is wrong."""
    config = made("gibson", runs)
    rules = VerifierRules(directions="egocentric")
    source = open_source("gibson", config.sources[0].root)
    row = next(
        row
        for row in rows_of(config)
        if row["leaves"][0]["moves"][-1]["qualifier"] is None
        and not names_compass(Program.model_validate({name: row[name] for name in PARTS}))
    )
    row["leaves"][0]["moves"][-1]["qualifier"] = {"predicate": "left", "anchors": []}
    word(row)
    scene = source.read(row["scene_id"])
    (found,) = prove_texts([row], scene, rules, Shapes(scene.root), Corpus())
    assert found.proven, found.disagreements
    reasons = {found.unproven[fact] for fact in ("condition_truth", "referents", "gold_leaf")}
    assert reasons == {"the text has no start, so it is unknown what is left, right, ahead or behind"}
    row["leaves"][1]["moves"][-1]["object_id"] = "no such thing"
    (found,) = prove_texts([row], scene, rules, Shapes(scene.root), Corpus())
    assert {fault.fact for fault in found.disagreements} >= {"referents"}


# -- mutants -----------------------------------------------------------------------------------------------------------

Mutator = Callable[[Row, np.random.Generator, list[str]], bool]
"""Puts one fault into a row, knowing all rooms' ids; False where it does not apply."""

MUTATORS: dict[str, Mutator] = {}


def mutator(function: Mutator) -> Mutator:
    MUTATORS[function.__name__] = function
    return function


def word(row: Row) -> None:
    """The text that the program as it is now has."""
    row["text"] = render(Program.model_validate({name: row[name] for name in PARTS}), 0, row["instruction_id"])
    row["words"] = len(row["text"].split())


@mutator
def flip_a_truth(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    """The gold leaf follows."""
    condition = row["conditions"][int(rng.integers(len(row["conditions"])))]
    condition["truth"] = not condition["truth"]
    witness = row["leaves"][0]["moves"][-1]["object_id"]
    condition["witnesses"] = [witness] if condition["truth"] else []
    program = Program.model_validate({name: row[name] for name in PARTS})
    row["gold_leaf"] = program.gold_leaf()
    row["moves"] = len(row["leaves"][row["gold_leaf"]]["moves"])
    return True


@mutator
def rename_a_label(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    """A goal has another label, and the text agrees."""
    leaf = row["leaves"][int(rng.integers(len(row["leaves"])))]
    move = leaf["moves"][-1]
    move["label"] = "piano" if move["label"] != "piano" else "bicycle"
    word(row)
    return True


@mutator
def rename_what_is_asked(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    """The subject of a true condition has another label, and the text agrees. Of a false one, it would be false too."""
    holding = [condition for condition in row["conditions"] if condition["truth"]]
    if not holding:
        return False
    holding[int(rng.integers(len(holding)))]["label"] = "piano"
    word(row)
    return True


@mutator
def wrong_room(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    move = row["leaves"][int(rng.integers(len(row["leaves"])))]["moves"][-1]
    others = [room for room in rooms if room != move["room"]["room_id"]]
    if not others:
        return False
    move["room"]["room_id"] = str(rng.choice(others))
    return True


@mutator
def wrong_room_label(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    """A goal is said to be in another kind of room, and the text agrees."""
    move = row["leaves"][int(rng.integers(len(row["leaves"])))]["moves"][-1]
    move["room"]["label"] = "garage" if move["room"]["label"] != "garage" else "office"
    before = row["text"]
    word(row)
    return bool(row["text"] != before)


@mutator
def swap_leaves(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["leaves"][0], row["leaves"][-1] = row["leaves"][-1], row["leaves"][0]
    return row["leaves"][0] != row["leaves"][-1]


@mutator
def other_gold(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["gold_leaf"] = (row["gold_leaf"] + 1) % len(row["leaves"])
    return True


@mutator
def empty_text(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["text"], row["words"] = "", 0
    return True


@mutator
def cut_text(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["text"] = " ".join(row["text"].split()[:-3])
    row["words"] -= 3
    return True


@mutator
def wrong_words(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["words"] += 1
    return True


@mutator
def heading_without_a_start(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["text"] = f"You're facing north. {row['text']}"
    row["words"] = len(row["text"].split())
    return True


@mutator
def unknown_object(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["leaves"][int(rng.integers(len(row["leaves"])))]["moves"][-1]["object_id"] = "no such thing"
    return True


@mutator
def other_depth(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["depth"] += 1
    return True


@mutator
def other_category(row: Row, rng: np.random.Generator, rooms: list[str]) -> bool:
    row["category"] = next(name for name in CATEGORIES if name != row["category"])
    return True


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("most", [5, pytest.param(1000, marks=pytest.mark.soak)])
def test_mutants_of_texts_are_caught(family: str, runs: Path, most: int) -> None:
    """One mutant of each kind of at most `most` texts."""
    config = made(family, runs)
    source = open_source(config.sources[0].family, config.sources[0].root)
    rules, rng = VerifierRules.of(config), np.random.default_rng(most)
    tried: Counter[str] = Counter()
    survivors = []
    rows = rows_of(config)
    for scene_id in sorted({row["scene_id"] for row in rows}):
        scene = source.read(scene_id)
        rooms, shapes = [room.room_id for room in scene.rooms], Shapes(scene.root)
        for row in [row for row in rows if row["scene_id"] == scene_id][:most]:
            for kind, mutate in MUTATORS.items():
                changed = copy.deepcopy(row)
                if not mutate(changed, rng, rooms):
                    continue
                tried[kind] += 1
                (certificate,) = prove_texts([changed], scene, rules, shapes, Corpus())
                if certificate.proven:
                    survivors.append((kind, row["text"], changed["text"]))
    print(f"\n{tried.total()} mutants of {len(tried)} kinds, not caught: {survivors[:5]}")
    assert set(tried) == set(MUTATORS), "every kind of fault was tried"
    assert not survivors
