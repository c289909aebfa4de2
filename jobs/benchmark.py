"""``condvln benchmark pack``, ``unpack`` and ``prove``: a benchmark is data. A pack holds an export without the scenes;
anyone unpacks the same export from it, and whoever has the scenes proves it again.

Scenes are found by the content of their files. No version of the code is asked for: the pack has a format of its own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast
from urllib.parse import unquote

from pydantic import ValidationError
from rich.console import Console

from condvln.export.contents import (
    CERTIFICATES,
    SUMMARY,
    exported_snapshot,
    file_hashes,
    read_document,
    read_index,
    stale_proofs,
)
from condvln.export.pack import RECORD, open_pack, packed_files, write_pack
from condvln.export.staging import alone_in, placed, staged
from condvln.export.viewpoints import FAMILY as MP3D
from condvln.export.viewpoints import FOLDER
from condvln.formats.streams import write_file
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.scene_navmesh import with_built_navmesh
from condvln.sources.copies import FoundScenes, find_scenes
from condvln.sources.family import FAMILIES
from condvln.sources.source import hash_file
from condvln.verify.files import find_faults
from factory.chain import Keyer
from factory.stage import Unit
from jobs.agents import datasets_of
from jobs.configuration import load_config
from jobs.export_origin import Origin, config_of, data_of, remember_data
from jobs.generate import run_generate
from jobs.pipeline import SceneReader, build_pipeline, list_units
from jobs.report import Report, Section
from jobs.settings import export_folder
from jobs.verify import verify_export
from jobs.workspace import CONNECTIVITY, graph_folders
from schemas.base import first_fault
from schemas.benchmark import BenchmarkPack, PackedInput, PackedSource
from schemas.config import Config, Family
from schemas.errors import FormatError, InputError, MissingFileError, ProofError, UsageError

__all__ = ["pack_benchmark", "prove_benchmark", "read_record", "unpack_benchmark"]

_OF_EXPORT = "Name the folder of an export, or a configuration."


def pack_benchmark(
    target: Path,
    out: Path,
    given: Sequence[str] = (),
    *,
    name: str = "condvln",
    version: str = "draft",
    inline: bool = False,
    console: Console | None = None,
) -> Report:
    """Write the pack of an export; of a configuration, generate and export first. An export without valid certificates
    is proven first.

    given : ``FAMILY=DIR`` of each dataset; for a configuration also keys ``A.B=C``
    name, version : of the benchmark; it is a draft if its version ends so

    The exit code is 3, and nothing is written, if a proof fails.

    Raises
    ------
    UsageError : there is no export, it is damaged, or a scene's files are not those that it was made from
    """
    if target.is_dir():
        export = target
        config = config_of(export, datasets_of(data_of(export, given)))
    else:
        config = load_config(target, given)
        export = export_folder(config, target)
        made = run_generate(config, inline=inline, console=console)
        if made.exit_code not in (0, ProofError.exit_code):
            return made
    index, origin = read_index(export), Origin.read(export)
    fault = next(iter(find_faults(export)), None)
    if index is None or origin is None or fault is not None:
        raise UsageError(f"no whole export is here: {fault or 'it has no record'}", where=export, remedy=_OF_EXPORT)
    sources = _sources(config, index, _on_viewpoints(export), origin)
    if not _is_proven(export):
        proof = verify_export(config, export, without_store=True, workers=None)
        if proof.exit_code:
            return Report(proof.document, ["NOT PACKED: not all of it is proven", *proof.lines], exit_code=3)
    try:
        record = BenchmarkPack(
            format=1,
            benchmark=name,
            version=version,
            draft=version.endswith("draft"),
            snapshot_id=index["snapshot"],
            episodes=index["episodes"],
            sources=sources,
            files=packed_files(export, [family for family, one in FAMILIES.items() if one.licensed]),
        )
    except ValidationError as error:
        raise UsageError(f"the export can't be packed: {first_fault(error)}", where=export) from None
    size, digest = write_pack(out, export, record), hash_file(out)[1]
    lines = [f"{_title(record)} in {out}", f"{size:,} bytes, SHA-256 {digest}"]
    return Report({**_about(record), "bytes": size, "sha256": digest}, lines)


def _title(record: BenchmarkPack) -> str:
    episodes, scenes = sum(record.episodes.values()), sum(len(one.scenes) for one in record.sources.values())
    note = " (draft: it may still change)" if record.draft else ""
    name = f"{record.benchmark} {record.version}{note}"
    return f"{name}, snapshot {record.snapshot_id}: {episodes:,} episodes of {scenes:,} scenes"


def _about(record: BenchmarkPack) -> dict[str, Any]:
    return record.model_dump(mode="json", exclude={"sources", "files"})


def _on_viewpoints(export: Path) -> set[str]:
    """Return ``family/scene`` of each scan with paths over viewpoints."""
    lines = (line.fields() for path in manifest_paths(export / FOLDER) for line in manifest_lines(path))
    return {f"{row['source']}/{row['scene_id']}" for row in lines}


def _sources(
    config: Config, index: Mapping[str, Any], on_viewpoints: set[str], origin: Origin
) -> dict[Family, PackedSource]:
    """Return what each scene with episodes rests on, by family."""
    scenes = {scene for found in index["scenes"].values() for scene in found} | on_viewpoints
    graphs = graph_folders(config) if index["r2r_episodes"] or on_viewpoints else ()
    units = {unit.unit_id: unit for unit in list_units(config, lru_cache(maxsize=None)(hash_file))}
    keyer = Keyer(build_pipeline(config))
    inputs: dict[str, dict[str, list[PackedInput]]] = {}
    shared: dict[str, dict[str, PackedInput]] = {}
    for scene in sorted(scenes):
        family, _, scene_id = scene.partition("/")
        unit = units.get(scene)
        if unit is None or unit.fault is not None or scene not in origin.scenes:
            why = str(unit.fault) if unit is not None and unit.fault else "it is not among these copies"
            raise UsageError(f"can't be read: {why}", where=scene, remedy="Name its dataset with --data FAMILY=DIR.")
        if keyer.key(unit, 0, {}, None).inputs.hex() != origin.scenes[scene].data:
            what = "the scene's files are not those that the export was made from"
            raise UsageError(what, where=scene, remedy="Export again.")
        its = inputs.setdefault(family, {})[scene_id] = _inputs(unit, shared.setdefault(family, {}))
        graph = f"{scene_id}_connectivity.json"
        file = next((folder / graph for folder in graphs if (folder / graph).is_file()), None)
        if family == MP3D and file is not None and all(Path(one.path).name != graph for one in its):
            its.append(_whole(f"{CONNECTIVITY}/{graph}", file))
    return {cast(Family, family): _source(found, shared[family]) for family, found in inputs.items()}


def _inputs(unit: Unit, shared: dict[str, PackedInput]) -> list[PackedInput]:
    """Return the inputs of a scene, and note the shared files of which they are entries."""
    found, root = [], Path(str(unit.payload["root"]))
    for one in unit.inputs:
        path, mark, entry = one.path.partition("#")
        if not mark or (root / one.path).is_file():
            found.append(PackedInput(path=one.path, bytes=one.size, sha256=one.sha256))
            continue
        if not (root / path).is_file():
            what = f"it rests on {path}, outside its dataset's folder, so nobody would find it in a copy"
            raise UsageError(what, where=unit.unit_id, remedy="Pack scenes without zones or houses of their own.")
        found.append(PackedInput(path=path, entry=entry, bytes=one.size, sha256=one.sha256))
        if path not in shared:
            shared[path] = _whole(path, root / path)
    return found


def _whole(path: str, file: Path) -> PackedInput:
    size, sha256 = hash_file(file)
    return PackedInput(path=path, bytes=size, sha256=sha256)


def _source(scenes: Mapping[str, Sequence[PackedInput]], shared: Mapping[str, PackedInput]) -> PackedSource:
    known = {(one.path, one.entry or ""): one for its in scenes.values() for one in its}
    places = {key: place for place, key in enumerate(sorted(known))}
    return PackedSource(
        inputs=[known[key] for key in places],
        shared=[shared[path] for path in sorted(shared)],
        scenes={scene: [places[one.path, one.entry or ""] for one in its] for scene, its in scenes.items()},
    )


def _is_proven(export: Path) -> bool:
    """Return whether the export's certificates hold for its files and disagree in nothing."""
    summary = read_document(export / CERTIFICATES / SUMMARY) or {}
    facts = summary.get("facts") or {}
    agreed = bool(facts) and not summary.get("faults") and not any(one["disagreed"] for one in facts.values())
    return agreed and not stale_proofs(export, file_hashes(export))


