"""``select``: choose which episodes of the pool are published, and in which split.

The selection keeps three balances, so that only the scene determines the gold leaf: within each split, source and
category every gold leaf is equally frequent; the axes are as balanced as the pool allows; and conditions on one label
in one room type are as often true as false, as far as the pool allows. Shortfalls are counted. If the configuration
asks for it, episodes are left out first, by raking, until each statement is asked as often where it is true as where it
is false. Conditions are drawn so that truth and falsehood of a statement have equal weights over all rooms. But each
scene shares its episodes out among the statements that can be asked there, so that what is almost always true is still
asked where little else is true. In some hundred scenes this is below what a guesser can learn; in thousands it is not.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from condvln.bias import usual_truths
from condvln.export.pool import FIT, Codes, ExportPool
from condvln.export.splits import GROUPS, SPLITS, Group, Split, fractions, scene_group
from condvln.scene.scene import layout_of
from schemas.config import SplitsConfig
from schemas.config.constants import STAGINGS
from schemas.program import CATEGORIES, SHAPES, Category

__all__ = ["OUT", "VERSION", "Selection", "SelectionCell", "raked", "select"]

SCENES: Final = 10
"""Number of scenes, with as many conditions each as a statement has where it occurs, that are added to both counts of
the statement. So statements of a few scenes are raked less: if they were raked as much, a scene would say the
opposite of the others.
"""
ROUNDS: Final = 20
"""How often the chances are adapted to each other: after so many, those of a million episodes change by less than 1 %.
"""


def raked(pool: ExportPool, rows: Codes, seed: int) -> npt.NDArray[np.bool_]:
    """Return for each of the episodes `rows` of a pool with statements whether it stays.

    An episode stays with the product of the chances of its conditions, each of which depends on the statement and its
    truth; the rarer truth of a statement has chance 1. Chances are adapted to each other in turns, by raking
    (iterative proportional fitting, Deming and Stephan 1940). What counts as even depends on the conditions' places in
    their programs, since an even distribution of gold leaves makes some of them true more often than false. Members of
    counterfactual groups all stay, and so do episodes of stagings of a layout: their conditions were drawn as evenly
    as so few scenes allow (``condvln.instructions.balance``).

    Raises
    ------
    ValueError : the pool was built without statements
    """
    if pool.statements is None:
        raise ValueError("the pool was built without statements")
    stay = np.ones(len(rows), dtype=bool)
    asked = np.flatnonzero(~_staged(pool)[pool.scene[rows]])
    stay[asked] = _raked(pool, pool.statements, rows[asked], seed)
    return stay


def _staged(pool: ExportPool) -> npt.NDArray[np.bool_]:
    """Return for each scene of a pool whether it is one of several stagings of a layout."""
    layouts = [(family, layout_of(scene)) for family, scene in pool.scenes]
    count = Counter(layouts)
    return np.array([bool(one[1]) and count[one] >= STAGINGS for one in layouts], dtype=bool)


def _raked(pool: ExportPool, statements: Codes, rows: Codes, seed: int) -> npt.NDArray[np.bool_]:
    sizes = np.diff(pool.offsets)[rows]
    episode = np.repeat(np.arange(len(rows)), sizes)
    place = np.arange(len(episode)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    at = pool.offsets[rows][episode] + place
    truth = pool.truths[at]
    _, statement = np.unique(statements[at], return_inverse=True)
    count = int(statement.max(initial=-1)) + 1
    usual = usual_truths()[pool.category[rows][episode], place]
    single = ~pool.grouped[rows]
    scenes = len(pool.scenes)
    pairs = np.unique(statement.astype(np.int64) * scenes + pool.scene[rows][episode])
    added = SCENES * np.bincount(statement, minlength=count) / np.bincount(pairs // scenes, minlength=count)

    def lowered() -> npt.NDArray[np.float64]:
        """Return the negative logarithm of each condition's chance."""
        return np.where(truth, np.maximum(log_odds, 0)[statement], np.maximum(-log_odds, 0)[statement])

    def chances() -> npt.NDArray[np.float64]:
        """Return the chance of each episode."""
        return np.where(single, np.exp(-np.bincount(episode, lowered(), len(rows))), 1.0)

    log_odds = np.zeros(count)
    for _ in range(ROUNDS):
        # Of the episodes that the other conditions let stay
        weight = chances()[episode] * np.where(single[episode], np.exp(lowered()), 1.0)
        true, all_true, false, all_false = (
            np.bincount(statement, weight * share, count) + added for share in (truth, usual, ~truth, 1.0 - usual)
        )
        log_odds = 0.5 * (log_odds + np.log(true * all_false / (false * all_true)))
    return fractions(pool.episode[rows], seed, "statements") < chances()


