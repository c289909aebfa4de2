"""``condvln generate``: process what changed, publish a snapshot, write the export."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Any, Final

import pyarrow.compute as pc
from rich.console import Console

from condvln.instructions.predicates import GROUP_OF, PREDICATES, sayable
from factory.report import ABORTED, RunReport
from factory.run import run
from factory.stage import Unit
from factory.store import Store
from jobs.executor import every_node_sees, open_executor
from jobs.export import alone_in_export, write_export
from jobs.funnel import add_funnel, listed
from jobs.pipeline import build_pipeline, listed_units
from jobs.progress import LoggedRun, RunProgress
from jobs.report import Report, Section, by_cause
from jobs.workspace import alone_in_store, git_revision, local_state, open_store, published
from schemas.config import Config
from schemas.errors import CorruptShardError, SmallerExportError
from schemas.program import asked_in

__all__ = ["add_export", "bring_up_to_date", "run_generate", "run_report"]

SHOWN_FAILURES: Final = 20
"""Number of quarantined scenes listed on a terminal; ``condvln status`` has all of them."""


def run_generate(
    config: Config,
    *,
    inline: bool = False,
    retry_quarantined: bool = False,
    renew_priors: bool = False,
    console: Console | None = None,
) -> Report:
    """Bring the published snapshot up to date with the sources, and the export with the snapshot."""
    console = console or Console(stderr=True)
    # Who comes second learns it now, and not after all its work.
    with alone_in_store(config), alone_in_export(config):
        units = listed_units(config)
        done = bring_up_to_date(
            config,
            units,
            inline=inline,
            retry_quarantined=retry_quarantined,
            renew_priors=renew_priors,
            console=console,
        )
        try:
            return _whole_report(config, done, renew_priors)
        except CorruptShardError as error:
            # Bytes that changed while a file kept its size are met only where the file is read.
            console.print(f"{error} The damaged files are rebuilt now.", highlight=False, markup=False)
        done = bring_up_to_date(config, units, inline=inline, verify=True, console=console)
        return _whole_report(config, done, renew_priors)


def _whole_report(config: Config, done: RunReport, renewed: bool) -> Report:
    """Report what a run did, the funnel of the published snapshot, and its export."""
    report = run_report(done)
    if done.snapshot_id is not None:
        add_funnel(report, published(config), short=True)
    if config.export is not None and done.exit_code != ABORTED and done.snapshot_id is not None:
        add_export(report, config, renewed=renewed)
    if done.snapshot_id is not None:
        _add_notes(report, config)
    return report


def _add_notes(report: Report, config: Config) -> None:
    """Add what a reader should know at the end: that nothing was made, and predicates that no condition asks."""
    snapshot = published(config)
    if not snapshot.manifest.tables["instructions"].rows:
        reasons = Counter(str(scene["why"]).split(":")[0] for scene in report.document["funnel"]["scenes"])
        report.notes.append(
            f"WARNING: nothing was made: none of {reasons.total():,} scenes has an instruction ({listed(reasons)}); "
            "the table 'Scenes without episodes' says why, and what to do"
        )
        return
    conditions = pc.list_flatten(snapshot.table("instructions", ["conditions"])["conditions"])
    said = {*pc.struct_field(conditions, ["qualifier", "predicate"]).unique().to_pylist()}
    families = {asked for source in config.sources for asked in asked_in(source.family)}
    weights, usable = config.sampling.predicates, families & sayable(config.instructions.directions) - said
    unasked = [name for name in PREDICATES if name in usable and getattr(weights, GROUP_OF[name])]
    report.document["unasked_predicates"] = unasked
    if unasked:
        report.notes.append(
            f"asked predicates without a condition: {', '.join(unasked)} (their truth hardly varies in these scenes, "
            "or their group has little weight)"
        )


def bring_up_to_date(
    config: Config,
    units: Collection[Unit],
    *,
    inline: bool = False,
    retry_quarantined: bool = False,
    renew_priors: bool = False,
    verify: bool = False,
    console: Console,
) -> RunReport:
    """Process what changed in the sources, publish the snapshot, and keep the run's record and log in the store.

    verify : read every file again that what is published rests on, and make those again that differ from their hash
    """

    store = open_store(config)
    with (
        RunProgress(console) as bar,
        LoggedRun(store, local_state(config.store), bar) as log,
        open_executor(
            config.ray,
            inline=inline,
            say=bar.note,
            folders=every_node_sees(config),
        ) as executor,
    ):
        done = run(
            build_pipeline(config),
            units,
            store,
            config.name,
            executor,
            budget=config.ray.max_failures,
            progress=log,
            retry_quarantined=retry_quarantined,
            renew=("priors",) if renew_priors else (),
            deadline=config.ray.deadline_seconds,
            memory=None if config.ray.memory_gib is None else int(config.ray.memory_gib * 2**30),
            verify=verify,
            revision=git_revision(),
        )
        log.keep(done)
    if done.snapshot_id is not None:
        _keep_views(store, done.snapshot_id)
    return done


def _keep_views(store: Store, snapshot_id: str) -> None:
    """Write ``views.sql`` beside the tables of a snapshot, unless it is there as it should be."""
    from jobs.query import views_sql  # loads DuckDB

    folder = f"snapshots/{snapshot_id}/"
    remote = f"{store.url}/{folder}" if "://" in store.url else ""
    path, text = f"{folder}views.sql", views_sql(remote).encode()
    try:
        if store.read(path) == text:
            return
    except FileNotFoundError:
        pass
    store.write(path, text)


def add_export(report: Report, config: Config, *, renewed: bool = False) -> bool:
    """Export the published snapshot, and add the result to `report`. Returns False if the export in place was kept
    instead.

    The folder is held by the caller (``jobs.export.alone_in_export``). renewed : the priors were renewed on purpose
    """
    try:
        exported = write_export(config, renewed=renewed)
    except SmallerExportError as error:
        report.lines.append(f"REFUSED: {error}")
        report.document["export_refused"] = str(error)
        report.exit_code = max(report.exit_code, error.exit_code)
        return False
    if "episodes" in exported.document:
        report.document["export"] = exported.document
    elif "viewpoints" in exported.document:
        report.document["viewpoints"] = exported.document["viewpoints"]
    report.lines += exported.lines
    report.sections += exported.sections
    report.exit_code = max(report.exit_code, exported.exit_code)
    return True


def run_report(done: RunReport) -> Report:
    """Report what a run did, for people and scripts."""
    counts = {name: done.counts[name] for name in ("total", "fresh", "reused", "made", "ok", "skipped", "quarantined")}
    document: dict[str, Any] = {
        "snapshot_id": done.snapshot_id,
        "published": done.published,
        "counts": counts,
        "stages": dict(done.stages),
        "stage_seconds": {name: round(seconds, 3) for name, seconds in done.stage_seconds.items()},
        "peak_rss": done.peak_rss,
        "seconds": round(done.seconds, 3),
        "quarantined": [{"unit": unit, "stage": f.stage, "message": f.message} for unit, f in done.failures],
        "message": done.message,
    }
    lines = [done.message] if done.message else []
    lines.append(
        f"{counts['total']} scenes: {counts['ok']} done, {counts['skipped']} skipped, "
        f"{counts['quarantined']} quarantined ({counts['fresh']} were fresh, {counts['reused']} found committed) "
        f"in {done.seconds:.1f} s"
    )
    if done.snapshot_id is not None:
        lines.append(f"snapshot {done.snapshot_id}{'' if done.published else ' (already published)'}")
    failures = by_cause((unit, f.stage, f.message) for unit, f in done.failures)[:SHOWN_FAILURES]
    sections = [Section("Quarantined", ("scene", "stage", "cause"), [*failures])]
    return Report(document, lines, sections, done.exit_code)
