"""``raked``: statements that are mostly true, or mostly false, are made even by leaving out as few as possible."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import orjson
import pyarrow as pa
import pytest

from condvln.bias import judge
from condvln.export.pool import INSTRUCTION_COLUMNS, ExportPool, PoolBuilder, hashes_of
from condvln.export.selection import SCENES, raked
from condvln.export.snapshot import export_snapshot
from schemas.config import SplitsConfig
from schemas.program import CATEGORIES, Category, leaf_truths
from tests.condvln.export.test_selection import pool_of
from tests.made_snapshot import made_snapshot

Episode = tuple[str, Category, Sequence[tuple[str, bool]]]
"""Scene, category, and the statements of the conditions with their truths."""


def pool_with(episodes: Sequence[Episode], grouped: bool = False) -> ExportPool:
    scenes = {name: k for k, name in enumerate(sorted({scene for scene, _, _ in episodes}))}
    words = {name: k for k, name in enumerate(sorted({word for _, _, asked in episodes for word, _ in asked}))}
    n = len(episodes)
    names = hashes_of((str(k),) for k in range(n))
    nothing = np.zeros(n, dtype=np.int64)
    said = np.array([words[word] for _, _, asked in episodes for word, _ in asked])
    return ExportPool(
        sources=("procthor",), scenes=tuple(("procthor", scene) for scene in scenes), strata=("",), kinds=("",),
        reasons=("",), episode=names, instruction=names, unit=names, start=names, grouped=np.full(n, grouped),
        source=nothing, scene=np.array([scenes[scene] for scene, _, _ in episodes]),
        category=np.array([CATEGORIES.index(category) for _, category, _ in episodes]), leaf=nothing, n_leaves=nothing,
        stratum=nothing, unfit=nothing, offsets=np.cumsum([0, *(len(asked) for _, _, asked in episodes)]),
        conditions=said, statements=said, truths=np.array([truth for _, _, asked in episodes for _, truth in asked]),
    )  # fmt: skip


def kept(pool: ExportPool, seed: int = 0) -> np.ndarray:
    return raked(pool, np.arange(len(pool)), seed)


def simple(scenes: int, each: int, rate: float, word: str = "a rug", seed: int = 0) -> list[Episode]:
    """Episodes of one statement that is true in `rate` of the scenes."""
    true = np.random.default_rng(seed).random(scenes) < rate
    return [(f"{word} {scene}", "simple", [(word, bool(true[scene]))]) for scene in range(scenes) for _ in range(each)]


@pytest.mark.parametrize("rate", [0.1, 0.8, 0.97])
def test_a_statement_of_many_scenes_becomes_even_and_its_rarer_truth_stays(rate: float) -> None:
    pool = pool_with([*simple(8000, 2, rate), *simple(8000, 2, 0.5, "a bed")])
    stay = kept(pool)
    rugs, rarer = pool.statements == 1, pool.truths != (rate > 0.5)
    assert stay[rugs & rarer].all()
    often, seldom, added = (rugs & ~rarer).sum(), (rugs & rarer).sum(), 2 * SCENES
    expected = often * (seldom + added) / (often + added)
    assert (rugs & ~rarer & stay).sum() == pytest.approx(expected, abs=4 * expected**0.5)
    assert expected == pytest.approx(seldom, rel=0.05)
    assert stay[~rugs].mean() > 0.98


def test_statements_of_few_scenes_are_raked_less() -> None:
    pool = pool_with([episode for k in range(300) for episode in simple(4, 3, 1.0, f"thing {k}")])
    assert kept(pool).mean() == pytest.approx(SCENES / (SCENES + 4), abs=0.02)


@pytest.mark.parametrize("category", CATEGORIES)
def test_what_even_gold_leaves_make_true_more_often_is_even(category: Category) -> None:
    """The first condition of a nested program is true for two of three leaves."""
    episodes: list[Episode] = []
    leaves = leaf_truths(category)
    count = 1 + max(k for leaf in leaves for k, _ in leaf)
    for scene in range(600):
        for leaf in leaves:
            fitting = [t for t in product((True, False), repeat=count) if all(t[k] == truth for k, truth in leaf)]
            truths = fitting[scene % len(fitting)]
            episodes.append((f"{scene}", category, [(f"s{k}", truth) for k, truth in enumerate(truths)]))
    assert kept(pool_with(episodes)).mean() > 0.99


def test_members_of_groups_stay() -> None:
    assert kept(pool_with(simple(500, 2, 0.9), grouped=True)).all()


def test_stagings_of_a_layout_stay_and_do_not_count() -> None:
    alone = simple(500, 2, 0.9)
    staged = [(f"v3_sc0_staging_{int(scene.split()[-1]):02d}", *rest) for scene, *rest in simple(60, 5, 0.0)]
    pool = pool_with([*alone, *staged])
    assert kept(pool)[len(alone) :].all()
    assert kept(pool)[: len(alone)].tolist() == kept(pool_with(alone)).tolist()
    two = [(f"v3_sc1_staging_0{k}", *rest) for k in range(2) for _, *rest in simple(1, 400, 1.0)]
    assert not kept(pool_with(two)).all()


@pytest.mark.costly
def test_a_guesser_of_statements_finds_no_more_than_chance_in_what_stays(tmp_path: Path) -> None:
    """Thirty statements of two thousand scenes, each of which is true in 85 or in 15 % of the scenes."""
    export_snapshot(made_snapshot(), tmp_path)
    lines = (tmp_path / "manifest" / "train.jsonl").read_bytes().splitlines()
    row = next(row for row in map(orjson.loads, lines) if row["category"] == "simple")
    random = np.random.default_rng(0)
    episodes: list[Episode] = []
    rows = []
    for k in range(8000):
        word, scene = int(random.integers(30)), f"house_{k // 4}"
        truth = bool(random.random() < (0.85, 0.15)[word % 2])
        episodes.append((scene, "simple", [(f"thing {word:02d}", truth)]))
        (condition,) = row["program"]["conditions"]
        program = {**row["program"], "conditions": [{**condition, "label": f"thing {word:02d}", "truth": truth}]}
        name = hashlib.sha256(str(k).encode()).hexdigest()
        told = {"scene_id": scene, "group_id": None, "episode_hash": name, "gold_leaf": 1 - truth, "program": program}
        rows.append({**row, **told})
    before = judge(rows)
    assert {finding.guesser for finding in before.beaten} >= {"label and room", "whole statement"}
    stay = kept(pool_with(episodes))
    after = judge([told for told, stays in zip(rows, stay, strict=True) if stays])
    assert after.beaten == []
    assert stay.mean() > 0.25


def test_the_choice_depends_on_episodes_and_seed_alone() -> None:
    pool = pool_with(simple(1000, 2, 0.8))
    order = np.random.default_rng(1).permutation(len(pool))
    columns = ("episode", "instruction", "unit", "start", "scene", "conditions", "statements", "truths")
    turned = ExportPool(**{**pool.__dict__, **{name: getattr(pool, name)[order] for name in columns}})
    np.testing.assert_array_equal(kept(turned), kept(pool)[order])
    np.testing.assert_array_equal(raked(pool, order, 0), kept(pool)[order])
    assert (kept(pool, seed=1) != kept(pool)).any()


def test_statements_are_equal_where_all_words_are() -> None:
    tables = made_snapshot({"procthor": ["house_0", "house_1"], "replicacad": ["apt_0"]}, per_category=6)
    builder = PoolBuilder(statements=True)
    said: list[tuple[object, ...]] = []
    for source in tables.sources:
        found = tables.tables[source]["instructions"]
        rows = found.to_pylist()
        for k, row in enumerate(rows):
            for j, one in enumerate(row["conditions"]):
                labels = ("sofa", "tv stand")[: (k + j) % 3]
                anchors = [{"object_id": f"{label} {k}", "label": label} for label in labels]
                if anchors:
                    one["qualifier"] = {"predicate": ("near", "on")[k // 3 % 2], "anchors": anchors}
                one["definite"] = k % 5 == 0
                words = (one["label"], one["room"]["label"], one["definite"])
                said.append((source, *words, one["qualifier"] and one["qualifier"]["predicate"], labels))
        table = pa.Table.from_pylist(rows, found.schema)
        # in several batches, the later of which begin within the columns' memory
        builder.add_instructions(source, table.select(INSTRUCTION_COLUMNS).to_batches(max_chunksize=7))
    codes = np.concatenate([part.statements for part in builder._asked]).tolist()
    assert len({*zip(said, codes, strict=True)}) == len({*said}) == len({*codes}) > 20
    with pytest.raises(ValueError, match="without statements"):
        kept(pool_of(tables))


def test_an_export_that_asks_for_it_is_raked(tmp_path: Path) -> None:
    """Presence and truth of what is said are independent of the scene in made snapshots, so a few episodes go."""
    tables = made_snapshot({"procthor": [f"house_{k}" for k in range(6)]}, per_category=40)
    reports = {
        statements: export_snapshot(tables, tmp_path / statements, SplitsConfig(statements=statements))
        for statements in ("any", "even")
    }
    reason = "its statements are asked more often than their opposites"
    assert reason not in reports["any"].left_out
    assert reports["even"].left_out[reason] > 0
    for report in reports.values():
        assert sum(report.episodes.values()) + sum(report.left_out.values()) == 6 * len(CATEGORIES) * 40