OUT: Final = -1
"""Code of an episode that is in no split."""

WHOLES: Final = ("presence", "sent")
"""Kinds of conditions whose truth is evened over all labels, too: placing finds what is there more often than that
something is not, and less often from afar that something small is where one is sent if it is.
"""
VERSION: Final = 4
"""Version of the selection; raised when equal pool and configuration select other episodes than before."""

LOOKAHEAD: Final = 64
"""Number of candidates compared per pick: more give more balanced truths, fewer are faster."""

_HALVED: Final = "its counterfactual group is not whole"
_UNEVEN: Final = "its statements are asked more often than their opposites"
_NO_ROOM: Final = "its counterfactual group does not fit the balance"

Terms = list[tuple[int, int]]
"""Kind of each condition of an episode (or of all episodes of a group), with +1 if it is true and −1 if false."""


@dataclass(frozen=True)
class SelectionCell:
    """Numbers of available, wanted and selected episodes of one combination: split, source, category and gold leaf."""

    split: Split
    source: str
    category: str
    gold_leaf: int
    available: int
    wanted: int
    selected: int

    @property
    def shortfall(self) -> int:
        """Number of wanted episodes that were not available."""
        return max(0, self.wanted - self.selected)


@dataclass
class Selection:
    """The result of :func:`select`. ``split[i]`` is the split of episode ``i`` of the pool: an index into
    :data:`SPLITS`, or :data:`OUT`.
    """

    split: npt.NDArray[np.int8]
    cells: list[SelectionCell] = field(default_factory=list)
    lost: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    """Number of episodes that are in no split, by category and reason."""
    truth_imbalance: dict[str, float] = field(default_factory=dict)
    """Imbalance by source, before and after: Σ |true − false| ÷ Σ (true + false) over label × room type × kind of
    condition.
    """
    empty: dict[Split, str] = field(default_factory=dict)
    """Requested splits without episodes, with the reason."""

    @property
    def left_out(self) -> Counter[str]:
        """Number of episodes that are in no split, by reason."""
        return sum(self.lost.values(), Counter())

    def lose(self, pool: ExportPool, rows: npt.NDArray[Any], reason: str) -> None:
        """Count episodes that are in no split; ``rows`` are their places in the pool, or a mask."""
        for category, count in enumerate(np.bincount(pool.category[rows]).tolist()):
            if count:
                self.lost[CATEGORIES[category]][reason] += count


def select(pool: ExportPool, config: SplitsConfig) -> Selection:
    """Select episodes and assign splits. Equal pools and configurations give equal results, whatever the order of the
    names in the pool.
    """
    selection = Selection(np.full(len(pool), OUT, dtype=np.int8))
    placed = _place(pool, config, selection)
    if config.statements == "even":
        rows = np.flatnonzero(placed != OUT)
        uneven = rows[~raked(pool, rows, config.seed)]
        placed[uneven] = OUT
        selection.lose(pool, uneven, _UNEVEN)
    order = _seeded_order(pool, config.seed)
    for split_code, split in enumerate(SPLITS):
        members = order[placed[order] == split_code]
        # Number of true minus false conditions, by source and kind of condition; last over all kinds of each of WHOLES.
        balances = [[0] * (len(pool.kinds) + len(WHOLES)) for _ in pool.sources]
        for category, name in enumerate(CATEGORIES):
            blocks = {
                source: members[(pool.category[members] == category) & (pool.source[members] == source)]
                for source in range(len(pool.sources))
            }
            for source, block in blocks.items():
                blocks[source] = _with_fitting_groups(pool, block)
                selection.lose(pool, np.setdiff1d(block, blocks[source]), _NO_ROOM)
            quotas = _quotas(pool, blocks, config.per_cell)
            wanted = _wanted(pool, quotas, config.per_cell)
            for source, block in blocks.items():
                taken = block[:0]
                if len(block):
                    taken = _Picker(pool, block, quotas[source], balances[source]).pick()
                    selection.split[taken] = split_code
                    selection.lose(pool, np.setdiff1d(block, taken), "beyond the balance")
                if len(block) or wanted[source]:
                    selection.cells += _cells(pool, split, source, name, block, taken, wanted[source])
    for source, label in enumerate(pool.sources):
        inside = pool.source == source
        selection.truth_imbalance[label] = _imbalance(pool, inside & (selection.split != OUT))
    selection.empty = _empty_splits(pool, config, selection)
    return selection