def _pack_file(pack: Path) -> Path:
    """Return `pack`, or the pack of that name that comes with this package if there is no such file."""
    own = Path(str(files("condvln").joinpath("packs", f"{pack.name}.tar.zst")))
    return own if not pack.is_file() and pack.parent == Path() and own.is_file() else pack


def unpack_benchmark(pack: Path, out: Path, scenes: Sequence[str] = ()) -> Report:
    """Write the export of a pack, and find its scenes in the folders ``FAMILY=DIR`` of `scenes`, by content.

    pack : a file, or the name of a pack that comes with this package, such as condvln-1

    The exit code is 3 if a scene of these families is missing or differs; it is named, and the others can be used.

    Raises
    ------
    FormatError : the pack is broken or hostile; nothing is written then
    UsageError : a text of `scenes` is not of that form, or the benchmark has no such family
    """
    with alone_in(out), open_pack(_pack_file(pack)) as packed:
        record = packed.index
        roots = _roots(record, scenes)
        with staged(out) as new:
            others = packed.extract(new)
            found = _find(record, roots, out, new)
    report = _found_report(record, found)
    report.lines.insert(0, f"{_title(record)} in {out}")
    if others:
        report.lines.append(f"{len(others)} files were compressed by another zlib: other bytes, the same content")
    report.document["recompressed"] = others
    return report


