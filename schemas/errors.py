"""Every error this project raises, in one tree.

::

    CondVLNError
    ├── UsageError              the command or its configuration is wrong          exit 1
    │   └── ConfigError         a key of the configuration: unknown, mistyped, missing folder
    ├── InputError              a source file can't be used: the scene is quarantined
    │   ├── FormatError         malformed, hostile, or of the wrong type
    │   │   └── TruncatedError  the file ends early; what came before was read
    │   ├── LimitError          a scene is larger than a limit of the configuration
    │   ├── MissingFileError    a file that the format requires is not there
    │   │   └── PointerError    a pointer of Git LFS or git-annex stands in its place
    │   └── PathEscapeError     a path inside a file climbs out of the dataset's root
    ├── StoreError              the store refused or is damaged
    │   ├── CorruptShardError   bytes on disk differ from their recorded hash
    │   └── PublishConflictError  another publisher moved the ref first
    ├── SmallerExportError      a new export would hold less for no known reason        exit 3
    ├── TransientIOError        worth another try (network, busy disk)
    ├── ClusterError            Ray died or does not answer, or a node does not see the data; what was committed stays
    ├── StageError              a stage broke its contract (wrong columns, repeated keys, an undeclared table)
    ├── DeadlineError           a unit ran longer than its deadline
    ├── MemoryCeilingError      a unit outgrew the memory ceiling of its process (also a MemoryError)
    ├── ProofError              a published fact does not hold                      exit 3
    └── FailureBudgetError      too many scenes failed; the run was stopped         exit 4

An error says what is wrong, where (file, place in it, scene) and what to do about it.
"""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "ClusterError",
    "CondVLNError",
    "ConfigError",
    "CorruptShardError",
    "DeadlineError",
    "FailureBudgetError",
    "FormatError",
    "InputError",
    "LimitError",
    "MemoryCeilingError",
    "MissingFileError",
    "PathEscapeError",
    "PointerError",
    "ProofError",
    "PublishConflictError",
    "SmallerExportError",
    "StageError",
    "StoreError",
    "TransientIOError",
    "TruncatedError",
    "UsageError",
    "shown_path",
]


def shown_path(path: str | Path) -> str:
    r"""Return a path as text that can be printed and stored: a byte of a name that is not UTF-8 becomes ``\xff``."""
    try:
        return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # not a name that an operating system gave
        return str(path).encode("utf-8", "backslashreplace").decode("utf-8")


class CondVLNError(Exception):
    """Base of all errors raised on purpose.

    Parameters
    ----------
    what : what is wrong, as a sentence without a full stop
    where : file the fault lies in, if any
    place : place inside that file (JSON path, byte offset, field, object id)
    remedy : what the reader should do
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str | Path | None = None, place: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = shown_path(where) if where is not None else ""
        self.place = place
        self.remedy = remedy
        super().__init__(self._message())

    def _message(self) -> str:
        parts = []
        if self.where:
            parts.append(self.where)
        if self.place:
            parts.append(self.place)
        head = ": ".join([*parts, self.what])
        return f"{head}. {self.remedy}" if self.remedy else head

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments need a hand in crossing process borders.
        return (_rebuild, (type(self), self.what, self.where, self.place, self.remedy))


def _rebuild(kind: type[CondVLNError], what: str, where: str, place: str, remedy: str) -> CondVLNError:
    return kind(what, where=where or None, place=place, remedy=remedy)


class UsageError(CondVLNError):
    """The command line is wrong."""


class ConfigError(UsageError):
    """A key of the configuration is unknown, has a wrong value, or names something that is not there."""


class InputError(CondVLNError):
    """A source file can't be used; the scene it belongs to is quarantined and the run goes on."""

    exit_code = 3


class FormatError(InputError):
    """A file is malformed, hostile or of the wrong type."""


class TruncatedError(FormatError):
    """A file ends early."""


class LimitError(InputError):
    """A scene is larger than the configuration's `limits` allow."""


class MissingFileError(InputError):
    """A file that the format requires is not there."""


class PointerError(MissingFileError):
    """A pointer of Git LFS or git-annex is in the place of a file that was not downloaded."""


class PathEscapeError(InputError):
    """A path found inside a file leads out of the root of its dataset."""


class StoreError(CondVLNError):
    """The store refused a write, or holds something it should not."""


class CorruptShardError(StoreError):
    """The bytes of a committed file differ from the hash recorded at its commit."""


class PublishConflictError(StoreError):
    """Another publisher moved the ref between our read and our write."""


class SmallerExportError(CondVLNError):
    """An export would hold fewer episodes than the one in place, and nothing that changed explains it."""

    exit_code = 3


class TransientIOError(CondVLNError):
    """An input/output fault that another try may cure. The factory retries after no other error."""


class ClusterError(CondVLNError):
    """Ray can't be started or reached, died, or has a node that does not see the data.

    What was committed stays, and the next run goes on from it.
    """


class StageError(CondVLNError):
    """A stage's output is not what the stage declared. The unit is quarantined; the stage needs a fix."""

    exit_code = 3


class DeadlineError(CondVLNError):
    """A unit ran longer than its deadline and was stopped; it is quarantined."""

    exit_code = 3


class MemoryCeilingError(CondVLNError, MemoryError):
    """A unit outgrew the memory ceiling of the process that worked on it; it is quarantined."""

    exit_code = 3


class ProofError(CondVLNError):
    """A published fact was recomputed and does not hold."""

    exit_code = 3


class FailureBudgetError(CondVLNError):
    """More scenes failed than the run's budget allows."""

    exit_code = 4