def _empty_splits(pool: ExportPool, config: SplitsConfig, selection: Selection) -> dict[Split, str]:
    """Return, for each empty split, the reason why it has no episodes. Splits without a share and without scenes in the
    configuration are left out.
    """
    groups = Counter(scene_group(family, scene, config) for family, scene in pool.scenes)
    shares = dict(zip(GROUPS, config.fractions, strict=True))
    found: dict[Split, str] = {}
    for code, split in enumerate(SPLITS):
        group: Group = "train" if split == "val_seen" else split
        asked = bool(shares[group] > 0 or group in config.scenes or groups[group])
        if (selection.split == code).any() or not asked or (split == "val_seen" and config.val_seen_share == 0):
            continue
        available = sum(cell.available for cell in selection.cells if cell.split == split)
        if not groups[group]:
            why = (
                f"a scene is in one split only, and all scenes with episodes ({len(pool.scenes)}) are in "
                f"{' and '.join(sorted(groups))}; splits.scenes: {{{group}: [{'/'.join(min(pool.scenes))}]}} moves "
                "this one here, and more scenes fill more splits"
            )
        elif not available and split == "val_seen":
            why = f"it takes {config.val_seen_share:g} of the train scenes' episodes by hash, and none falls in it"
        elif not available:
            why = f"none of the episodes of its scenes ({groups[group]}) can be in a split"
        else:
            why = (
                f"none of its {available} episodes could be chosen, since each source and category needs one of every "
                "gold leaf; more scenes or more episodes a scene may fill it"
            )
        found[split] = why
    return found


def _place(pool: ExportPool, config: SplitsConfig, selection: Selection) -> npt.NDArray[np.int8]:
    """Return the split of each episode, such that no unit and no program is in two splits. All episodes that are left
    out get `OUT` and are counted by reason in `selection`.
    """
    groups = [scene_group(family, scene, config) for family, scene in pool.scenes]
    by_group = {"train": SPLITS.index("train"), "val_unseen": SPLITS.index("val_unseen"), "test": SPLITS.index("test")}
    placed = np.array([by_group[group] for group in groups], dtype=np.int8)[pool.scene]
    train = placed == by_group["train"]
    # All episodes with the same start go to one split, since their oracle twins may have equal texts. A unit's start is
    # that of its first episode.
    _, first, which = np.unique(pool.unit, return_index=True, return_inverse=True)
    seen = fractions(pool.start[first][which], config.seed, "val_seen") < config.val_seen_share
    placed[train & seen] = SPLITS.index("val_seen")
    fit = np.flatnonzero(pool.unfit == FIT)
    for code in np.unique(pool.unfit[pool.unfit != FIT]).tolist():
        selection.lose(pool, pool.unfit == code, pool.reasons[code])
    # A program shared by units in two splits stays in the split in which it occurs first.
    _, first, which = np.unique(pool.instruction[fit], return_index=True, return_inverse=True)
    torn = placed[fit] != placed[fit][first][which]
    selection.lose(pool, fit[torn], "its program is in another split")
    kept = np.full(len(pool), OUT, dtype=np.int8)
    kept[fit[~torn]] = placed[fit[~torn]]
    # If one member of a counterfactual group is missing, the whole group is dropped.
    halved = pool.grouped & np.isin(pool.unit, pool.unit[pool.grouped & (kept == OUT)]) & (kept != OUT)
    selection.lose(pool, halved, _HALVED)
    kept[halved] = OUT
    return kept


def _seeded_order(pool: ExportPool, seed: int) -> npt.NDArray[np.int64]:
    """Return the indices of all episodes in rounds: first one episode of each scene, then a second one of each scene
    that has more, and so on. Within a round, and among the episodes of a scene, the order is that of a seeded hash of
    the id.
    """
    by_hash = np.argsort(fractions(pool.episode, seed, "order"), kind="stable")
    by_scene = by_hash[np.argsort(pool.scene[by_hash], kind="stable")]
    scenes = pool.scene[by_scene]
    first = np.searchsorted(scenes, scenes, side="left")
    turn = np.empty(len(pool), dtype=np.int64)
    turn[by_scene] = np.arange(len(pool)) - first
    return by_hash[np.argsort(turn[by_hash], kind="stable")]


def _groups(pool: ExportPool, block: npt.NDArray[np.int64]) -> list[list[int]]:
    """Return the rows of each counterfactual group of a block, in the order of their first members."""
    groups: dict[int, list[int]] = defaultdict(list)
    for row in block[pool.grouped[block]].tolist():
        groups[int(pool.unit[row])].append(row)
    return list(groups.values())


