"""``condvln sources``: what is there, what is missing, and what would be skipped or quarantined. Runs nothing."""

from __future__ import annotations

from jobs.pipeline import list_units
from jobs.report import Report, Section
from jobs.workspace import file_hashes, hasher
from schemas.config import Config

__all__ = ["survey"]


def survey(config: Config) -> Report:
    """Scenes of every configured source, and those that can't even be listed."""
    hashes = file_hashes(config)
    units = list_units(config, hasher(hashes))
    hashes.save()
    rows, faults = [], []
    for source in config.sources:
        own = [unit for unit in units if unit.partition == source.family and unit.payload["root"] == str(source.root)]
        broken = [unit for unit in own if unit.fault is not None]
        files = {i.path: i.size for unit in own for i in unit.inputs}
        rows.append((source.family, str(source.root), len(own), len(broken), len(files), sum(files.values()) / 2**20))
        faults += [(unit.unit_id, str(unit.fault)) for unit in broken]
    columns = ("family", "root", "scenes", "unreadable", "files", "MiB")
    return Report(
        {"sources": [dict(zip(columns, row, strict=True)) for row in rows], "unreadable": [list(f) for f in faults]},
        [],
        [Section("Sources", columns, [*rows]), Section("Unreadable", ("scene", "cause"), [*faults])],
    )
