"""``condvln benchmark build`` and ``check``: build a version of a benchmark from your own copies of the datasets, or
check that they give the published version.

A build writes ``benchmark.json`` into its export: the snapshot's id,
the versions, and for each scene the hash of its source files and of its rows. `check` makes the rows from other copies
and compares: equal ids, or the scenes that differ and why.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import orjson
from pydantic import ValidationError
from rich.console import Console

from condvln.export.contents import read_index
from condvln.export.splits import SPLITS
from condvln.formats.streams import indented, write_file
from condvln.manifest import manifest_path, read_manifest
from factory.snapshot import Snapshot
from jobs.agents import datasets_of
from jobs.configuration import load_config
from jobs.generate import run_generate
from jobs.pipeline import code_versions
from jobs.report import Report, Section
from jobs.settings import export_folder, read_yaml
from jobs.workspace import published
from schemas.base import first_fault
from schemas.benchmark import (
    BenchmarkCell,
    BenchmarkFile,
    BenchmarkRecord,
    BenchmarkScene,
    BenchmarkSource,
    BenchmarkStops,
)
from schemas.config import Config
from schemas.errors import ConfigError, FormatError, MissingFileError, ProofError, UsageError

__all__ = [
    "RECORD",
    "Benchmark",
    "build_benchmark",
    "cell_table",
    "check_benchmark",
    "other_versions",
    "part_lines",
    "portable",
    "read_record",
    "short_lines",
    "source_table",
    "stop_table",
]

RECORD: Final = "benchmark.json"
"""File name of the record in the export's folder."""

_SHOWN: Final = 20
_REMEDY: Final = "Compare it with configs/benchmark.yaml."
_NOT_HERE: Final = "it is not among these copies"
_NOT_THERE: Final = "it is not in the published benchmark"


@dataclass(frozen=True)
class Benchmark:
    """A benchmark's file and the configuration of its run."""

    file: BenchmarkFile
    config: Config

    @classmethod
    def read(
        cls, path: Path, overrides: Sequence[str] = (), *, scenes: Sequence[str] = (), check_roots: bool = True
    ) -> Benchmark:
        """Read the benchmark file at `path`, and the configuration of the run that this file names.

        scenes : ``FAMILY=FOLDER`` of each dataset that is there; the run's sources of other families are left out. All
            sources are kept if none is given

        Raises
        ------
        ConfigError : one of them is missing or faulty, or the run names no export
        UsageError : a text of `scenes` is not of that form, or the run has no source of its family
        """
        if not path.is_file():
            raise ConfigError("no such benchmark file", where=path, remedy="Take configs/benchmark.yaml.")
        try:
            file = BenchmarkFile.model_validate(read_yaml(path, "configs/benchmark.yaml"))
        except ValidationError as error:
            first = error.errors()[0]
            raise ConfigError(
                f"not a benchmark file: {first['msg'].removeprefix('Value error, ')}",
                where=path,
                place=".".join(map(str, first["loc"])),
                remedy=_REMEDY,
            ) from None
        run = path.parent / file.run
        overrides = [*_own_sources(run, datasets_of(scenes)), *overrides]
        config = load_config(run, overrides, check_roots=check_roots)
        export_folder(config, run)
        return cls(file, config)


def _own_sources(run: Path, roots: Mapping[str, Path]) -> list[str]:
    """Return the overrides that leave a run's configuration the sources of the given families, in the given folders."""
    if not roots:
        return []
    whole = load_config(run, check_roots=False)
    families = {source.family for source in whole.sources}
    strange = sorted(roots.keys() - families)
    if strange:
        raise UsageError(
            f"the benchmark has no scenes of {', '.join(strange)}",
            place="--data",
            remedy=f"It has scenes of {', '.join(sorted(families))}.",
        )
    kept = [
        source.model_dump(mode="json", exclude_defaults=True) | {"root": str(roots[source.family].resolve())}
        for source in whole.sources
        if source.family in roots
    ]
    return [f"sources={orjson.dumps(kept).decode()}"]


