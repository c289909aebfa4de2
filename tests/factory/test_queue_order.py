"""The order of work: by cost, equal costs in the order they came in."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from factory import Unit, queue, sorting
from factory.queue import WorkSpool, tasks
from factory.unit import Work

costs = st.lists(st.sampled_from([0.0, 1e-9, 0.5, 0.5000001, 3.0, 1e30]) | st.floats(0.0, 1e6), max_size=200)


@given(costs, st.integers(1, 70))
def test_work_is_ordered_by_cost(seconds: list[float], at_once: int) -> None:
    units = [Unit(f"made/{k}", "made", (), {}, {}) for k in range(len(seconds))]
    with WorkSpool(Work(unit, b"", cost, 1) for unit, cost in zip(units, seconds, strict=True)) as spool:
        before = queue.SORTED_AT_ONCE
        queue.SORTED_AT_ONCE = sorting.SORTED_AT_ONCE = at_once
        try:
            waiting = tasks(spool, 0, 2)
            orders = [*waiting], [*waiting.smallest_first()]
        finally:
            queue.SORTED_AT_ONCE = sorting.SORTED_AT_ONCE = before
        rounded = np.array(seconds, np.float32)
        wanted = [np.argsort(-rounded, kind="stable"), np.argsort(rounded, kind="stable")]
        found = [[work.unit.unit_id for task in order for work in task.work] for order in orders]
        assert found == [[units[k].unit_id for k in order] for order in wanted]
        np.testing.assert_allclose(waiting.seconds, sum(seconds), rtol=1e-6, atol=1e-30)
