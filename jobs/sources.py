"""``condvln sources``: list what the configured sources hold, what they lack, and which scenes would be skipped or
quarantined. Builds nothing.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from condvln.labels import vocabulary
from condvln.sources.downloads import look_for
from jobs.pipeline import open_configured
from jobs.report import Report, Section
from jobs.survey import Survey, survey_source
from jobs.workspace import file_hashes, hasher
from schemas.config import Config
from schemas.errors import ConfigError, MissingFileError

__all__ = ["survey"]

SHOWN: Final = 20
"""Number of scenes and labels listed on a terminal; ``--json`` has all of them."""


def survey(config: Config, *, limit: int | None = None, console: Console | None = None) -> Report:
    """Survey every configured source: files, scenes, rooms, objects, labels, and what a run would leave out.

    limit : most scenes read of each source; all where None
    """
    hashes = file_hashes(config)
    document: list[dict[str, Any]] = []
    sections: dict[str, list[tuple[Any, ...]]] = {name: [] for name in _COLUMNS}
    for source in config.sources:
        try:
            opened = open_configured(config, source, hasher(hashes))
            handles = opened.handles()
        except ConfigError as error:
            document.append({"family": source.family, "root": str(source.root), "error": str(error)})
            sections["Not a dataset"].append((source.family, str(error)))
            continue
        hashes.save()
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, console=console or Console(stderr=True), transient=True) as progress:
            task = progress.add_task(f"reading {source.family}", total=min(len(handles), limit or len(handles)))
            found = survey_source(
                opened,
                handles,
                config.agent,
                anchor_size=config.sampling.anchor_size,
                limit=limit,
                tick=partial(progress.advance, task),
            )
        inputs = {i.path: i.size for handle in handles for i in handle.inputs}
        kinds = look_for(source.family, source.root, source.houses)
        document.append(
            {
                "family": source.family,
                "root": str(source.root),
                "inputs": len(inputs),
                "bytes": sum(inputs.values()),
                "files": [
                    {"holds": k.download.holds, "need": k.download.need, "files": k.files, "from": k.download.source}
                    for k in kinds
                ],
                "absent": [h.scene_id for h in handles if isinstance(h.fault, MissingFileError) and not h.inputs],
                **_counts(found),
            }
        )
        family = source.family
        sections["Sources"].append((family, str(source.root), len(inputs), sum(inputs.values()) / 2**20))
        sections["Scenes"].append((family, *_row(found)))
        sections["Missing files"] += [
            (family, k.download.need, k.download.holds, k.download.source, k.download.licence)
            for k in kinds
            if not k.files
        ]
        sections["Navmeshes"] += [(family, origin, count) for origin, count in sorted(found.navmeshes.items())]
        sections["Will yield"].append((family, *_yield_row(found)))
        sections["Will yield nothing"] += [(family, y.scene_id, y.nothing) for y in found.yields if y.nothing][:SHOWN]
        sections["Unmapped labels"] += [
            (family, raw, count, _may_be(raw, family)) for raw, count in found.unmapped.most_common(SHOWN)
        ]
        sections["Unmapped rooms"] += [(family, *item) for item in found.unmapped_rooms.most_common(SHOWN)]
        sections["Warnings"] += [(family, *item) for item in sorted(found.warnings.items())]
        sections["Passed over"] += [(family, *item) for item in found.passed_over[:SHOWN]]
        sections["Will be skipped"] += [(family, *item) for item in found.skipped[:SHOWN]]
        sections["Unreadable"] += [(family, *item) for item in found.unreadable[:SHOWN]]
    # What was asked for and is not there: a source that can't be used, a scene or pattern that nothing fits.
    absent = any("error" in one or one["absent"] for one in document)
    lines = [
        f"{one['family']}: {len(one[what]) - SHOWN} more {what.replace('_', ' ')} are not shown; --json lists them"
        for one in document
        for what in ("passed_over", "skipped", "unreadable")
        if what in one and len(one[what]) > SHOWN
    ]
    shown = [Section(n, _COLUMNS[n], [*rows]) for n, rows in sections.items()]
    return Report({"sources": document}, lines, shown, exit_code=ConfigError.exit_code if absent else 0)


_COLUMNS: Final = {
    "Not a dataset": ("family", "why"),
    "Sources": ("family", "root", "files and entries", "MiB"),
    "Scenes": ("family", "scenes", "read", "rooms", "objects", "with extent", "without extent"),
    "Missing files": ("family", "need", "what", "from", "licence to accept"),
    "Navmeshes": ("family", "navmesh", "scenes"),
    "Will yield": (
        "family",
        "scenes with instructions",
        "without",
        "with claims of absence",
        "(room, label) pairs never called absent",
        "nameless objects",
        "hidden objects",
    ),
    "Will yield nothing": ("family", "scene", "why"),
    "Unmapped labels": ("family", "raw label", "objects", "may be"),
    "Unmapped rooms": ("family", "raw label", "rooms"),
    "Warnings": ("family", "code", "places"),
    "Passed over": ("family", "path", "why"),
    "Will be skipped": ("family", "scene", "why"),
    "Unreadable": ("family", "scene", "cause"),
}


def _yield_row(found: Survey) -> tuple[int, ...]:
    some = [one for one in found.yields if not one.nothing]
    return (
        len(some),
        len(found.yields) - len(some),
        sum(one.absence > 0 for one in some),
        *(sum(getattr(one, name) for one in found.yields) for name in ("blocked", "nameless", "hidden")),
    )


def _may_be(raw: str, family: str) -> str:
    """Return, as one text, the labels that an object of an unmapped type may have. No instruction may say that a thing
    with one of these labels is absent.
    """
    label = vocabulary.canonical(raw, family)
    if vocabulary.is_vague(label, family):
        return "anything of its size"
    return ", ".join(sorted(vocabulary.may_be(label, family))) or "nothing that text names"


def _row(found: Survey) -> tuple[int, ...]:
    return (found.scenes, found.read, found.rooms, found.objects, found.with_extent, found.without_extent)


def _counts(found: Survey) -> dict[str, Any]:
    names = ("scenes", "read", "rooms", "objects", "with_extent", "without_extent")
    return {
        **dict(zip(names, _row(found), strict=True)),
        "navmeshes": dict(sorted(found.navmeshes.items())),
        "unmapped_labels": dict(found.unmapped.most_common()),
        "unmapped_rooms": dict(found.unmapped_rooms.most_common()),
        "warnings": dict(sorted(found.warnings.items())),
        "passed_over": [list(item) for item in found.passed_over],
        "skipped": [list(item) for item in found.skipped],
        "unreadable": [list(item) for item in found.unreadable],
        "yields": [one.document() for one in found.yields],
    }
