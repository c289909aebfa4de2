"""``select``: disjoint, balanced, seeded, and honest about what it could not have."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest

from condvln.export import selection
from condvln.export.pool import INSTRUCTION_COLUMNS, POOL_COLUMNS, ExportPool, PoolBuilder
from condvln.export.selection import OUT, Selection, select
from condvln.export.splits import SPLITS
from schemas.config import SplitsConfig
from schemas.program import CATEGORIES, SHAPES
from tests.made_snapshot import MemoryTables, made_snapshot

SCENES = {
    "replicacad": [*(f"v3_sc0_staging_{i:02d}" for i in range(4)), "v3_sc1_staging_00", "apt_0"],
    "procthor": [f"house_{i}" for i in range(6)],
}


def pool_of(tables: MemoryTables, *, statements: bool = False) -> ExportPool:
    builder = PoolBuilder(statements=statements)
    for source in tables.sources:
        builder.add_instructions(source, tables.batches("instructions", source, INSTRUCTION_COLUMNS))
        for batch in tables.batches("episodes", source, POOL_COLUMNS):
            builder.add_episodes(source, batch)
    return builder.build()


@pytest.fixture(scope="module")
def pool() -> ExportPool:
    return pool_of(made_snapshot(SCENES, per_category=40), statements=True)


Chosen = tuple[SplitsConfig, Selection]
CONFIGS = [
    SplitsConfig(),
    SplitsConfig(per_cell=10, val_seen_share=0.25),
    SplitsConfig(per_cell=10_000, seed=3),
    SplitsConfig(statements="even"),
]


@pytest.fixture(scope="module", params=CONFIGS, ids=["all", "ten a cell", "more than there is", "even statements"])
def chosen(request: pytest.FixtureRequest, pool: ExportPool) -> Chosen:
    return request.param, select(pool, request.param)


def test_splits_share_no_scene_program_or_group(pool: ExportPool, chosen: Chosen) -> None:
    split = chosen[1].split
    scenes, programs, units = defaultdict(set), defaultdict(set), defaultdict(set)
    for row in np.flatnonzero(split != OUT):
        name = SPLITS[split[row]]
        scenes[pool.scene[row]].add("train" if name == "val_seen" else name)
        programs[pool.instruction[row]].add(name)
        units[pool.unit[row]].add(name)
    for sets in (scenes, programs, units):
        assert all(len(names) == 1 for names in sets.values())
    assert {SPLITS[code] for code in split if code != OUT} == set(SPLITS)


def test_gold_leaves_are_uniform_in_every_split_source_and_category(
    pool: ExportPool, chosen: tuple[SplitsConfig, Selection]
) -> None:
    counts: dict[tuple[int, int, int], Counter[int]] = defaultdict(Counter)
    for row in np.flatnonzero(chosen[1].split != OUT):
        counts[chosen[1].split[row], pool.source[row], pool.category[row]][pool.leaf[row]] += 1
    assert counts
    for (_, source, category), leaves in counts.items():
        n = pool.n_leaves[(pool.source == source) & (pool.category == category)][0]
        assert len(leaves) == n
        assert len(set(leaves.values())) == 1


def test_counts_meet_the_configuration_or_the_shortfall_is_listed(pool: ExportPool, chosen: Chosen) -> None:
    config, result = chosen
    got = Counter(
        (SPLITS[result.split[row]], pool.sources[pool.source[row]], CATEGORIES[pool.category[row]], pool.leaf[row])
        for row in np.flatnonzero(result.split != OUT)
    )
    assert {(c.split, c.source, c.category, c.gold_leaf): c.selected for c in result.cells if c.selected} == got
    together: Counter[tuple[str, str, int]] = Counter()
    scarcest: dict[tuple[str, str], list[int]] = defaultdict(list)
    for cell in result.cells:
        together[cell.split, cell.category, cell.gold_leaf] += cell.selected
        assert cell.selected <= cell.available
        assert cell.shortfall == max(0, cell.wanted - cell.selected)
        scarcest[cell.split, f"{cell.source} {cell.category}"].append(cell.available)
    if config.per_cell is None:
        for cell in result.cells:
            assert cell.selected == min(scarcest[cell.split, f"{cell.source} {cell.category}"])
    else:
        for (split, category, leaf), count in together.items():
            most = sum(min(v) for (s, name), v in scarcest.items() if s == split and name.split()[1] == category)
            assert count == min(config.per_cell, most), (split, category, leaf)
        # every cell of every split is listed, and the shortfalls add up to what is missing
        assert set(together) == {(s, c, leaf) for s in SPLITS for c in CATEGORIES for leaf in range(SHAPES[c].leaves)}
        short: Counter[tuple[str, str, int]] = Counter()
        for cell in result.cells:
            short[cell.split, cell.category, cell.gold_leaf] += cell.shortfall
        assert {key: config.per_cell - count for key, count in together.items()} == {
            key: short[key] for key in together
        }
    assert (result.split != OUT).sum() + sum(result.left_out.values()) == len(pool)


def test_truths_are_evened_where_the_pool_gives_a_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = pool_of(made_snapshot({"replicacad": ["v3_sc0_staging_00"]}, per_category=400))
    pool = ExportPool(**{**pool.__dict__, "grouped": np.zeros(len(pool), dtype=bool)})

    def imbalance() -> float:
        return select(pool, SplitsConfig(per_cell=20, val_seen_share=0)).truth_imbalance["replicacad"]

    looking = imbalance()
    monkeypatch.setattr(selection, "LOOKAHEAD", 1)
    assert looking < imbalance() / 3


def test_episodes_of_one_start_are_in_one_split(pool: ExportPool) -> None:
    """Where a scene has eight starts, the episodes of each are all of train or all of val_seen."""
    start = (pool.scene * 8 + pool.unit % np.uint64(8)).astype(np.uint64)
    split = select(ExportPool(**{**pool.__dict__, "start": start}), SplitsConfig(val_seen_share=0.5)).split
    chosen = {int(s): {int(c) for c in split[start == s] if c != OUT} for s in np.unique(start)}
    assert all(len(splits) <= 1 for splits in chosen.values())
    taken = [splits for splits in chosen.values() if splits]
    assert {SPLITS.index("train")} in taken
    assert {SPLITS.index("val_seen")} in taken


def test_axes_are_as_even_as_the_pool_allows(pool: ExportPool) -> None:
    singles = ExportPool(**{**pool.__dict__, "grouped": np.zeros(len(pool), dtype=bool)})
    split = select(singles, SplitsConfig(per_cell=20)).split
    group = {scene: {int(c) for c in split[pool.scene == scene] if c != OUT} for scene in np.unique(pool.scene)}
    uneven = 0
    for code in (0, 2, 3):
        mine = np.array([code in group[scene] for scene in pool.scene])
        for key in {*zip(pool.source, pool.category, pool.leaf, strict=True)}:
            block = mine & (pool.source == key[0]) & (pool.category == key[1]) & (pool.leaf == key[2])
            taken = np.bincount(pool.stratum[block & (split == code)], minlength=len(pool.strata))
            if code == 0:
                block &= split != SPLITS.index("val_seen")
            spare = np.bincount(pool.stratum[block & (split == OUT)], minlength=len(pool.strata))
            # One stratum behind another has nothing left (val_seen's own leftovers stay its own).
            uneven += int((spare[taken < taken.max() - 1] > 0).sum()) if code else 0
    assert uneven == 0


def test_the_answer_is_a_function_of_pool_and_seed(pool: ExportPool) -> None:
    first = select(pool, SplitsConfig(per_cell=8))
    np.testing.assert_array_equal(first.split, select(pool, SplitsConfig(per_cell=8)).split)
    assert (first.split != select(pool, SplitsConfig(per_cell=8, seed=1)).split).any()


def test_what_even_statements_leave_out_is_counted(pool: ExportPool) -> None:
    every, even = (select(pool, SplitsConfig(statements=statements)) for statements in ("any", "even"))
    reason = "its statements are asked more often than their opposites"
    assert even.left_out[reason] > 0 == every.left_out[reason]
    for found in (every, even):
        assert (found.split != OUT).sum() + found.left_out.total() == len(pool)


def test_a_split_without_scenes_lists_what_it_lacks() -> None:
    pool = pool_of(made_snapshot({"replicacad": ["v3_sc0_staging_00"]}, per_category=12))
    cells = [cell for cell in select(pool, SplitsConfig(per_cell=2)).cells if cell.split == "test"]
    assert len(cells) == sum(SHAPES[category].leaves for category in CATEGORIES)
    assert {(cell.available, cell.wanted, cell.selected, cell.shortfall) for cell in cells} == {(0, 2, 0, 2)}
    assert not [cell for cell in select(pool, SplitsConfig()).cells if cell.split == "test"]


def test_sources_share_a_cell_evenly(pool: ExportPool) -> None:
    selected = select(pool, SplitsConfig(per_cell=4))
    for cell in selected.cells:
        if cell.split == "train" and cell.available >= 20:
            assert cell.selected == 2


def test_counterfactual_groups_come_first_and_whole_or_not_at_all(pool: ExportPool, chosen: Chosen) -> None:
    split = chosen[1].split
    groups = [split[pool.unit == unit] for unit in np.unique(pool.unit[pool.grouped])]
    whole = sum((members != OUT).all() for members in groups)
    assert whole + sum((members == OUT).all() for members in groups) == len(groups)
    assert all(len(set(members.tolist())) == 1 for members in groups)
    if chosen[0].per_cell is None:
        assert whole > 0.8 * len(groups)


def test_of_a_group_that_lost_a_member_nothing_is_taken(pool: ExportPool) -> None:
    unfit = pool.unfit.copy()
    lost = np.flatnonzero(pool.grouped)[::3]
    unfit[lost] = pool.reasons.index("over") if "over" in pool.reasons else 1
    reasons = (*pool.reasons, "over")
    selected = select(ExportPool(**{**pool.__dict__, "unfit": unfit, "reasons": reasons}), SplitsConfig())
    assert (selected.split[np.isin(pool.unit, pool.unit[lost])] == OUT).all()
    assert selected.left_out["its counterfactual group is not whole"] > 0
    assert (selected.split != OUT).sum() + sum(selected.left_out.values()) == len(pool)


def test_groups_that_lean_on_one_leaf_do_not_spoil_the_balance() -> None:
    pool = pool_of(made_snapshot({"replicacad": ["v3_sc0_staging_00"]}, per_category=80))
    leaf = pool.leaf.copy()
    leaf[pool.grouped] = 0
    selected = select(ExportPool(**{**pool.__dict__, "leaf": leaf}), SplitsConfig(val_seen_share=0))
    for category in np.unique(pool.category):
        mine = (pool.category == category) & (selected.split != OUT)
        counts = np.bincount(leaf[mine])
        assert len(set(counts.tolist())) == 1
        assert counts[0] == min(np.bincount(leaf[(pool.category == category) & ~pool.grouped])[1:])
    groups = [selected.split[pool.unit == unit] for unit in np.unique(pool.unit[pool.grouped])]
    assert {(members != OUT).sum() for members in groups} == {0, 2}


def test_a_leaf_that_is_never_gold_leaves_its_category_out() -> None:
    tables = made_snapshot({"procthor": ["house_0"]}, per_category=6)
    pool = pool_of(tables)
    broken = pool.leaf.copy()
    simple = pool.category == 0
    broken[simple] = 1
    selected = select(ExportPool(**{**pool.__dict__, "leaf": broken}), SplitsConfig())
    assert (selected.split[simple] == OUT).all()
    cells = [cell for cell in selected.cells if cell.category == "simple"]
    assert {cell.selected for cell in cells} == {0}
    assert selected.left_out["beyond the balance"] >= simple.sum()


def test_one_scene_alone_is_told_which_split_has_it_and_which_key_moves_it() -> None:
    pool = pool_of(made_snapshot({"replicacad": ["lab"]}, per_category=12))
    empty = select(pool, SplitsConfig(scenes={"test": ("*/lab",)})).empty
    assert {*empty} == {"train", "val_seen", "val_unseen"}
    for split in ("train", "val_unseen"):
        assert "a scene is in one split only, and all scenes with episodes (1) are in test" in empty[split]
        assert f"splits.scenes: {{{split}: [replicacad/lab]}} moves this one here" in empty[split]
    moved = select(pool, SplitsConfig(scenes={"train": ("replicacad/lab",)})).empty
    assert "train" not in moved