def build_benchmark(
    path: Path,
    overrides: Sequence[str] = (),
    *,
    scenes: Sequence[str] = (),
    inline: bool = False,
    console: Console | None = None,
) -> Report:
    """Generate and export the benchmark, and write its record into the export; `scenes` as in `Benchmark.read`.

    The exit code is 3 where a cell is below the floor, or where there are too few instructions. The record is written
    all the same.

    Raises
    ------
    CondVLNError : from the run
    """
    benchmark = Benchmark.read(path, overrides, scenes=scenes)
    report = run_generate(benchmark.config, inline=inline, console=console)
    if report.exit_code not in (0, ProofError.exit_code):
        return report
    record = _record(benchmark)
    export = export_folder(benchmark.config)
    write_file(export / RECORD, indented(record.model_dump(mode="json"), orjson.OPT_SORT_KEYS))
    short = list(short_lines(benchmark.file, record))
    lines = [
        f"{record.benchmark} {record.version}{' (draft: it may still change)' if record.draft else ''}: snapshot "
        f"{record.snapshot_id}, {record.instructions:,} instructions, record in {export / RECORD}",
        *part_lines(benchmark.file, record),
    ]
    lines += short
    tables = [
        source_table(benchmark.file, record),
        cell_table(benchmark.file, record),
        stop_table(benchmark.config, record),
    ]
    document = record.model_dump(mode="json", exclude={"scenes"})
    code = ProofError.exit_code if short else report.exit_code
    return Report(document, [*lines, *report.lines], [*tables, *report.sections], code)


def check_benchmark(
    path: Path,
    record_path: Path,
    overrides: Sequence[str] = (),
    *,
    scenes: Sequence[str] = (),
    inline: bool = False,
    console: Console | None = None,
) -> Report:
    """Process your copies of the datasets that the configuration names, and compare the resulting rows with a published
    record. Where this installation has other versions of the code, its rows can't be the published ones, and no stage
    runs.

    The exit code is 0 where the snapshot has the published id, else 3.

    Raises
    ------
    InputError : the record can't be read
    """
    theirs = read_record(record_path)
    benchmark = Benchmark.read(path, overrides, scenes=scenes)
    if (benchmark.file.benchmark, benchmark.file.version) != (theirs.benchmark, theirs.version):
        raise UsageError(
            f"the record is of {theirs.benchmark} {theirs.version}, but the benchmark file is of "
            f"{benchmark.file.benchmark} {benchmark.file.version}",
            where=str(record_path),
            remedy="Take both from one release.",
        )
    keys = _key_lines(theirs.configuration, portable(benchmark.config))
    here = code_versions(benchmark.config)
    other = other_versions(theirs.stages, here, "published")
    if other:
        lines = [
            "ROWS NOT COMPARED: the code of this release has other versions, so it can't make the published rows: "
            f"{other}",
            *keys,
        ]
        return _check_report(theirs, lines, [], snapshot_id=None, same=None)
    run = run_generate(benchmark.config.model_copy(update={"export": None}), inline=inline, console=console)
    if run.exit_code not in (0, ProofError.exit_code):
        return run
    snapshot = published(benchmark.config)
    differences = list(_differences(theirs, snapshot))
    same = snapshot.snapshot_id == theirs.snapshot_id
    lines = [
        f"the same snapshot as published: {theirs.snapshot_id}"
        if same
        else f"ANOTHER SNAPSHOT: {snapshot.snapshot_id} here, {theirs.snapshot_id} published",
        *keys,
    ]
    return _check_report(theirs, lines, differences, snapshot_id=snapshot.snapshot_id, same=same)


def _check_report(
    theirs: BenchmarkRecord,
    lines: list[str],
    differences: Sequence[tuple[str, str]],
    *,
    snapshot_id: str | None,
    same: bool | None,
) -> Report:
    if differences:
        first = f", of which {_SHOWN} are shown" if len(differences) > _SHOWN else ""
        lines.append(f"scenes that differ: {len(differences):,}{first}")
    report = Report(
        {
            "same": same,
            "snapshot_id": snapshot_id,
            "published": theirs.snapshot_id,
            "notes": lines if same is None else lines[1:],
            "scenes": [{"scene": scene, "difference": what} for scene, what in differences],
        },
        lines,
        [Section("Scenes that differ", ("scene", "difference"), [*differences[:_SHOWN]])],
    )
    report.exit_code = 0 if same else ProofError.exit_code
    return report


def read_record(path: Path) -> BenchmarkRecord:
    """Read the record of a benchmark, from its own file or from the folder of an export.

    Raises
    ------
    MissingFileError, FormatError : there is none, or it is not one
    """
    file = path / RECORD if path.is_dir() else path
    try:
        return BenchmarkRecord.model_validate_json(file.read_bytes())
    except FileNotFoundError:
        raise MissingFileError("there is no such record", where=file, remedy="Run condvln benchmark build.") from None
    except ValidationError as error:
        raise FormatError(
            f"not the record of a benchmark: {first_fault(error)}",
            where=file,
            remedy="Take the record from the benchmark's release.",
        ) from None


