"""``condvln rebuild``: the scheduled form. Plan, run what changed, publish, export, sweep; nothing to do ends at once.

Every step may be killed and is taken up by the next rebuild. On one machine a second rebuild of the same name leaves
the work to the first; on several, all may work, one publishes, and the others say so.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from factory.report import ABORTED, RunReport
from factory.store import Store
from factory.sweep import sweep
from jobs.report import Report
from jobs.watch import Watch
from jobs.workspace import local_state, open_store
from schemas.config import Config

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
    """Bring what is published and exported under `config` up to date.

    if_changed : look at names, sizes and times first, and end there when nothing changed since the last rebuild
    renew_priors : build the label priors anew
    retry_quarantined : try scenes again whose key is in quarantine
    verify : read every published file again, and make those anew that differ from their hash
    """
    state = local_state(config.store)
    with _alone(state, config.name) as alone:
        if not alone:
            return _nothing(f"another rebuild of {config.name!r} is under way here; it is left to it")
        store = open_store(config)
        watch = Watch(config, store, state)
        asked = renew_priors or retry_quarantined or verify
        if if_changed and not asked and watch.unchanged:
            assert watch.memory is not None
            return _nothing(f"{NOTHING}: no file changed since {watch.memory.looked_at}", watch.memory.quarantined)
        from jobs.export_lock import alone_in_export  # what looks for changes loads little

        with alone_in_export(config):
            return _rebuild(config, store, watch, renew_priors, retry_quarantined, verify, inline, console)


def _rebuild(
    config: Config,
    store: Store,
    watch: Watch,
    renew_priors: bool,
    retry_quarantined: bool,
    verify: bool,
    inline: bool,
    console: Console | None,
) -> Report:
    # The science is loaded only now: looking whether anything changed does not need it.
    from factory.run import plan
    from jobs.generate import add_export, bring_up_to_date, run_report
    from jobs.listing import listed_units
    from jobs.pipeline import build_pipeline

    units = listed_units(config)
    renew = ("priors",) if renew_priors else ()
    found = plan(build_pipeline(config), units, store, config.name, retry_quarantined=retry_quarantined, renew=renew)
    done = bring_up_to_date(
        config,
        units,
        inline=inline,
        retry_quarantined=retry_quarantined,
        renew_priors=renew_priors,
        verify=verify,
        warm=not found.empty,
        console=console or Console(stderr=True),
    )
    report = run_report(done)
    report.document["plan"] = {"counts": dict(found.counts), "reasons": dict(found.reasons)}
    report.lines.insert(0, _why(dict(found.counts), dict(found.reasons), len(found.removed)))
    if done.exit_code == ABORTED or done.message:
        return report  # stopped, or another run was faster: nothing of ours is published
    exported = False
    if config.export is not None and done.snapshot_id is not None and not watch.export_stands(done.snapshot_id):
        if not add_export(report, config, renewed=renew_priors):
            return report  # nothing is remembered, so that the next rebuild refuses again
        exported = "export" in report.document
    if done.published and config.keep.sweep:
        _sweep(config, store, report)
    watch.remember(done.snapshot_id, done.counts["quarantined"])
    if not exported and not done.record:
        return _nothing(f"{NOTHING}: {done.counts['total']} scenes are as published", done.counts["quarantined"], done)
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


def _nothing(said: str, quarantined: int = 0, done: RunReport | None = None) -> Report:
    document: dict[str, Any] = {"changed": False, "message": said, "quarantined": quarantined}
    if done is not None:
        document |= {"snapshot_id": done.snapshot_id, "counts": dict(done.counts)}
    lines = [said]
    if quarantined:
        lines.append(f"{quarantined} scenes are in quarantine: condvln status says why")
    return Report(document, lines)


@contextmanager
def _alone(state: Path, name: str) -> Iterator[bool]:
    """Whether no other rebuild of this name is under way on this machine. A killed one blocks nobody."""
    state.mkdir(parents=True, exist_ok=True)
    lock = os.open(state / f".rebuild-{name}.lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(lock)