def _roots(record: BenchmarkPack, scenes: Sequence[str]) -> dict[Family, list[Path]]:
    roots: dict[Family, list[Path]] = {}
    for text in scenes:
        ((family, root),) = datasets_of([text]).items()
        if family not in record.sources:
            known = ", ".join(record.sources)
            raise UsageError(f"the benchmark has no scenes of {family}", place="--data", remedy=f"It has: {known}.")
        if not root.is_dir():
            raise UsageError("no such folder", where=root, place="--data", remedy="Name the folder of a dataset.")
        roots.setdefault(family, []).append(root.resolve())
    return roots


def _find(
    record: BenchmarkPack, roots: Mapping[Family, Sequence[Path]], out: Path, export: Path
) -> dict[str, FoundScenes]:
    """Find the scenes, note beside `out` where they lie, and add the navmeshes that are no part of the pack.

    export : the folder with the files of `out`
    """
    beside = placed(out).with_name(f".{placed(out).name}.scenes")
    if beside.is_symlink():  # what it leads to is not ours to replace
        raise UsageError("a link is where links to the scenes are put", where=beside, remedy="Remove it.")
    found: dict[str, FoundScenes] = {}
    for family, where in roots.items():
        found[family] = find_scenes(family, record.sources[family], where, beside / family)
    remember_data(out, {family: one.root for family, one in found.items()})
    for entry in record.files:
        _, its, name = f"{entry.path}//".split("/")[:3]
        here, scene_id = found.get(its), unquote(name.removesuffix(".navmesh"))
        if entry.stored or here is None or scene_id in here.lacking:
            continue
        data = _navmesh(config_of(export, {its: here.root}), scene_id)
        if data is not None and hashlib.sha256(data).hexdigest() == entry.sha256:
            write_file(export / entry.path, data)
        else:
            here.lacking[scene_id] = "differs in the navmesh that is built again from it"
    return found


def _navmesh(config: Config, scene_id: str) -> bytes | None:
    """Build the navmesh of a scene of the only configured source; None if it can't be."""
    try:
        source, scene = SceneReader(config).read(config.sources[0].family, scene_id)
        geometry = source.geometry(scene)
    except InputError:
        return None
    return None if geometry is None else with_built_navmesh(scene, geometry, config.agent)[1]


def _found_report(record: BenchmarkPack, found: Mapping[str, FoundScenes]) -> Report:
    lines, rows = [], []
    for family, source in record.sources.items():
        here, count = found.get(family), len(source.scenes)
        if here is None:
            lines.append(f"{family}: {count:,} scenes, none looked for; --data {family}=DIR names a copy")
            continue
        rows += [(f"{family}/{scene}", what) for scene, what in here.lacking.items()]
        lines += [f"{family}: {count - len(here.lacking):,} of {count:,} scenes, in {here.root}", *here.notes]
    section = Section("Scenes that are missing or differ", ("scene", "what"), [*rows])
    return Report({**_about(record), "lacking": dict(rows)}, lines, [section], ProofError.exit_code if rows else 0)


def prove_benchmark(target: Path, scenes: Sequence[str] = (), *, workers: int | None = None) -> Report:
    """Prove a pack (see `unpack_benchmark`), or the export unpacked from it, with this release's verifier.

    scenes : ``FAMILY=DIR`` of each dataset; for a folder, those noted when it was unpacked if none is given

    The exit code is 3 if a scene is missing or differs, or if a proof fails.
    """
    with ExitStack() as stack:
        folder, found = target, Report({})
        if not target.is_dir():
            folder = Path(stack.enter_context(TemporaryDirectory()), "export")
            found = unpack_benchmark(target, folder, scenes)
        elif scenes and (record := read_record(target)).sources:
            found = _found_report(record, _find(record, _roots(record, scenes), target, target))
        config = config_of(folder, datasets_of(data_of(folder, () if found.lines else scenes)))
        proof = verify_export(config, folder, without_store=True, workers=workers)
    if folder != target:
        proof.lines = [line for line in proof.lines if not line.startswith("certificates in ")]
    lines, sections = found.lines + proof.lines, found.sections + proof.sections
    return Report({**found.document, **proof.document}, lines, sections, proof.exit_code or found.exit_code)


def read_record(export: Path) -> BenchmarkPack:
    """Return the index of the pack from which an export was unpacked; of another export, a draft's without a name.

    Raises
    ------
    MissingFileError, FormatError : the folder holds no export, or the index can't be read
    """
    file, snapshot = export / RECORD, exported_snapshot(export)
    try:
        return BenchmarkPack.model_validate_json(file.read_bytes())
    except FileNotFoundError:
        if not snapshot:
            raise MissingFileError("no export is in this folder", where=export, remedy=_OF_EXPORT) from None
        named: dict[str, Any] = {"benchmark": "export", "version": "draft", "draft": True, "snapshot_id": snapshot}
        return BenchmarkPack(format=1, episodes={}, sources={}, files=[], **named)
    except ValidationError as error:
        what = f"not the index of a pack: {first_fault(error)}"
        raise FormatError(what, where=file, remedy="Unpack the benchmark again.") from None
