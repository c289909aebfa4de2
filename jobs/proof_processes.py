"""The proof of an export, shared out over processes.

Each process reads all of the export, which takes a tenth of the time, and proves the scenes that it claims. The
certificates come in the order of the export, whoever proved them.
"""

from __future__ import annotations

import multiprocessing
import pickle
import traceback
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Final, Literal, NamedTuple

from condvln.verify import Certificate
from jobs.parent_watch import end_with_parent
from schemas.errors import ClusterError, CondVLNError

__all__ = ["Prover", "prove_side_by_side"]

Prover = Callable[[Callable[[int], bool]], Iterator[tuple[int, list[Certificate]]]]
"""``condvln.verify.prove_runs`` with its arguments, but for the function that is asked whether a scene is to be proven;
is pickled.
"""
AHEAD: Final = 4
"""Number of scenes for each process that may be proven before an earlier one is done: they wait in memory."""


class _Told(NamedTuple):
    """What a process tells: certificates of a scene; how many scenes there are, with certificates of unread entries; an
    error that comes after those of all scenes before `number`.
    """

    kind: Literal["scene", "end", "error"]
    number: int
    content: Any


def prove_side_by_side(prove: Prover, workers: int) -> Iterator[Certificate]:
    """Yield the certificates that `prove` yields in one process.

    Raises
    ------
    ClusterError : a process was killed
    InputError : as `prove` raises it
    """
    context = multiprocessing.get_context("spawn")
    claimed, room = context.Value("q", 0), context.Semaphore(AHEAD * workers)
    readers: dict[Connection, SpawnProcess] = {}
    try:
        for _ in range(workers):
            reader, writer = context.Pipe(duplex=False)
            process = context.Process(target=_process, args=(prove, claimed, room, writer), daemon=True)
            process.start()
            writer.close()  # so that the pipe ends when its process does
            readers[reader] = process
        yield from _in_order(_all_told(readers), room.release)
    finally:
        for reader, process in readers.items():
            process.terminate()
            process.join()
            reader.close()


def _in_order(told: Iterator[_Told], release: Callable[[], None]) -> Iterator[Certificate]:
    """Yield the certificates in the order of their scenes, and call `release` after those of each scene."""
    kept: dict[str, dict[int, Any]] = {"scene": {}, "end": {}, "error": {}}
    at = 0
    while True:
        if at in kept["scene"]:
            yield from kept["scene"].pop(at)
            release()
            at += 1
        elif at in kept["error"]:
            raise kept["error"][at]
        elif at in kept["end"]:
            yield from kept["end"][at]
            return
        else:
            found = next(told)
            kept[found.kind].setdefault(found.number, found.content)


def _all_told(readers: Mapping[Connection, SpawnProcess]) -> Iterator[_Told]:
    """Yield what the processes tell, as it comes. Raises ``ClusterError`` if one ends before it has told all."""
    open_ones = {*readers}
    while open_ones:
        for reader in wait([*open_ones]):
            assert isinstance(reader, Connection)
            try:
                data = reader.recv_bytes()
            except (EOFError, OSError):  # the latter in the middle of a message
                process = readers[reader]
                process.join()
                code = process.exitcode or 0
                raise ClusterError(
                    f"a process of the proof ended with {f'signal {-code}' if code < 0 else f'exit code {code}'}",
                    remedy="Prove with fewer processes (--workers 1) if memory was short.",
                ) from None
            found: _Told = pickle.loads(data)
            if found.kind != "scene":
                open_ones.remove(reader)
            yield found


def _process(prove: Prover, claimed: Any, room: Any, writer: Connection) -> None:
    """Prove the scenes that this process claims; run in a process of its own."""
    end_with_parent()
    seen, proving = 0, False

    def mine(number: int) -> bool:
        nonlocal seen, proving
        seen, proving = number + 1, False
        with claimed.get_lock():
            if number < claimed.value:
                return False
            room.acquire()  # within the lock, so that the first scene that is missing never waits for later ones
            claimed.value = number + 1
        proving = True
        return True

    def tell(kind: Literal["scene", "end", "error"], number: int, content: Any) -> None:
        writer.send_bytes(pickle.dumps(_Told(kind, number, content), pickle.HIGHEST_PROTOCOL))

    try:
        for number, certificates in prove(mine):
            tell("scene" if proving else "end", number, certificates)
            proving = False
    except Exception as error:  # raised again where the certificates are taken
        if not isinstance(error, CondVLNError):
            traceback.print_exc()  # it does not travel
        tell("error", seen - proving, _travels(error))


def _travels(error: Exception) -> Exception:
    """Return an error that another process can read: the same one if it can be."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(repr(error))
    return error