def _stops(export: Path) -> list[BenchmarkStops]:
    """Count the stops before the goals of all leaves of an export, gold or not, without leads."""
    found = []
    for split in SPLITS:
        counts: defaultdict[int, Counter[int]] = defaultdict(Counter)
        path = manifest_path(export, split)
        for row in read_manifest(path) if path.is_file() else ():
            counts[len(row.leaves)].update(len(leaf.moves) - 1 for leaf in row.program.leaves)
        found += [BenchmarkStops(split=split, leaves=n, stops=(c[0], c[1], c[2])) for n, c in sorted(counts.items())]
    return found


def _record(benchmark: Benchmark) -> BenchmarkRecord:
    snapshot, file = published(benchmark.config), benchmark.file
    export = export_folder(benchmark.config)
    index = read_index(export) or {}
    if index.get("snapshot") != snapshot.snapshot_id:
        raise UsageError(
            "the export was not made from the published snapshot",
            where=str(export),
            remedy="Run condvln benchmark build again.",
        )
    # Every cell that is asked for is counted, so that a source without any episode in a split is not passed over.
    families = sorted({source.family for source in benchmark.config.sources})
    categories = dict.fromkeys(cell.category for cell in benchmark.config.instructions.wanted)
    counts = Counter(dict.fromkeys(product(file.splits, families, categories), 0))
    for cell in index["cells"]:
        counts[cell["split"], cell["source"], cell["category"]] += cell["selected"]
    scenes = dict(_scenes(snapshot))
    instructions = snapshot.manifest.tables["instructions"]
    processed = Counter(name.partition("/")[0] for name, scene in scenes.items() if scene.status == "ok")
    exported: Counter[str] = Counter()
    for (_, family, _), selected in counts.items():
        exported[family] += selected
    return BenchmarkRecord(
        benchmark=file.benchmark,
        version=file.version,
        draft=file.draft,
        snapshot_id=snapshot.snapshot_id,
        export_digest=index["digest"],
        stages=code_versions(benchmark.config),
        configuration=portable(benchmark.config),
        instructions=instructions.rows,
        episodes=index["episodes"],
        sources={
            family: BenchmarkSource(
                scenes=processed[family],
                instructions=instructions.partitions[family].rows if family in instructions.partitions else 0,
                episodes=exported[family],
            )
            for family in families
        },
        stops=_stops(export),
        cells=[
            BenchmarkCell(
                split=s, source=f, category=c, episodes=n, shortfall=max(0, file.floor - n) if s in file.splits else 0
            )
            for (s, f, c), n in counts.items()
        ],
        scenes=scenes,
    )


def _scenes(snapshot: Snapshot) -> Iterator[tuple[str, BenchmarkScene]]:
    """Yield (name, scene) of each scene, from the index of units."""
    table = snapshot.index.table
    stages = list(snapshot.manifest.stages)
    hashes = [
        f"{stage}/{name}.hash"
        for name, listed in snapshot.manifest.tables.items()
        for stage in listed.stages
        if f"{stage}/{name}.hash" in table.column_names
    ]
    first = f"{stages[0]}.inputs"
    for row in table.select(["unit_id", "status", "reason", first, *hashes]).to_pylist():
        found = {name.removesuffix(".hash"): row[name].hex() for name in sorted(hashes) if row[name] is not None}
        inputs = None if row[first] is None else row[first].hex()
        yield (
            row["unit_id"],
            BenchmarkScene(status=row["status"], reason=row["reason"] or "", inputs=inputs, tables=found),
        )


def _differences(theirs: BenchmarkRecord, snapshot: Snapshot) -> Iterator[tuple[str, str]]:
    ours = dict(_scenes(snapshot))
    for scene in sorted(theirs.scenes.keys() | ours.keys()):
        here, there = ours.get(scene), theirs.scenes.get(scene)
        if here is None:
            yield scene, _NOT_HERE
        elif there is None:
            yield scene, _NOT_THERE
        elif here.status != there.status:
            why = f" ({here.reason})" if here.reason else ""
            yield scene, f"it is {here.status} here{why} and was {there.status}"
        else:
            names = here.tables.keys() | there.tables.keys()
            tables = sorted(name for name in names if here.tables.get(name) != there.tables.get(name))
            files = "" if here.inputs == there.inputs else "its files differ"
            rows = f"other rows in {', '.join(tables)}" if tables else ""
            if rows:
                yield scene, "; ".join(filter(None, (files or "its files are the same", rows)))


