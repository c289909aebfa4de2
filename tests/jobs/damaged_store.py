"""Ways to damage a store, one file of one kind at a time, and the verbs that meet the damage."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from factory.index import Index
from factory.snapshot import Snapshot, read_ref
from factory.store import LocalStore
from jobs.export import run_export
from jobs.generate import run_generate
from jobs.plan import make_plan
from jobs.query import query_target
from jobs.rebuild import run_rebuild
from jobs.report import Report
from jobs.show import show_episodes
from jobs.status import target_status
from jobs.verify import verify_export
from jobs.workspace import Target, open_store
from schemas.config import Config

__all__ = ["DAMAGES", "KINDS", "READERS", "REPAIRERS", "VERBS", "Built", "settle"]

KINDS: Final = (
    "unit table",
    "unit.json",
    "built navmesh",
    "snapshot table",
    "manifest",
    "index",
    "ref",
    "pin",
    "aggregate",
)
DAMAGES: Final = ("removed", "cut", "changed", "older")


def _verify(config: Config) -> Report:
    assert config.export is not None
    return verify_export(config, config.export)


READERS: Final[dict[str, Callable[[Config], Report]]] = {
    "plan": make_plan,
    "status": lambda config: target_status(Target.of(config)),
    "query": lambda config: query_target(Target.of(config), "SELECT source, count(*) FROM episodes GROUP BY source"),
    "show": lambda config: show_episodes(config, sample=3),
    "verify": _verify,
    "export": run_export,
}
REPAIRERS: Final[dict[str, Callable[[Config], Report]]] = {
    "generate": lambda config: run_generate(config, inline=True),
    "rebuild": lambda config: run_rebuild(config, inline=True),
    "rebuild --if-changed": lambda config: run_rebuild(config, inline=True, if_changed=True),
    "rebuild --verify": lambda config: run_rebuild(config, inline=True, verify=True),
}
VERBS: Final = {**READERS, **REPAIRERS}


def settle(folder: Path) -> None:
    """Let every file look as if it was written a minute ago."""
    then = time.time() - 60
    for path in folder.rglob("*"):
        os.utime(path, (then, then))


def _files(store: Path, name: str) -> dict[str, Path]:
    """The file of each kind that a ref names."""
    snapshot = Snapshot.open(LocalStore(store), name)
    ref, _ = read_ref(LocalStore(store), name)
    row = snapshot.index.table.slice(0, 1).to_pylist()[0]

    def unit(stage: str, file: str) -> Path:
        key = row[f"{stage}.key"].hex()
        return store / "units" / stage / key[:2] / key / file

    return {
        "unit table": unit("text", "instructions.parquet"),
        "unit.json": unit("text", "unit.json"),
        "built navmesh": unit("scene", "navmeshes.parquet"),
        "snapshot table": store / snapshot.paths("episodes")[0],
        "manifest": store / "snapshots" / ref.snapshot_id / "manifest.json",
        "index": store / Index.path(ref.index),
        "ref": store / "refs" / f"{name}.json",
        "pin": store / "pins" / snapshot.manifest.pipeline / f"{name}.json",
        "aggregate": store / "aggregates" / "priors" / f"{snapshot.manifest.aggregates['priors']}.parquet",
    }


@dataclass(frozen=True)
class Built:
    """A published and exported store with an older state behind it, kept aside so that it can be put back.

    config : store and export lie in ``work``, where cases damage them
    older : the bytes of each kind's file in the older state
    """

    config: Config
    aside: Path
    snapshot_id: str
    older: dict[str, bytes]
    answers: dict[str, Any]

    @classmethod
    def make(cls, folder: Path, config: Config, scenes: list[str]) -> Built:
        """Publish the last scene, then all with renewed priors, and leave nothing to do.

        config : its store and export are replaced
        """
        work = folder / "work"
        config = config.model_copy(update={"store": work / "store", "export": work / "export"})
        first = config.sources[0].model_copy(update={"scenes": (scenes[-1],)})
        assert run_generate(config.model_copy(update={"sources": (first,), "export": None, "seed": 1}), inline=True)
        older = {kind: path.read_bytes() for kind, path in _files(work / "store", config.name).items()}
        done = run_generate(config, inline=True, renew_priors=True)
        assert done.exit_code == 0, done.lines
        for _ in range(2):
            assert run_rebuild(config, inline=True, if_changed=True).exit_code == 0
        assert "no name, size or time of a file changed" in run_rebuild(config, inline=True, if_changed=True).lines[0]
        verified = READERS["verify"](config)
        assert verified.exit_code == 0, verified.lines
        shutil.copytree(work, folder / "aside")
        built = cls(config, folder / "aside", done.document["snapshot_id"], older, {})
        for verb, ask in READERS.items():
            built.restore()
            built.answers[verb] = told(verb, ask(config))
        built.restore()
        return built

    @property
    def store(self) -> Path:
        """Folder of the store."""
        assert isinstance(self.config.store, Path)
        return self.config.store

    def restore(self) -> None:
        """Put everything back, times included."""
        shutil.rmtree(self.store.parent, ignore_errors=True)
        shutil.copytree(self.aside, self.store.parent)

    def damage(self, kind: str, damage: str) -> Path:
        """Damage the file of a kind; returns it."""
        path = _files(self.store, self.config.name)[kind]
        data = path.read_bytes()
        if damage == "removed":
            path.unlink()
            return path
        third = len(data) // 3
        flipped = bytes(byte ^ 1 for byte in data[third : 2 * third])
        wrong = {
            "cut": data[: len(data) // 2],
            "changed": data[:third] + flipped + data[2 * third :],
            "older": self.older[kind],
        }[damage]
        assert wrong != data
        path.write_bytes(wrong)
        return path

    def rows(self) -> dict[str, int]:
        """Rows of every published table, each file checked against its hash."""
        snapshot = Snapshot.open(open_store(self.config), self.config.name)
        assert snapshot.snapshot_id == self.snapshot_id
        found = {name: snapshot.table(name).num_rows for name in snapshot.manifest.tables}
        assert found == {name: table.rows for name, table in snapshot.manifest.tables.items()}
        return found

    def exported(self, below: Path | None = None) -> dict[str, bytes]:
        """Every file of the export but its history and what a verify left."""
        folder = (below or self.store.parent) / "export"
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file() and path.name != "CHANGELOG.md" and "certificates" not in path.parts
        }


def told(verb: str, report: Report) -> Any:
    """What a reading verb answered, without what differs from one run to the next."""
    document = json.loads(json.dumps(report.document, default=str))
    if verb == "plan":
        return {name: document[name] for name in ("snapshot_id", "counts", "reasons", "removed", "renewed", "damaged")}
    if verb == "status":
        return {name: document[name] for name in ("snapshot", "damaged")}
    return document
