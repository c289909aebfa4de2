"""The target of a verb that only reads: a configuration, or a store given by its folder or address."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from factory.address import open_store
from factory.snapshot import Snapshot
from factory.store import Store
from jobs.configuration import load_config
from jobs.workspace import snapshot_folder
from schemas.config import Config
from schemas.errors import UsageError

__all__ = ["Target", "find_target"]


@dataclass(frozen=True)
class Target:
    """A store, the requested ref, and the configuration by which the store was named, if any.

    address : folder, or ``s3://…``
    name : the ref; None where the store was named and not a ref
    config : the configuration, where one was named
    """

    address: Path | str
    name: str | None
    config: Config | None = None

    def store(self) -> Store:
        """Return the open store."""
        return open_store(self.address)

    def refs(self) -> list[str]:
        """Return the names of all published refs, sorted."""
        return sorted(entry.path.split("/", 1)[1].removesuffix(".json") for entry in self.store().list("refs"))

    def ref(self) -> str:
        """Return the requested ref; if none was requested, the only ref of the store, or 'main'.

        Raises ``UsageError`` when it is not clear which is meant.
        """
        if self.name is not None:
            return self.name
        names = self.refs()
        if len(names) == 1:
            return names[0]
        if "main" in names or not names:
            return "main"
        raise UsageError(
            f"no ref is chosen, and {len(names)} are published: {', '.join(names)}",
            where=str(self.address),
            remedy="Choose one with --ref NAME.",
        )

    def snapshot(self) -> Snapshot:
        """Open the snapshot that is published under the requested ref; if no ref was requested, under the store's only
        ref or 'main'.

        Raises ``StoreError`` when nothing is published under it, ``UsageError`` when it is not clear which is meant.
        """
        return Snapshot.open(self.store(), self.ref())

    def folder(self, tables: Iterable[str] | None = None) -> Path:
        """Return the snapshot as a folder on this disk. If the store is elsewhere, the snapshot is fetched (only
        `tables`, if given).
        """
        return snapshot_folder(self.address, self.snapshot(), tables)


def find_target(text: str, overrides: Sequence[str] = (), ref: str | None = None) -> Target:
    """Return the target that the argument CONFIG|STORE names. Raises ``UsageError`` if it is neither a configuration
    nor a store, ``ConfigError`` if the configuration is faulty.
    """
    if "://" in text:
        open_store(text)
    path = Path(text)
    if "://" not in text and not path.is_dir():
        if not path.exists():
            raise UsageError("neither a configuration nor a store", where=text, remedy="Name a YAML file or a store.")
        config = load_config(path, overrides, check_roots=False)
        return Target(config.store, ref or config.name, config)
    if overrides:
        raise UsageError(
            "--set is only for a configuration, and this is a store",
            where=text,
            remedy="Name the YAML file, or leave --set out.",
        )
    if "://" not in text:
        path = path.resolve()
        if not any((path / name).is_dir() for name in ("refs", "units", "snapshots")):
            raise UsageError("no store is in this folder", where=path, remedy="A store holds refs/ and snapshots/.")
        return Target(path, ref)
    return Target(text, ref)
