"""When a phase of a run will be over: what is left by the cost model, at the pace of the receipts so far."""

from __future__ import annotations

from typing import Final

from factory.receipt import Receipt

__all__ = ["Remaining", "readable"]

PRIOR_SECONDS: Final = 5.0
"""CPU seconds of done work that weigh as much as the model's own word on the pace, so that the first receipt, which
pays for imports and caches, does not decide alone."""


class Remaining:
    """Seconds left by the clock.

    seconds : CPU seconds expected of the whole phase
    workers : how many share them
    """

    def __init__(self, seconds: float, workers: int = 1) -> None:
        self._expected = seconds
        self._workers = max(workers, 1)
        self._done = 0.0
        self._took = 0.0

    def unit(self, receipt: Receipt) -> None:
        """A unit is done. What it took by the clock counts, since others may share the machine."""
        self._done += receipt.expected
        self._took += receipt.seconds

    @property
    def seconds(self) -> float:
        """Work left ÷ workers, times seconds by the clock for each expected CPU second so far."""
        pace = (self._took + PRIOR_SECONDS) / (self._done + PRIOR_SECONDS)
        return max(self._expected - self._done, 0.0) * pace / self._workers


def readable(seconds: float) -> str:
    """A duration for a person: ``45 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
