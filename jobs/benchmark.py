"""``condvln benchmark build`` and ``check``: build a version of a benchmark from your own copies of the datasets, or
check that they give the published version.

What a version is made of is frozen in one file. A build writes ``benchmark.json`` into its export: the snapshot's id,
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
from condvln.formats.streams import atomic_stream
from condvln.manifest.manifest import manifest_path, read_manifest
from factory.index import Index
from factory.key import Keyer
from factory.snapshot import Snapshot
from jobs.benchmark_tables import cell_table, part_lines, short_lines, source_table, stop_table
from jobs.configuration import load_config
from jobs.frozen_benchmark import other_parts, other_versions, portable
from jobs.generate import run_generate
from jobs.looker import datasets_of
from jobs.pipeline import build_pipeline, code_versions, list_units
from jobs.report import Report, Section
from jobs.workspace import file_hashes, hasher, published
from jobs.yaml_file import read_yaml
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
from schemas.first_fault import first_fault

__all__ = ["RECORD", "Benchmark", "build_benchmark", "check_benchmark", "read_record"]

RECORD: Final = "benchmark.json"
"""File name of the record in the export's folder."""

_SHOWN: Final = 20
_REMEDY: Final = "Compare it with configs/benchmark-v1.yaml."
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
            raise ConfigError("no such benchmark file", where=path, remedy="Take configs/benchmark-v1.yaml.")
        try:
            file = BenchmarkFile.model_validate(read_yaml(path, "configs/benchmark-v1.yaml"))
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
        if config.export is None:
            raise ConfigError(
                "a benchmark needs an export folder",
                where=run,
                place="export",
                remedy="Set export: FOLDER.",
            )
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
            place="--scenes",
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
    UsageError : the benchmark file is of a final version, and the code of this installation has other versions, or the
        configuration was changed
    CondVLNError : from the run
    """
    benchmark = Benchmark.read(path, overrides, scenes=scenes)
    if not benchmark.file.draft:
        _refuse_other_code(path, benchmark)
    report = run_generate(benchmark.config, inline=inline, console=console)
    if report.exit_code not in (0, ProofError.exit_code):
        return report
    record = _record(benchmark)
    export = benchmark.config.export
    assert export is not None
    with atomic_stream(export / RECORD) as stream:
        stream.write(_encoded(record))
    short = list(short_lines(benchmark.file, record))
    other = other_versions(benchmark.file.stages, record.stages, "in the draft's file")
    lines = [
        f"{record.benchmark} {record.version}{' (draft: it may still change)' if record.draft else ''}: snapshot "
        f"{record.snapshot_id}, {record.instructions:,} instructions, record in {export / RECORD}",
        *([f"other versions of the code: {other}"] if other else []),
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
    record. Where this installation has other versions of the code, its rows can't be the published ones: only the
    scenes' files are compared then, and no stage runs.

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
    # Records of former drafts name the stages only.
    other = other_versions(theirs.stages, {name: here[name] for name in here if name in theirs.stages}, "published")
    if other:
        return _files_report(benchmark, theirs, other, keys)
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


def _files_report(benchmark: Benchmark, theirs: BenchmarkRecord, other: str, keys: Sequence[str]) -> Report:
    """Report which scenes have other files than published; for an installation that can't make the published rows."""
    keyer = Keyer(build_pipeline(benchmark.config))
    here = {
        unit.unit_id: None if unit.fault else keyer.key(unit, 0, {}, None).inputs.hex()
        for unit in list_units(benchmark.config, hasher(file_hashes(benchmark.config)))
    }
    differences = []
    for scene in sorted(theirs.scenes.keys() | here.keys()):
        if scene not in here:
            differences.append((scene, _NOT_HERE))
        elif scene not in theirs.scenes:
            differences.append((scene, _NOT_THERE))
        elif here[scene] != theirs.scenes[scene].inputs:
            differences.append((scene, "its files differ" if here[scene] else "it can't be read here"))
    count = len(theirs.scenes.keys() | here.keys()) - len(differences)
    lines = [
        f"ROWS NOT COMPARED: the code of this release has other versions, so it can't make the published rows: {other}",
        f"the files of {count:,} of {len(theirs.scenes):,} published scenes are here and the same",
        *keys,
    ]
    if not benchmark.file.draft:
        lines.append(f"{_code_of(benchmark.file)}, to compare the rows")
    return _check_report(theirs, lines, differences, snapshot_id=None, same=None)


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
    """Count the stops before the goals of all leaves of an export, gold or not."""
    found = []
    for split in SPLITS:
        counts: defaultdict[int, Counter[int]] = defaultdict(Counter)
        path = manifest_path(export, split)
        for row in read_manifest(path) if path.is_file() else ():
            counts[len(row.leaves)].update(len(leaf.subgoals) for leaf in row.leaves)
        found += [BenchmarkStops(split=split, leaves=n, stops=(c[0], c[1], c[2])) for n, c in sorted(counts.items())]
    return found


def _encoded(record: BenchmarkRecord) -> bytes:
    options = orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS
    return orjson.dumps(record.model_dump(mode="json"), option=options) + b"\n"


def _record(benchmark: Benchmark) -> BenchmarkRecord:
    snapshot, file = published(benchmark.config), benchmark.file
    assert benchmark.config.export is not None
    index = read_index(benchmark.config.export) or {}
    if index.get("snapshot") != snapshot.snapshot_id:
        raise UsageError(
            "the export was not made from the published snapshot",
            where=str(benchmark.config.export),
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
        stops=_stops(benchmark.config.export),
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
    table = Index.read(snapshot.store, snapshot.index_hash).table
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


def _code_of(file: BenchmarkFile) -> str:
    return f"Take the code of {file.release} (in a clone: git checkout {file.release})"


def _refuse_other_code(path: Path, benchmark: Benchmark) -> None:
    """Raise an error if this installation or this configuration can't make the final version that the file freezes."""
    file = benchmark.file
    name = f"{file.benchmark} {file.version}"
    other = other_versions(file.stages, code_versions(benchmark.config), f"in {name}")
    if other:
        raise UsageError(
            f"{name} can't be built with this release, whose code has other versions: {other}",
            where=str(path),
            place="stages",
            remedy=f"{_code_of(file)}, or a benchmark file of this release.",
        )
    parts = other_parts(file, benchmark.config)
    if parts:
        raise UsageError(
            f"the configuration is not that of {name}: it differs in {', '.join(parts)}",
            where=str(path.parent / file.run),
            remedy="Change nothing but folders, 'ray', 'keep' and 'limits', and leave out the sources that you don't "
            f"have. If nothing was changed, the code is another one. {_code_of(file)}.",
        )


def _key_lines(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> list[str]:
    other = sorted(key for key in theirs.keys() | ours.keys() if theirs.get(key) != ours.get(key))
    return [f"the configuration differs in: {', '.join(other)}"] if other else []
