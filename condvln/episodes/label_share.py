"""The share of a scene's leaves that one label may be the target of, and which episodes are dropped to keep it.

`label_cap` can't hold in every scene: of k labels one always has at least 1/k of the leaves, and where only one object
lies far enough from the others, every episode has it. The rule (docs/decisions/0008):

1. Where the placed episodes have k labels, a label may have 1.25/k of the leaves if that is more than the cap.
2. Never more than half of the placed episodes are dropped. Where that does not reach the allowed share, as few are
   dropped as bring the largest share to its least.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from schemas.config.constants import FEW_LABELS_SLACK, KEPT_AT_LEAST

__all__ = ["allowed_share", "most_leaves", "over_share"]


def allowed_share(label_cap: float, labels: int) -> float:
    """The share of leaves that each of so many labels may have."""
    return max(label_cap, FEW_LABELS_SLACK / max(1, labels))


def most_leaves(share: float, leaves: int) -> int:
    """How many of so many leaves one label may have. Rounded up, so that small sets are not dropped."""
    return math.ceil(share * leaves)


def over_share(units: Sequence[Sequence[Counter[str]]], label_cap: float) -> list[int]:
    """Indices of the units to drop so that no label is over its share, in the order in which they are dropped.

    Parameters
    ----------
    units : what is kept or dropped together, one counter of the labels of its leaves an episode
    """
    leaves = [sum(unit, Counter[str]()) for unit in units]
    total = sum(leaves, Counter[str]())
    share = allowed_share(label_cap, len(total))
    episodes = sum(map(len, units))
    floor = math.ceil(KEPT_AT_LEAST * episodes)
    left, dropped = set(range(len(units))), list[int]()
    best, fewest = math.inf, 0
    while total:
        label = max(sorted(total), key=lambda name: total[name])
        most = most_leaves(share, total.total())
        if total[label] <= most:
            return dropped
        if total[label] / total.total() < best:
            best, fewest = total[label] / total.total(), len(dropped)
        over = {name for name, count in total.items() if count > most}
        holding = [k for k in left if leaves[k][label] and episodes - len(units[k]) >= floor]
        if not holding:
            break
        # What holds most of the labels that are over goes first; of equals the last.
        worst = max(holding, key=lambda k: (len(over & leaves[k].keys()), k))
        left.remove(worst)
        dropped.append(worst)
        episodes -= len(units[worst])
        total -= leaves[worst]
    return dropped[:fewest]
