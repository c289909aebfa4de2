"""The work queue: units of work, stages and keys, parallel execution, committed shards, published snapshots.

It knows nothing of what the units are. ``jobs`` makes a ``Pipeline`` and lists ``Unit`` s; ``plan`` says what a run
would do, ``run`` does it and publishes a ``Snapshot``.
"""

import factory.allocator  # noqa: F401 - before anything loads Arrow
from factory.address import open_store
from factory.executor import Executor, InlineExecutor
from factory.files import FileHashes, hash_file
from factory.local_store import LocalStore
from factory.pipeline import Pipeline, TableSpec
from factory.plan import Plan, PlanEntry
from factory.receipt import Failure, Receipt
from factory.report import FailureBudget, Progress, RunReport
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.stage import Aggregate, Stage, StageOutput
from factory.store import Store
from factory.unit import InputFile, Unit

__all__ = [
    "Aggregate",
    "Executor",
    "Failure",
    "FailureBudget",
    "FileHashes",
    "InlineExecutor",
    "InputFile",
    "LocalStore",
    "Pipeline",
    "Plan",
    "PlanEntry",
    "Progress",
    "Receipt",
    "RunReport",
    "Snapshot",
    "Stage",
    "StageOutput",
    "Store",
    "TableSpec",
    "Unit",
    "hash_file",
    "open_store",
    "plan",
    "run",
]
