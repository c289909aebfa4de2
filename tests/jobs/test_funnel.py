"""The funnel: its numbers add up, agree with what the stages measured, and no scene is silent."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from condvln.episodes.candidates import REASONS
from condvln.instructions.degeneracy import REASONS as DRAWING_REASONS
from factory.snapshot import Snapshot
from jobs.command import app
from jobs.funnel import Flow, Funnel, funnel_of
from jobs.generate import run_generate
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config, EpisodeConfig, InstructionCell, InstructionsConfig, PlacesConfig
from tests.once import made_once

runner = CliRunner()

Run = tuple[Config, Report]
BOUNDED = "nested 4-14 m 55-95 words"


def measured(config: Config, stage: str, measure: str) -> dict[str, int]:
    """What the commits of a stage recorded, by unit."""
    commits = [json.loads(path.read_text()) for path in Path(config.store).glob("units/**/unit.json")]
    return {c["unit_id"]: int(c["measures"][measure]) for c in commits if c["stage"] == stage}


def test_numbers_add_up(made_run: Run) -> None:
    config, _ = made_run
    snapshot = published(config)
    funnel = funnel_of(snapshot)
    drawn, placed = measured(config, "episodes", "candidates"), measured(config, "episodes", "episodes")
    episodes = Counter(f"replicacad/{scene}" for scene in snapshot.table("episodes")["scene_id"].to_pylist())
    assert set(funnel.scenes) == set(drawn) == set(placed)
    for name, flow in funnel.scenes.items():
        assert flow.candidates == drawn[name] == sum(flow.rejected.values()) + flow.placed
        assert flow.placed == placed[name] == episodes[name]
        assert flow.short == max(0, flow.wanted - flow.placed)
    for column in ("wanted", "candidates", "placed"):
        assert sum(getattr(f, column) for f in funnel.cells.values()) == sum(
            getattr(f, column) for f in funnel.scenes.values()
        )
    for counts in ("rejected", "undrawn"):
        by_cell, by_scene = Counter(), Counter()
        for flow in funnel.cells.values():
            by_cell += getattr(flow, counts)
        for flow in funnel.scenes.values():
            by_scene += getattr(flow, counts)
        assert by_cell == by_scene
    assert {cell for _, cell in funnel.cells} == {"simple", "nested", "counterfactual groups"}
    for row in snapshot.table("funnel").to_pylist():
        assert row["candidates"] == row["rejected"] + row["placed"]


@dataclass
class MadeTables:
    """Tables as a snapshot has them, made by hand: rows of one source."""

    tables: dict[str, list[dict[str, object]]]

    @property
    def manifest(self) -> MadeTables:
        return self

    def table(self, name: str, columns: object = None) -> pa.Table:
        return pa.Table.from_pylist([{"source": "made", "scene_id": "a"} | row for row in self.tables[name]])


def flow(scene: str, cell: str, wanted: int, candidates: int, placed: int) -> dict[str, object]:
    return {"scene_id": scene, "cell": cell, "wanted": wanted, "candidates": candidates, "placed": placed}


def rejected(scene: str, cell: str, stage: str = "episodes", **counts: int) -> list[dict[str, object]]:
    return [
        {"scene_id": scene, "stage": stage, "cell": cell, "reason": reason, "count": count}
        for reason, count in counts.items()
    ]


def made_funnel(flows: list[dict[str, object]], *rejections: list[dict[str, object]]) -> Funnel:
    scenes = [{"scene_id": name, "status": "done", "reason": None} for name in ("a", "b")]
    tables = {"scenes": scenes, "funnel": flows, "rejections": [row for rows in rejections for row in rows]}
    return funnel_of(cast(Snapshot, MadeTables(tables)))


def test_only_what_binds_a_short_cell_is_its_cause() -> None:
    funnel = made_funnel(
        [flow("a", "simple", 10, 60, 4), flow("b", "simple", 10, 90, 10), flow("b", "nested", 10, 60, 10)],
        rejected("a", "simple", gold_leaf_full=40, path_enters_other_leaf=9, label_over_cap=7),
        rejected("b", "simple", quota_full=50, over_step_budget=30),
        rejected("b", "nested", quota_full=50),
        rejected("a", "simple", "programs", no_waypoint=99),
    )
    simple = funnel.cells["made", "simple"]
    assert (simple.wanted, simple.placed, simple.short) == (20, 14, 6)
    assert simple.rejected["quota_full"] == simple.rejected["gold_leaf_full"] + 10 == 50
    assert simple.document()["causes"] == {"path_enters_other_leaf": 9, "label_over_cap": 7}
    assert simple.why() == "path_enters_other_leaf 9, label_over_cap 7", "scene b has all that was wanted of it"
    assert funnel.scenes["made/a"].why() == simple.why()
    assert funnel.scenes["made/b"].why() == funnel.cells["made", "nested"].why() == ""


def test_where_candidates_ran_out_it_says_so_and_what_ended_the_draws() -> None:
    funnel = made_funnel(
        [flow("a", "simple", 10, 25, 5), flow("b", "simple", 10, 0, 0)],
        rejected("a", "simple", gold_leaf_full=18, no_start_in_range=2),
        rejected("a", "simple", "programs", no_waypoint=30),
        rejected("b", "simple", "programs", no_targets=12, no_waypoint=1),
    )
    # Of scene a three are missing although both that failed had been placed; of scene b all ten.
    assert (
        funnel.cells["made", "simple"].why()
        == "too_few_candidates 13 (no_waypoint 31, no_targets 12), no_start_in_range 2"
    )
    assert funnel.barren == {"made/b": f"no_targets: {DRAWING_REASONS['no_targets']} (12 of 13 draws)"}


@given(st.integers(0, 30), st.integers(0, 30), st.dictionaries(st.sampled_from(sorted(REASONS)), st.integers(1, 30)))
def test_a_cell_has_causes_exactly_where_it_is_short(wanted: int, placed: int, rejected: dict[str, int]) -> None:
    cell = Flow.of_cell(wanted, placed + sum(rejected.values()), placed, rejected, {})
    assert bool(cell.causes) == bool(cell.why()) == (wanted > placed) == (cell.short > 0)
    assert not {"quota_full", "gold_leaf_full"} & cell.causes.keys()
    assert cell.causes.total() >= cell.short, "what is short is accounted for"


def test_generate_and_status_tell_it(made_run: Run, tmp_path: Path) -> None:
    config, report = made_run
    path = tmp_path / "run.yaml"
    path.write_text(config.model_dump_json())
    result = runner.invoke(app, ["status", str(path), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)["funnel"]
    assert told == report.document["funnel"]
    assert [scene["scene"] for scene in told["scenes"]] == ["replicacad/made_000", "replicacad/made_001"]
    assert "Funnel" in runner.invoke(app, ["status", str(path)]).output


def test_a_scene_that_yields_nothing_says_why(dataset: Path, configured: Callable[..., Config]) -> None:
    nowhere = configured(dataset, episodes=EpisodeConfig(distance=(60.0, 70.0)))
    funnel = funnel_of(published_after(nowhere))
    assert {name: why.split(":")[0] for name, why in funnel.barren.items()} == dict.fromkeys(
        ["replicacad/made_000", "replicacad/made_001"], "no_start_in_range"
    )
    assert all("no start has every leaf" in why for why in funnel.barren.values())
    narrow = configured(dataset, places=PlacesConfig(island_radius=90.0))
    funnel = funnel_of(published_after(narrow))
    for name, flow in funnel.scenes.items():
        assert flow.candidates == 0
        # Where nobody can stand nothing is seen, and nothing is asked.
        assert funnel.barren[name].startswith("nothing_to_ask: ")


def published_after(config: Config):
    assert run_generate(config, inline=True).exit_code == 0
    return published(config)


@pytest.fixture(scope="module")
def celled(made_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Config:
    cells = [
        InstructionCell(category="simple", moves=2, observability="O0", count=3),
        InstructionCell(category="long_chain", composition="C0", moves=2, count=4),
        InstructionCell(category="nested", route=(4.0, 14.0), words=(55, 95), count=3),
    ]

    def make(folder: Path) -> Config:
        config = Config(
            name="cells",
            store=folder / "store",
            export=folder / "export",
            sources=({"family": "replicacad", "root": made_dataset},),
            instructions=InstructionsConfig(per_category={"simple": 90, "chain": 4}, cells=cells),
        )
        assert run_generate(config, inline=True).exit_code == 0
        return config

    return made_once(tmp_path_factory, "cells", make)


def test_a_cell_is_had_or_its_shortfall_is_told(celled: Config) -> None:
    snapshot = published(celled)
    funnel = funnel_of(snapshot)
    cells = {cell: flow for (_, cell), flow in funnel.cells.items()}
    assert set(cells) == {"chain", "counterfactual groups", "long_chain C0 2 moves", "simple O0 2 moves", BOUNDED}
    crowded = cells["long_chain C0 2 moves"]
    assert (crowded.candidates, crowded.short) == (0, 8), "no room has so many places apart"
    assert crowded.causes == {"too_few_candidates": 8}
    assert crowded.why().startswith("too_few_candidates 8 (no_")
    assert crowded.undrawn_of_short.keys() & {"no_targets", "no_waypoint"}
    asked = cells["simple O0 2 moves"]
    assert 0 < asked.placed <= asked.wanted == 6
    rows = [
        row for row in snapshot.table("episodes").to_pylist() if row["category"] == "simple" and row["group_id"] is None
    ]
    assert len(rows) == asked.placed
    assert {(row["observability"], row["moves"]) for row in rows} == {("O0", 2)}


def test_a_cell_bounded_in_metres_and_words_holds_nothing_else(celled: Config) -> None:
    snapshot = published(celled)
    funnel = funnel_of(snapshot)
    bounded = funnel.cells["replicacad", BOUNDED]
    rows = [
        row for row in snapshot.table("episodes").to_pylist() if row["category"] == "nested" and row["group_id"] is None
    ]
    assert 0 < len(rows) == bounded.placed <= bounded.wanted == 6
    for row in rows:
        assert 4.0 <= row["route_length"] <= 14.0
        assert all(4.0 <= leaf["route_length"] <= 14.0 for leaf in row["leaves"]), "nothing tells the gold one"
        assert 55 <= len(row["instruction_text"].split()) == row["words"] <= 95
    assert bounded.rejected["route_missed"] > 0 < bounded.undrawn["words_missed"]
    assert bounded.candidates == bounded.placed + bounded.rejected.total()
