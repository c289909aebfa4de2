"""``evened``: statements that are mostly true, or mostly false, are made even by leaving out as few as possible."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pyarrow as pa
import pytest

from condvln.bias.learners import leaf_truths
from condvln.export.evening import SCENES, evened
from condvln.export.pool import INSTRUCTION_COLUMNS, ExportPool, PoolBuilder, hashes_of
from schemas.program import CATEGORIES, Category
from tests.condvln.export.test_selection import pool_of
from tests.made_snapshot import made_snapshot

Episode = tuple[str, Category, Sequence[tuple[str, bool]]]
"""Scene, category, and the statements of the conditions with their truths."""


def pool_with(episodes: Sequence[Episode], grouped: bool = False) -> ExportPool:
    scenes = sorted({scene for scene, _, _ in episodes})
    words = sorted({word for _, _, asked in episodes for word, _ in asked})
    n = len(episodes)
    names = hashes_of((str(k),) for k in range(n))
    nothing = np.zeros(n, dtype=np.int64)
    said = np.array([words.index(word) for _, _, asked in episodes for word, _ in asked])
    return ExportPool(
        sources=("procthor",), scenes=tuple(("procthor", scene) for scene in scenes), strata=("",), kinds=("",),
        reasons=("",), episode=names, instruction=names, unit=names, start=names, grouped=np.full(n, grouped),
        source=nothing, scene=np.array([scenes.index(scene) for scene, _, _ in episodes]),
        category=np.array([CATEGORIES.index(category) for _, category, _ in episodes]), leaf=nothing, n_leaves=nothing,
        stratum=nothing, unfit=nothing, offsets=np.cumsum([0, *(len(asked) for _, _, asked in episodes)]),
        conditions=said, statements=said, truths=np.array([truth for _, _, asked in episodes for _, truth in asked]),
    )  # fmt: skip


def kept(pool: ExportPool, seed: int = 0) -> np.ndarray:
    return evened(pool, np.arange(len(pool)), seed)


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


def test_statements_of_few_scenes_are_evened_less() -> None:
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


def test_the_choice_depends_on_episodes_and_seed_alone() -> None:
    pool = pool_with(simple(1000, 2, 0.8))
    order = np.random.default_rng(1).permutation(len(pool))
    columns = ("episode", "instruction", "unit", "start", "scene", "conditions", "statements", "truths")
    turned = ExportPool(**{**pool.__dict__, **{name: getattr(pool, name)[order] for name in columns}})
    np.testing.assert_array_equal(kept(turned), kept(pool)[order])
    np.testing.assert_array_equal(evened(pool, order, 0), kept(pool)[order])
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
    assert not pool_of(tables).statements.any()
