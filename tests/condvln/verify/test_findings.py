"""Facts noted for many rows together are recorded as if each had been recorded by itself."""

from __future__ import annotations

import numpy as np

from condvln.verify.certificate import Certificate
from condvln.verify.findings import Findings


def test_certificates_are_those_of_checks_one_by_one() -> None:
    """Counts are equal, and so is the order of disagreements: rows' own, then leaf by leaf, then later ones."""
    draw = np.random.default_rng(5)
    for _ in range(50):
        sizes = draw.integers(2, 5, size=4)
        ends, leaves = np.cumsum(sizes), int(sizes.sum())
        first = ends - sizes
        island, budget, group, asked = (draw.uniform(size=4) < 0.6 for _ in range(4))
        order, end, wrong = (draw.uniform(size=leaves) < 0.6 for _ in range(3))
        together, alone = ([Certificate(k, "s", "x", "train") for k in range(4)] for _ in range(2))
        findings = Findings(ends)
        findings.rows("island", island, lambda k: (k, "row"), "start")
        findings.leaves("goal_order", order, lambda k: (k, "order"))
        findings.leaves("route_end", end, lambda k: (k, "end"), of=asked)
        findings.count("goal_side", 2 * sizes)
        findings.leaf_by_leaf()
        for k in np.flatnonzero(wrong).tolist():
            findings.refute_leaf(k, "goal_side", k, "side")
        findings.rows("budget", budget, lambda k: (k, "twice"), of=asked)
        findings.rows("group", group, lambda k: (k, "group"), lambda k: f"members of {k}")
        findings.count("path_apart", np.array([0, 1, 0, 0]))
        findings.refute_row(1, "path_apart", 1, 2, "path")
        findings.record(together)
        for row, certificate in enumerate(alone):
            certificate.holds("island", bool(island[row]), row, "row", "start")
            for k in range(first[row], ends[row]):
                name = f"leaf {k - first[row]}"
                certificate.holds("goal_order", bool(order[k]), k, "order", name)
                if asked[row]:
                    certificate.holds("route_end", bool(end[k]), k, "end", name)
                certificate.holds("goal_side", not wrong[k], k, "side", name)
                certificate.holds("goal_side", True, k, "side", name)
            if asked[row]:
                certificate.holds("budget", bool(budget[row]), row, "twice")
            certificate.holds("group", bool(group[row]), row, "group", f"members of {row}")
            if row == 1:
                certificate.holds("path_apart", False, 1, 2, "path")
        assert [one.document() for one in together] == [one.document() for one in alone]
