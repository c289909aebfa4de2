"""Reports about units that take long; Ray's workers send them to the driver through the key-value store of Ray's head.

A worker writes only about a unit that has been at one stage for half a minute, so short units cost nothing. Where
Ray's interface is another, or the store does not answer, there is no word and nothing else is lost.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from typing import Final

from factory import machine
from factory.heartbeat import Busy, Place

__all__ = ["read_board", "report_to_board"]

PAUSE: Final = 5.0
"""Seconds between two reports of a worker."""

STALE: Final = 6 * PAUSE
"""Age in seconds from which a report counts as left by a worker that is gone."""

_PREFIX: Final = "condvln-busy:"


def report_to_board(run: str, place: Place, after: float) -> Callable[[], None]:
    """Start a thread that reports the unit a worker is busy with, as given by ``place``, whenever that unit takes long.
    Return a function that stops the thread. Worker processes call this.

    run : name of the dispatch that the worker serves
    after : seconds at one stage of a unit that are worth a report
    """
    end = threading.Event()
    key = f"{_PREFIX}{run}:{machine.host()}:{os.getpid()}"

    def watch() -> None:
        from ray.experimental import internal_kv

        written = False
        while not end.wait(PAUSE):
            busy = place.busy()
            try:
                if busy is not None and busy.seconds >= after - PAUSE:
                    document = {"unit": busy.unit_id, "stage": busy.stage, "seconds": busy.seconds, "at": time.time()}
                    internal_kv._internal_kv_put(key, json.dumps(document))
                    written = True
                elif written:
                    internal_kv._internal_kv_del(key)
                    written = False
            except Exception:  # a heartbeat must never cost a unit
                return

    threading.Thread(target=watch, name="board", daemon=True).start()
    return end.set


def read_board(run: str) -> list[Busy]:
    """Return the units that workers reported as taking long; empty if they can't be read. The driver calls this."""
    try:
        from ray.experimental import internal_kv

        found = []
        for key in internal_kv._internal_kv_list(f"{_PREFIX}{run}:"):
            value = internal_kv._internal_kv_get(key)
            document = json.loads(value) if value else None
            if document and time.time() - document["at"] < STALE:
                found.append(Busy(document["unit"], document["stage"], document["seconds"], endable=True))
        return found
    except Exception:
        return []
