"""``condvln generate --if-changed``, the form for schedulers: plan, process what changed, publish, export,
and sweep the store.

Every step may be killed and is taken up by the next rebuild. On one machine a second rebuild of the same name leaves
the work to the first; on several, all may work, one publishes, and the others say so.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

from rich.console import Console

from factory.planner import Plan
from factory.report import ABORTED, DONE, WITH_QUARANTINE
from factory.stage import Unit
from factory.store import Store
from factory.sweep import sweep
from jobs.report import Report
from jobs.watch import Watch
from jobs.workspace import alone, local_state, open_store
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

    if_changed : look at names, sizes and times first, and end there when none changed since the last rebuild. A file
        with other bytes but the same size and time isn't noticed
    renew_priors : build the label priors again
    retry_quarantined : try scenes again whose key is in quarantine
    verify : hash every source file again, read every file again that what is published rests on, and make again what
        differs
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
            said = f"{NOTHING}: no name, size or time of a file changed since {watch.memory.looked_at}"
            return _nothing(said, watch.memory.quarantined, watch.memory.refused)
        how = {"verify": verify, "renew_priors": renew_priors, "retry_quarantined": retry_quarantined, "inline": inline}
        return _rebuild(config, store, watch, how, console or Console(stderr=True), asked=asked)


def _rebuild(
    config: Config, store: Store, watch: Watch, how: Mapping[str, bool], console: Console, *, asked: bool
) -> Report:
    # The science is loaded only now: looking whether anything changed does not need it.
    from factory.run import plan
    from jobs.export import alone_in_export
    from jobs.pipeline import build_pipeline, listed_units

    units = listed_units(config, verify=how["verify"])
    renew, retry = ("priors",) if how["renew_priors"] else (), how["retry_quarantined"]
    found = plan(build_pipeline(config), units, store, config.name, retry_quarantined=retry, renew=renew)
    if not asked and found.unchanged and (config.export is None or watch.export_stands(found.snapshot_id)):
        quarantined = found.counts["QUARANTINED"]
        refused = watch.remember(found.snapshot_id, quarantined)
        counts = {"total": len(units), "fresh": len(units), "made": 0, "quarantined": quarantined}
        said = f"{NOTHING}: {len(units)} scenes are as published"
        return _nothing(said, quarantined, refused, {"snapshot_id": found.snapshot_id, "counts": counts})
    with alone_in_export(config):
        return _work(config, watch, how, console, units, found)


def _work(
    config: Config, watch: Watch, how: Mapping[str, bool], console: Console, units: Collection[Unit], found: Plan
) -> Report:
    """Process the units that are out of date by the plan `found`, publish, export, and sweep the store; return the
    rebuild's report.
    """
    from jobs.generate import add_export, bring_up_to_date, run_report

    done = bring_up_to_date(config, units, console=console, **how)
    report = run_report(done)
    report.document["plan"] = {"counts": dict(found.counts), "reasons": dict(found.reasons)}
    report.lines.insert(0, _why(dict(found.counts), dict(found.reasons), len(found.removed)))
    if done.exit_code == ABORTED or done.message:
        return report  # stopped, or another run was faster: nothing of ours is published
    exported = False
    if (
        config.export is not None
        and done.snapshot_id is not None
        and not watch.export_stands(done.snapshot_id, verify=how["verify"])
    ):
        try:
            kept = not add_export(report, config, renewed=how["renew_priors"])
        except CorruptShardError as error:
            # Bytes that changed while a file kept its size are met only where the file is read.
            console.print(f"{error} The damaged files are rebuilt now.", highlight=False, markup=False)
            bring_up_to_date(config, units, inline=how["inline"], verify=True, console=console)
            kept = not add_export(report, config, renewed=how["renew_priors"])
        if kept:
            return report  # nothing is remembered, so that the next rebuild refuses again
        exported = "export" in report.document
    if done.published and config.keep.sweep:
        _sweep(config, report)
    refused = watch.remember(
        done.snapshot_id, done.counts["quarantined"], _refusal(config, report) if exported else None
    )
    if not exported and refused:
        report.exit_code = max(report.exit_code, WITH_QUARANTINE)
        report.lines.append(refused)
    if not exported and not done.record and found.unchanged:
        document = {"snapshot_id": done.snapshot_id, "counts": dict(done.counts)}
        said = f"{NOTHING}: {done.counts['total']} scenes are as published"
        return _nothing(said, done.counts["quarantined"], refused, document)
    return report


def _refusal(config: Config, report: Report) -> str:
    """Return why the export that `report` is about ends with exit code 3; empty where it does not."""
    bias = report.document["export"].get("bias")
    if config.splits.bias == "fail" and bias is not None and not bias["passed"]:
        return "the bias gate refuses the export as it is"
    return "" if sum(report.document["export"]["episodes"].values()) else "the export has no episodes"


def _why(counts: dict[str, int], reasons: dict[str, int], removed: int) -> str:
    parts = [f"{count} {status.lower()}" for status, count in sorted(counts.items())]
    if removed:
        parts.append(f"{removed} removed")
    because = ", ".join(f"{reason} of {count}" for reason, count in sorted(reasons.items()))
    return f"planned: {', '.join(parts) or 'no scenes'}" + (f"; changed: {because}" if because else "")


def _sweep(config: Config, report: Report) -> None:
    swept = sweep(open_store(config), keep=config.keep.snapshots, grace=config.keep.grace_hours * 3600)
    files, size = swept.files.total(), swept.bytes.total()
    report.document["swept"] = {"files": files, "bytes": size, "snapshots": list(swept.removed)}
    if files:
        report.lines.append(f"swept {files} files, {size / 2**20:.1f} MiB, {len(swept.removed)} snapshots")
    if swept.unreadable:
        report.document["swept"]["unreadable"] = list(swept.unreadable)
        report.lines.append(f"no unit was swept, since what needs them can't be read: {', '.join(swept.unreadable)}")


def _nothing(said: str, quarantined: int = 0, refused: str = "", more: Mapping[str, Any] | None = None) -> Report:
    """Report that there was nothing to do. What earlier runs left in quarantine, and why an export was refused,
    is said again, with exit code 3, for as long as it is so.

    refused : why the export is not to be used
    """
    document: dict[str, Any] = {"changed": False, "message": said, "quarantined": quarantined, **(more or {})}
    if quarantined:
        said += f"; {quarantined} still in quarantine (condvln status says why)"
    if refused:
        said += f"; {refused}"
    return Report(document, [said], exit_code=WITH_QUARANTINE if quarantined or refused else DONE)
