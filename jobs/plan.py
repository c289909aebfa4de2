"""``condvln plan``: what a run would do, why, and what it would cost. Runs nothing and writes no table."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

from factory.run import plan
from jobs.executor import place_of_work
from jobs.pipeline import build_pipeline, listed_units
from jobs.report import Report, Section
from jobs.workspace import open_store
from schemas.config import Config

__all__ = ["make_plan"]

SHOWN_FILES: Final = 5
"""Number of missing or damaged files named on a terminal."""


def make_plan(config: Config, *, every_scene: bool = False) -> Report:
    """Report what a run of `config` would do and would cost, given the snapshot that is published under the
    configuration's name.

    every_scene : a row for each scene in place of one for all scenes of one cause
    """
    store = open_store(config)
    found = plan(build_pipeline(config), listed_units(config), store, config.name)
    entries = [asdict(entry) for entry in found.entries]
    document: dict[str, Any] = {
        "counts": dict(found.counts),
        "reasons": dict(found.reasons),
        "seconds": round(found.seconds, 3),
        "possible_seconds": round(found.possible_seconds, 3),
        "removed": list(found.removed),
        "renewed": list(found.renewed),
        "damaged": list(found.damaged),
        "snapshot_id": found.snapshot_id,
        "scenes": entries,
    }
    lines = [
        ", ".join(f"{n} {status.lower()}" for status, n in sorted(found.counts.items())) or "no scenes",
        f"about {found.seconds:.0f} CPU s"
        + (
            f", up to {found.possible_seconds:.0f} CPU s more where an early cut-off does not spare it"
            if found.possible_seconds
            else ""
        )
        + ("; compiling kernels, once on a machine, is not counted" if found.seconds or found.possible_seconds else ""),
    ]
    if found.seconds:
        document["runs"] = place_of_work(config.ray, found.seconds)[1]
        lines.append(document["runs"])
    if found.snapshot_id is None:
        lines.append(f"nothing is published as {config.name!r} yet: {store.url}/refs/{config.name}.json is not there")
    if found.removed:
        lines.append(f"{len(found.removed)} scenes are no longer in the sources: {', '.join(found.removed[:5])} …")
    if found.renewed:
        lines.append(f"aggregates that would be rebuilt: {', '.join(found.renewed)}")
    if found.reasons["damaged"]:
        lines.append(f"files of {found.reasons['damaged']} scenes are missing from the store, or cut: they are rebuilt")
    if found.damaged:
        lines.append(
            f"{len(found.damaged)} published files are missing or damaged; generate or rebuild restores them: "
            + ", ".join(f"{store.url}/{path}" for path in found.damaged[:SHOWN_FILES])
            + (" …" if len(found.damaged) > SHOWN_FILES else "")
        )
    section = _scenes(entries) if every_scene else _groups([one for one in entries if one["status"] != "FRESH"])
    return Report(document, lines, [section])


def _groups(entries: list[dict[str, Any]]) -> Section:
    """Group the work to do, one row per cause, the most expensive first."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for entry in entries:
        key = (entry["status"], ", ".join(entry["reasons"]), _stages(entry["stages"]))
        groups.setdefault(key, []).append(entry)
    rows = [
        (len(found), *key, sum(entry["seconds"] for entry in found), _example(found)) for key, found in groups.items()
    ]
    rows.sort(key=lambda row: (-row[4], row[1:4]))
    title = "To do (--all lists every scene)" if entries else "To do"
    return Section(title, ("scenes", "status", "because of", "stages", "CPU s", "for example"), [*rows])


def _example(entries: list[dict[str, Any]]) -> str:
    first = min(entries, key=lambda entry: str(entry["unit_id"]))
    return f"{first['unit_id']}: {first['detail']}" if first["detail"] else str(first["unit_id"])


def _scenes(entries: list[dict[str, Any]]) -> Section:
    rows = [
        (e["unit_id"], e["status"], ", ".join(e["reasons"]), _stages(e["stages"]), e["seconds"], e["detail"])
        for e in entries
    ]
    return Section("Scenes", ("scene", "status", "because of", "stages", "CPU s", "detail"), [*rows])


def _stages(stages: tuple[tuple[str, str], ...]) -> str:
    return " ".join(f"{name}:{status.lower()}" for name, status in stages if status != "FRESH")