def _key_lines(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> list[str]:
    other = sorted(key for key in theirs.keys() | ours.keys() if theirs.get(key) != ours.get(key))
    return [f"the configuration differs in: {', '.join(other)}"] if other else []


def source_table(file: BenchmarkFile, record: BenchmarkRecord) -> Section:
    """Return the table of the scenes, instructions and episodes of each family, beside the number of scenes that the
    run takes of whole copies.
    """
    rows = [(name, s.scenes, file.scenes.get(name), s.instructions, s.episodes) for name, s in record.sources.items()]
    return Section("Sources", ("source", "scenes", "taken of whole copies", "instructions", "episodes"), [*rows])


def short_lines(file: BenchmarkFile, record: BenchmarkRecord) -> Iterator[str]:
    """Yield report lines about what the benchmark lacks: the number of instructions if there are too few, and the cells
    of each split that are below the floor.
    """
    if record.instructions < file.instructions:
        yield f"SHORT: {record.instructions:,} instructions of {file.instructions:,}"
    for split in file.splits:
        cells = [cell for cell in record.cells if cell.split == split]
        short = [cell for cell in cells if cell.shortfall]
        empty = sorted({c.source for c in cells} - {c.source for c in cells if c.episodes})
        if not short:
            continue
        named = ", ".join(f"{c.source} {c.category} {c.episodes}" for c in short if c.source not in empty)
        none = f"; nothing from {', '.join(empty)}" if empty else ""
        yield (
            f"SHORT: split {split}: {len(short)} of {len(cells)} cells have fewer than {file.floor} episodes"
            f"{': ' if named else ''}{named}{none}"
        )


def part_lines(file: BenchmarkFile, record: BenchmarkRecord) -> list[str]:
    """Return a report line about the families of which scenes are missing, and one about scenes that are there and
    were quarantined or skipped; no line where there are none.
    """
    here = Counter(scene.partition("/")[0] for scene in record.scenes)
    parts = [f"{name} {here[name]} of {whole} scenes" for name, whole in file.scenes.items() if here[name] < whole]
    refused = Counter(
        (scene.partition("/")[0], found.status) for scene, found in record.scenes.items() if found.status != "ok"
    )
    lines = []
    if parts:
        lines.append(
            "a build of a part of the scenes, so its snapshot id differs from that of a whole build: "
            f"{', '.join(parts)}"
        )
    if refused:
        told = [f"{family} {number} {status}" for (family, status), number in sorted(refused.items())]
        lines.append(f"scenes without rows: {', '.join(told)}")
    return lines


def cell_table(file: BenchmarkFile, record: BenchmarkRecord) -> Section:
    """Return the table of the number of episodes by split and source; a number below the floor is given "of" it."""
    found = {(cell.split, cell.source, cell.category): cell for cell in record.cells}
    categories = [*dict.fromkeys(cell.category for cell in record.cells)]
    rows = []
    for split, source in dict.fromkeys((cell.split, cell.source) for cell in record.cells):
        cells = [found.get((split, source, category)) for category in categories]
        told = [None if c is None else f"{c.episodes} of {file.floor}" if c.shortfall else c.episodes for c in cells]
        rows.append((split, source, *told))
    return Section("Episodes", ("split", "source", *categories), [*rows])


def stop_table(config: Config, record: BenchmarkRecord) -> Section:
    """Return the table of the shares of leaves with no, one and two stops before their goal, beside those asked."""
    sampling, rows = config.sampling, []
    for one in record.stops:
        asked = sampling.moves if one.leaves < 4 else (*sampling.moves_four_leaves, 0.0)
        shares = [f"{100 * count / sum(one.stops):.1f}" for count in one.stops]
        told = " / ".join(f"{100 * share:g}" for share in asked)
        rows.append((one.split, one.leaves, sum(one.stops), " / ".join(shares), told))
    columns = ("split", "leaves of a program", "leaves in all", "none / one / two, %", "asked")
    return Section("Stops before the goal", columns, [*rows])


_OF_THIS_MACHINE: Final = {"store", "export", "ray", "keep", "limits"}
_PATHS: Final = {"root", "regions", "houses", "connectivity"}


def portable(config: Config) -> dict[str, Any]:
    """Return the part of the configuration that affects rows, without paths of this machine."""
    document = config.model_dump(mode="json", exclude=_OF_THIS_MACHINE)
    document["sources"] = [
        {key: value for key, value in source.items() if key not in _PATHS} for source in document["sources"]
    ]
    return document


def other_versions(theirs: Mapping[str, int], here: Mapping[str, int], where: str) -> str:
    """Return the versions `here` that differ from `theirs`, as text; `where` says whose the latter are."""
    names = [*here, *(name for name in theirs if name not in here)]
    return ", ".join(
        f"{name} {here.get(name, 'none')} ({where}: {theirs.get(name, 'none')})"
        for name in names
        if here.get(name) != theirs.get(name)
    )
