"""``condvln status``: what is published, and what is in quarantine and why."""

from __future__ import annotations

from factory.status import store_status
from jobs.report import Report, Section
from jobs.workspace import open_store
from schemas.config import Config

__all__ = ["report_status"]


def report_status(config: Config) -> Report:
    """State of the configuration's store and ref."""
    found = store_status(open_store(config))
    own = next((status for status in found.refs if status.ref.name == config.name), None)
    ref, manifest = (None, None) if own is None else (own.ref, own.manifest)
    document = {
        "store": found.url,
        "ref": None if ref is None else ref.model_dump(mode="json"),
        "snapshot": None if manifest is None else manifest.model_dump(mode="json"),
        "quarantine": [record.model_dump(mode="json") for record in found.quarantine],
    }
    lines = [f"store {found.url}"]
    if ref is None:
        lines.append(f"nothing is published as {config.name!r} yet")
    else:
        lines.append(f"{config.name} → snapshot {ref.snapshot_id} (generation {ref.generation}, {ref.published_at})")
    sections = []
    if manifest is not None:
        lines.append("scenes: " + ", ".join(f"{n} {status}" for status, n in sorted(manifest.units.items())))
        rows = [(name, table.rows, len(table.partitions)) for name, table in sorted(manifest.tables.items())]
        sections.append(Section("Tables", ("table", "rows", "sources"), [*rows]))
        costs = [(name, s.units, s.rows, s.seconds, round(s.peak_rss / 2**20)) for name, s in manifest.stages.items()]
        sections.append(Section("Stages", ("stage", "scenes", "rows", "seconds", "peak MiB"), [*costs]))
    sections.append(
        Section(
            "Quarantine",
            ("scene", "stage", "attempts", "cause"),
            [(r.unit_id, r.stage, r.attempts, r.message) for r in found.quarantine],
        )
    )
    return Report(document, lines, sections)
