"""Limit the share of a scene's leaves that have the same target label, and choose which episodes to drop to respect the
limit.

The limit `label_cap` can't hold in every scene: of k labels one always has at least 1/k of the leaves, and if only one
object is far enough from the others, it is in every episode. The rule (docs/decisions/0008):

1. Where the placed episodes have k labels, a label may have 1.25/k of the leaves if that is more than the cap.
2. At most half of the placed episodes are dropped. If that does not reach the allowed share, the fewest episodes are
   dropped that make the largest share as small as possible.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from schemas.config.constants import FEW_LABELS_SLACK, KEPT_AT_LEAST

__all__ = ["allowed_share", "most_leaves", "over_share"]


def allowed_share(label_cap: float, labels: int) -> float:
    """Return the maximum share of leaves that one label may have, where `labels` is the number of different labels."""
    return max(label_cap, FEW_LABELS_SLACK / max(1, labels))


def most_leaves(share: float, leaves: int) -> int:
    """Return how many of ``leaves`` leaves may have the same label if the maximum share is ``share``. The number is
    rounded up, so that small sets are not dropped.
    """
    return math.ceil(share * leaves)


def over_share(units: Sequence[Sequence[Counter[str]]], label_cap: float) -> list[int]:
    """Return the indices of the units to drop, in the order of dropping, so that no label exceeds its share.

    Parameters
    ----------
    units : what is kept or dropped as a whole: for each of its episodes a counter of its leaves' labels
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
        # The unit with the most leaves of labels above their share is dropped first; the last one on ties.
        worst = max(holding, key=lambda k: (len(over & leaves[k].keys()), k))
        left.remove(worst)
        dropped.append(worst)
        episodes -= len(units[worst])
        total -= leaves[worst]
    return dropped[:fewest]
