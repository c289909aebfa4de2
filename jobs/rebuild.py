"""``condvln rebuild``, the form of ``condvln generate`` for schedulers: plan, process what changed, publish, export,
and sweep the store.

Every step may be killed and is taken up by the next rebuild. On one machine a second rebuild of the same name leaves
the work to the first; on several, all may work, one publishes, and the others say so.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from rich.console import Console

from factory.plan import Plan
from factory.report import ABORTED
from factory.store import Store
from factory.sweep import sweep
from factory.unit import Unit
from jobs.report import Report
from jobs.store_lock import alone
from jobs.watch import Watch
from jobs.workspace import local_state, open_store
from schemas.config import Config
from schemas.errors import CorruptShardError

__all__ = ["run_rebuild"]

NOTHING: Final = "nothing to do"


def run_rebuild(
    config: Config,
    *,
    if_changed: bool = False,
    renew_priors: bool = False,
    retry_quarantined: bool = False,
    verify: bool = False,
    inline: bool = False,
    console: Console | None = None,
) -> Report:
    """Bring the published snapshot and the export of `config` up to date.

    if_changed : look at names, sizes and times first, and end there when nothing changed since the last rebuild
    renew_priors : build the label priors again
    retry_quarantined : try scenes again whose key is in quarantine
    verify : read every file again that what is published rests on, and make those again that differ from their hash
    """
    state = local_state(config.store)
    with alone(state, config.name) as held:
        if not held:
            return _nothing(f"another generate or rebuild of {config.name!r} is under way: this one does nothing")
        store = open_store(config)
        watch = Watch(config, store, state)
        asked = renew_priors or retry_quarantined or verify
        if if_changed and not asked and watch.unchanged:
            assert watch.memory is not None
            return _nothing(f"{NOTHING}: no file changed since {watch.memory.looked_at}", watch.memory.quarantined)
        return _rebuild(
            _Rebuild(config, store, watch, renew_priors, retry_quarantined, verify, inline, console), asked=asked
        )


@dataclass(frozen=True)
class _Rebuild:
    """One rebuild, with its options, its store and its record of the inputs."""

    config: Config
    store: Store
    watch: Watch
    renew_priors: bool
    retry_quarantined: bool
    verify: bool
    inline: bool
    console: Console | None


def _rebuild(job: _Rebuild, *, asked: bool) -> Report:
    # The science is loaded only now: looking whether anything changed does not need it.
    from factory.run import plan
    from jobs.export_lock import alone_in_export
    from jobs.listing import listed_units
    from jobs.pipeline import build_pipeline

    config, watch = job.config, job.watch
    units = listed_units(config)
    renew = ("priors",) if job.renew_priors else ()
    found = plan(
        build_pipeline(config),
        units,
        job.store,
        config.name,
        retry_quarantined=job.retry_quarantined,
        renew=renew,
    )
    if not asked and found.unchanged and (config.export is None or watch.export_stands(found.snapshot_id)):
        quarantined = found.counts["QUARANTINED"]
        watch.remember(found.snapshot_id, quarantined)
        counts = {"total": len(units), "fresh": len(units), "made": 0, "quarantined": quarantined}
        said = f"{NOTHING}: {len(units)} scenes are as published"
        return _nothing(said, quarantined, {"snapshot_id": found.snapshot_id, "counts": counts})
    with alone_in_export(config):
        return _work(job, units, found)


def _work(job: _Rebuild, units: Collection[Unit], found: Plan) -> Report:
    """Process the units that are out of date by the plan `found`, publish, export, and sweep the store; return the
    rebuild's report.
    """
    from jobs.generate import add_export, bring_up_to_date, run_report

    config, watch = job.config, job.watch
    console = job.console or Console(stderr=True)
    done = bring_up_to_date(
        config,
        units,
        inline=job.inline,
        retry_quarantined=job.retry_quarantined,
        renew_priors=job.renew_priors,
        verify=job.verify,
        console=console,
    )
    report = run_report(done)
    report.document["plan"] = {"counts": dict(found.counts), "reasons": dict(found.reasons)}
    report.lines.insert(0, _why(dict(found.counts), dict(found.reasons), len(found.removed)))
    if done.exit_code == ABORTED or done.message:
        return report  # stopped, or another run was faster: nothing of ours is published
    exported = False
    if config.export is not None and done.snapshot_id is not None and not watch.export_stands(done.snapshot_id):
        try:
            kept = not add_export(report, config, renewed=job.renew_priors)
        except CorruptShardError as error:
            # Bytes that changed while a file kept its size are met only where the file is read.
            console.print(f"{error} The damaged files are rebuilt now.", highlight=False, markup=False)
            bring_up_to_date(config, units, inline=job.inline, verify=True, console=console)
            kept = not add_export(report, config, renewed=job.renew_priors)
        if kept:
            return report  # nothing is remembered, so that the next rebuild refuses again
        exported = "export" in report.document
    if done.published and config.keep.sweep:
        _sweep(config, job.store, report)
    watch.remember(done.snapshot_id, done.counts["quarantined"])
    if not exported and not done.record and found.unchanged:
        document = {"snapshot_id": done.snapshot_id, "counts": dict(done.counts)}
        return _nothing(
            f"{NOTHING}: {done.counts['total']} scenes are as published", done.counts["quarantined"], document
        )
    return report


def _why(counts: dict[str, int], reasons: dict[str, int], removed: int) -> str:
    parts = [f"{count} {status.lower()}" for status, count in sorted(counts.items())]
    if removed:
        parts.append(f"{removed} removed")
    because = ", ".join(f"{reason} of {count}" for reason, count in sorted(reasons.items()))
    return f"planned: {', '.join(parts) or 'no scenes'}" + (f"; changed: {because}" if because else "")


def _sweep(config: Config, store: Store, report: Report) -> None:
    swept = sweep(store, keep=config.keep.snapshots, grace=config.keep.grace_hours * 3600)
    files, size = swept.files.total(), swept.bytes.total()
    report.document["swept"] = {"files": files, "bytes": size, "snapshots": list(swept.removed)}
    if files:
        report.lines.append(f"swept {files} files, {size / 2**20:.1f} MiB, {len(swept.removed)} snapshots")
    if swept.unreadable:
        report.document["swept"]["unreadable"] = list(swept.unreadable)
        report.lines.append(f"no unit was swept, since what needs them can't be read: {', '.join(swept.unreadable)}")


def _nothing(said: str, quarantined: int = 0, more: Mapping[str, Any] | None = None) -> Report:
    document: dict[str, Any] = {"changed": False, "message": said, "quarantined": quarantined, **(more or {})}
    lines = [said]
    if quarantined:
        lines.append(f"{quarantined} scenes are in quarantine: condvln status says why")
    return Report(document, lines)