def _with_fitting_groups(pool: ExportPool, block: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the episodes of ``block`` without those counterfactual groups that can't be selected if every leaf is to
    be equally frequent.

    A group is selected whole or not at all, so a surplus of one leaf within groups can't be compensated.
    """
    groups = _groups(pool, block)
    if not groups:
        return block
    leaves = int(pool.n_leaves[block[0]])
    needs = [np.bincount(pool.leaf[group], minlength=leaves)[:leaves] for group in groups]
    single = np.bincount(pool.leaf[block[~pool.grouped[block]]], minlength=leaves)[:leaves]
    most = int((single + np.sum(needs, axis=0)).min())
    while True:
        taken, fitting = np.zeros(leaves, dtype=np.int64), []
        for group, need in zip(groups, needs, strict=True):
            if (taken + need <= most).all():
                taken += need
                fitting += group
        reached = int((single + taken).min())
        if reached >= most:
            return block[~pool.grouped[block] | np.isin(block, fitting)]
        most = reached


def _quotas(pool: ExportPool, blocks: dict[int, npt.NDArray[np.int64]], per_cell: int | None) -> dict[int, int]:
    """Return, for each source, how many episodes of each leaf the source contributes.

    A source contributes at most as many as it has of its scarcest leaf; the sources share ``per_cell`` evenly.
    """
    most = {source: _scarcest_leaf(pool, block) for source, block in blocks.items()}
    if per_cell is None:
        return most
    given = dict.fromkeys(most, 0)
    left = per_cell
    # The source with the fewest episodes is served first; the others share what it leaves.
    waiting = sorted(most, key=lambda source: (most[source], pool.sources[source]))
    for position, source in enumerate(waiting):
        given[source] = min(most[source], -(-left // (len(waiting) - position)))
        left -= given[source]
    return given


def _wanted(pool: ExportPool, quotas: dict[int, int], per_cell: int | None) -> dict[int, int]:
    """Return, for each source, the wanted number of episodes of each leaf: the source's quota, plus a share of the
    number by which all quotas together fall short of ``per_cell``. Over the sources, the numbers add up to
    ``per_cell``.
    """
    wanted = dict(quotas)
    left = (per_cell or 0) - sum(quotas.values())
    share = -(-(per_cell or 0) // len(quotas))
    for source in sorted(quotas, key=lambda source: (quotas[source], pool.sources[source])):
        short = min(left, share - quotas[source])
        if short > 0:
            wanted[source] += short
            left -= short
    return wanted


def _scarcest_leaf(pool: ExportPool, block: npt.NDArray[np.int64]) -> int:
    if len(block) == 0:
        return 0
    leaves = int(pool.n_leaves[block[0]])
    return int(np.bincount(pool.leaf[block], minlength=leaves)[:leaves].min())


class _Picker:
    """Selects ``quota`` episodes of each leaf, for one combination of split, source and category."""

    def __init__(self, pool: ExportPool, block: npt.NDArray[np.int64], quota: int, balance: list[int]) -> None:
        self._pool = pool
        self._balance = balance
        self._block = block
        self._n_leaves = int(pool.n_leaves[block[0]])
        self._single = block[~pool.grouped[block]]
        self._room = [quota] * self._n_leaves
        self._terms_of = _terms_of(pool, block)

    def pick(self) -> npt.NDArray[np.int64]:
        """Return the selected episodes: whole counterfactual groups first, then single episodes up to the quota."""
        single = np.bincount(self._pool.leaf[self._single], minlength=self._n_leaves)[: self._n_leaves]
        quota = self._room[0]
        before = list(self._balance)
        while True:
            taken = list(self._whole_groups())
            lacking = int(max(0, (np.array(self._room) - single).max()))
            if not lacking:
                break
            quota -= lacking
            self._room = [quota] * self._n_leaves
            self._balance[:] = before
        queues = self._queues(self._single.tolist(), taken)
        while any(self._room):
            for leaf in range(self._n_leaves):
                if self._room[leaf]:
                    taken.append(self._take(queues[leaf]))
                    self._room[leaf] -= 1
        return np.array(taken, dtype=np.int64)

    def _whole_groups(self) -> Iterator[int]:
        queue = _Queue(_groups(self._pool, self._block)[::-1])
        while (rows := self._evenest(queue)) is not None:
            need = np.bincount(self._pool.leaf[rows], minlength=self._n_leaves).tolist()
            if all(n <= room for n, room in zip(need, self._room, strict=True)):
                self._room = [room - n for n, room in zip(need, self._room, strict=True)]
                self._count(self._terms(rows))
                yield from rows

    def _queues(self, rows: Sequence[int], taken: Sequence[int]) -> list[dict[int, _Queue]]:
        queues: list[dict[int, _Queue]] = [{} for _ in range(self._n_leaves)]
        for row in reversed(rows):
            leaf, stratum = int(self._pool.leaf[row]), int(self._pool.stratum[row])
            queues[leaf].setdefault(stratum, _Queue()).waiting.append([row])
        for row in taken:
            queue = queues[int(self._pool.leaf[row])].get(int(self._pool.stratum[row]))
            if queue is not None:
                queue.taken += 1
        return queues

    def _take(self, by_stratum: dict[int, _Queue]) -> int:
        """Take the candidate that balances the truths best, from the stratum with the fewest selected episodes, and
        return its row.
        """
        stratum = min((q.taken, self._pool.strata[s], s) for s, q in by_stratum.items() if q.window or q.waiting)[2]
        queue = by_stratum[stratum]
        queue.taken += 1
        rows = self._evenest(queue)
        assert rows is not None
        self._count(self._terms(rows))
        return rows[0]

    def _evenest(self, queue: _Queue) -> list[int] | None:
        """Remove a candidate from the queue and return its rows; None if the queue is empty. The choice among the next
        few candidates is the one that adds least to Σ (true − false)², summed over the kinds of condition and
        `WHOLES`; on ties the earliest.
        """
        while queue.waiting and len(queue.window) < LOOKAHEAD:
            rows = queue.waiting.pop()
            queue.window.append((rows, self._terms(rows)))
        if not queue.window:
            return None
        balance = self._balance
        added = [sum([balance[kind] * sign for kind, sign in terms]) for _, terms in queue.window]
        return queue.window.pop(added.index(min(added)))[0]

    def _terms(self, rows: list[int]) -> Terms:
        if len(rows) == 1:
            return self._terms_of[rows[0]]
        return [term for row in rows for term in self._terms_of[row]]

    def _count(self, terms: Terms) -> None:
        for kind, sign in terms:
            self._balance[kind] += sign


def _terms_of(pool: ExportPool, rows: npt.NDArray[np.int64]) -> dict[int, Terms]:
    """Return the terms of each of `rows`."""
    sizes = pool.offsets[rows + 1] - pool.offsets[rows]
    ends = np.cumsum(sizes)
    places = np.arange(ends[-1]) + np.repeat(pool.offsets[rows] - (ends - sizes), sizes)
    signs = np.where(pool.truths[places], 1, -1)
    terms = [*zip(pool.conditions[places].tolist(), signs.tolist(), strict=True)]
    bounds = zip(rows.tolist(), (ends - sizes).tolist(), ends.tolist(), strict=True)
    named = [name.rpartition("\t")[2] for name in pool.kinds]
    wholes = {kind: len(named) + WHOLES.index(name) for kind, name in enumerate(named) if name in WHOLES}
    return {
        row: [*(own := terms[begin:end]), *((wholes[kind], sign) for kind, sign in own if kind in wholes)]
        for row, begin, end in bounds
    }


@dataclass
class _Queue:
    """The candidates of one leaf and stratum. The next ones are in ``window``, the later ones in ``waiting`` in reverse
    order.
    """

    waiting: list[list[int]] = field(default_factory=list)
    window: list[tuple[list[int], Terms]] = field(default_factory=list)
    taken: int = 0


def _cells(
    pool: ExportPool,
    split: Split,
    source: int,
    category: Category,
    block: npt.NDArray[np.int64],
    taken: npt.NDArray[np.int64],
    wanted: int,
) -> list[SelectionCell]:
    leaves = SHAPES[category].leaves
    available = np.bincount(pool.leaf[block], minlength=leaves)
    selected = np.bincount(pool.leaf[taken], minlength=leaves)
    return [
        SelectionCell(split, pool.sources[source], category, leaf, int(available[leaf]), wanted, int(selected[leaf]))
        for leaf in range(leaves)
    ]


def _imbalance(pool: ExportPool, inside: npt.NDArray[np.bool_]) -> float:
    """Return how uneven the truths of conditions are among the episodes of the mask ``inside``: Σ |true − false| ÷ Σ
    (true + false), summed over the kinds of condition.
    """
    chosen = np.repeat(inside, np.diff(pool.offsets))
    kinds, truths = pool.conditions[chosen], pool.truths[chosen]
    if len(kinds) == 0:
        return 0.0
    total = np.bincount(kinds, minlength=len(pool.kinds))
    true = np.bincount(kinds[truths], minlength=len(pool.kinds))
    return float(np.abs(2 * true - total).sum() / total.sum())
