"""Metrics of a run for Ray's Prometheus endpoint. The driver computes them from the receipts.

In Prometheus the names begin with ``ray_``. Units are in the names, as its conventions ask. The endpoint is part of
``ray[default]``; a Ray without it takes the numbers and drops them.
"""

from __future__ import annotations

from typing import Final

from factory.receipt import Receipt

__all__ = ["METRICS", "RunMetrics"]

METRICS: Final = {
    "factory_units_total": "Finished units, by status",
    "factory_stages_total": "Stages run, by stage",
    "factory_rows_total": "Rows written, by table",
    "factory_stage_seconds": "Seconds that a stage took for one unit, by stage",
    "factory_unit_peak_rss_bytes": "Peak memory of the latest unit, in bytes",
    "factory_tasks_in_flight": "Tasks in flight on Ray",
    "factory_task_failures_total": "Tasks that came back without receipts, by kind (worker, node, memory, raised)",
}

BUCKETS: Final = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
"""Bounds of the histogram of seconds: half-decades from a text stage to the largest building."""


class RunMetrics:
    """Counts results of tasks. Ray must be running."""

    def __init__(self) -> None:
        from ray.util.metrics import Counter, Gauge, Histogram

        def counter(name: str, tag: str) -> Counter:
            return Counter(name, description=METRICS[name], tag_keys=(tag,))

        self._units = counter("factory_units_total", "status")
        self._stages = counter("factory_stages_total", "stage")
        self._rows = counter("factory_rows_total", "table")
        self._failures = counter("factory_task_failures_total", "kind")
        seconds = "factory_stage_seconds"
        self._seconds = Histogram(seconds, description=METRICS[seconds], boundaries=BUCKETS, tag_keys=("stage",))
        self._rss = Gauge("factory_unit_peak_rss_bytes", description=METRICS["factory_unit_peak_rss_bytes"])
        self._flying = Gauge("factory_tasks_in_flight", description=METRICS["factory_tasks_in_flight"])

    def unit(self, receipt: Receipt) -> None:
        """Count a finished unit."""
        self._units.inc(1, {"status": receipt.status})
        for stage in receipt.stages:
            if not stage.made:
                continue
            self._stages.inc(1, {"stage": stage.stage})
            self._seconds.observe(stage.seconds, {"stage": stage.stage})
            self._rss.set(stage.peak_rss)
            for table in stage.tables:
                if table.rows:
                    self._rows.inc(table.rows, {"table": table.table})

    def failed(self, kind: str) -> None:
        """Count a task that failed and returned no receipts."""
        self._failures.inc(1, {"kind": kind})

    def in_flight(self, tasks: int) -> None:
        """Set the number of tasks that are in flight in Ray."""
        self._flying.set(tasks)
