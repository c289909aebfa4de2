"""Lint files and folders: detect each file's format, pair files that belong together, find leaks between splits, and
find the navmesh that an episode is checked against.

Our exports name navmeshes in the manifest, by path and hash. Other files name only a scene, whose navmesh is beside the
mesh, as in Habitat's own datasets.
"""

from __future__ import annotations

import copy
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.export.contents import CERTIFICATES, INDEX, ORIGIN
from condvln.export.tables import SPLITS_TABLE
from condvln.export.validation.episodes import Document, PathfinderOf, check_document
from condvln.export.validation.findings import Finding, LintReport
from condvln.export.validation.paths import check_r2r, check_truths
from condvln.formats.json_entries import read_unpacked
from condvln.formats.parquet_rows import refuse_parquet_bombs
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import NavmeshFolder
from schemas.errors import CondVLNError, InputError, MissingFileError, UsageError, shown_path

__all__ = ["EpisodeNavmeshes", "Options", "validate"]

_SUFFIXES: Final = (".json", ".json.gz")
_TRUTH: Final = "_gt"
_SHARDS: Final = "content"
_FORMS: Final = ("_guide", "_follower", "_bertidx", "_raw")
"""Ends of names of files that hold one split in several forms: RxR's roles, and R2R's tokens of BERT or of words."""
# Files in an export's folder, or made by related tools, that hold no episodes.
_OTHERS: Final = (INDEX, ORIGIN, "croissant.json", "embeddings.json.gz")

_SCENES: Final = ("data", "scene_datasets")
_LEVELS: Final = 3
"""Number of folders from a split's file up to its export: variant, split, content."""

_GROUPS: Final = {"train": "train", "val_seen": "train", "joint_train_envdrop": "train", "envdrop": "train"}
"""Splits that may share scenes; every other split is a group of its own."""


@dataclass(frozen=True)
class Options:
    """The navmeshes and graphs that files are checked against, and what was checked.

    files, entries : names of the files, and numbers of episodes, paths and ground truths by kind; filled by
        :func:`validate`
    """

    pathfinder_of: PathfinderOf | None = None
    graphs: Mapping[str, GraphPathfinder] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    entries: Counter[str] = field(default_factory=Counter)


def validate(path: Path, options: Options | None = None) -> list[Finding]:
    """Return all findings in a file, or in all VLN-CE, ANSR-v1, RxR and R2R files below a folder, sorted by file.

    Files that belong together are checked together: ``x.json.gz`` with ``x_gt.json.gz`` beside it, and the splits of
    one folder for leakage, with their shards below ``content/``.

    Raises
    ------
    UsageError : the path does not exist, or holds neither such a file nor an export
    """
    options = options or Options()
    files = [path] if path.is_file() else _files_below(path)
    if not files and not any((path / name).is_file() for name in (INDEX, ORIGIN)):
        raise UsageError(
            "no VLN-CE, ANSR-v1, RxR or R2R file found",
            where=path,
            remedy="Name a .json or .json.gz file, or a folder",
        )
    options.files.extend(_shown(file, path) for file in files)
    findings: list[Finding] = []
    variants: dict[Path, dict[str, tuple[str, Document]]] = {}
    documents: dict[Path, Document] = {}
    sharded: dict[Path, set[str]] = {}
    for file in files:
        if _is_truth(file):
            continue
        report = LintReport(_shown(file, path))
        document = _check_file(report, file, options)
        findings += _without_shards(report, file)
        if document is not None:
            documents[file] = document
            folder, split = _place(file)
            if _is_shard(file):
                sharded.setdefault(folder, set()).add(split)
            known = variants.setdefault(folder, {})
            if split in known:
                shards = _is_shard(file) or split in sharded.get(folder, ())
                findings += _joined(known[split][1], document, report.file, shards=shards)
            else:
                known[split] = (report.file, copy.deepcopy(document))
    for file in files:
        if _is_truth(file):
            findings += _check_truth_file(file, path, documents, options)
    for splits in variants.values():
        findings += _check_leaks(splits)
    for table in sorted(path.rglob(SPLITS_TABLE)):
        findings += _check_splits(table, _shown(table, path))
    return sorted(findings, key=lambda finding: finding.file)


def _check_file(report: LintReport, file: Path, options: Options) -> Document | None:
    content = _content(report, file)
    if isinstance(content, dict) and "episodes" in content:
        document = check_document(report, content, options.pathfinder_of)
        options.entries[document.kind] += len(document.starts)
        return document
    if isinstance(content, list):
        options.entries["r2r"] += len(content)
        return Document("r2r", scenes=check_r2r(report, content, options.graphs))
    if content is not None:
        report.add("", "unknown-shape", "neither episodes, nor ground truth, nor R2R items")
    return None


def _check_splits(file: Path, shown: str) -> Iterator[Finding]:
    """Yield a finding if an export's table of splits can't be read, or tells other splits than its manifests."""
    paths = manifest_paths(file.parent)
    try:
        refuse_parquet_bombs(file)
        rows = pq.read_table(file, columns=["episode_id", "split"], partitioning=None).to_pylist()
        known = {(line.ids()[0], path.stem) for path in paths for line in manifest_lines(path)}
    except (pa.ArrowException, ValueError, OSError, InputError) as error:
        yield Finding(shown, "", "unreadable", str(error).splitlines()[0])
        return
    differ = {(row["episode_id"], row["split"]) for row in rows} ^ known
    if differ:
        name, split = min(differ, key=str)
        message = f"only the table or only the manifest has it in {split}; so {len(differ) - 1} others"
        yield Finding(shown, f"episode {name}", "splits-differ", message, str(name))


def _without_shards(report: LintReport, file: Path) -> Iterator[Finding]:
    """Yield the findings of ``report``, except "no-episodes" if the split's episodes are in shards."""
    has_shards = any((file.parent / _SHARDS).glob("*.json.gz"))
    return (finding for finding in report if not (has_shards and finding.code == "no-episodes"))


def _joined(split: Document, shard: Document, file: str, *, shards: bool) -> Iterator[Finding]:
    """Merge a file (`shard`) into its `split`, and yield a finding if their vocabularies differ. With `shards`, the
    file is a shard, and each episode id that the split already has is a finding too. Without `shards`, the file is
    another form of the same split, such as ``_raw`` and ``_bertidx``, or guides and followers.
    """
    for name in sorted(split.starts.keys() & shard.starts.keys() if shards else ()):
        yield Finding(file, f"episode {name}", "duplicate-id", f"id {name} is in another shard too", name)
    if None not in (split.vocabulary, shard.vocabulary) and split.vocabulary != shard.vocabulary:
        yield Finding(file, "instruction_vocab", "vocabulary-differs", "is not that of the other shards")
    split.merge(shard)


def _files_below(path: Path) -> list[Path]:
    found = [file for file in sorted(path.rglob("*")) if file.name.endswith(_SUFFIXES) and not file.is_dir()]
    episodes = [file for file in found if file.parent.name != CERTIFICATES]
    return [file for file in episodes if file.name not in _OTHERS and not file.name.startswith(".")]


def _is_shard(file: Path) -> bool:
    return file.parent.name == _SHARDS


def _is_truth(file: Path) -> bool:
    return _stem(file).endswith(_TRUTH)


def _stem(file: Path) -> str:
    return file.name.removesuffix(".gz").removesuffix(".json")


def _shown(file: Path, root: Path) -> str:
    return shown_path(file.relative_to(root).as_posix() if root.is_dir() else file.name)


def _place(file: Path) -> tuple[Path, str]:
    """Return the variant's folder and the name of the split from a path like ``<variant>/<split>/<split>.json.gz`` or
    ``…/<split>/content/<scene>.json.gz``.
    """
    folder = file.parent
    if folder.name == _SHARDS:
        return folder.parent.parent, folder.parent.name
    split = _stem(file).removeprefix("R2R_")
    for form in _FORMS:
        split = split.removesuffix(form)
    return (folder.parent, split) if folder.name == split else (folder, split)


def _content(report: LintReport, file: Path) -> Any:
    try:
        data = read_unpacked(file)
    except InputError as error:
        report.add("", "unreadable", error.what)
        return None
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        name = _nonstandard_number(data)
        if name:
            report.add("", "not-a-number", f"it holds {name}")
        else:
            report.add(f"line {error.lineno}", "unreadable", error.msg)
        return None


def _nonstandard_number(data: bytes) -> str:
    """Return the first NaN or infinity in ``data`` as it is written there; empty if ``data`` has none. Python writes
    such numbers, although JSON does not allow them.
    """
    seen: list[str] = []
    with suppress(ValueError, RecursionError):
        json.loads(data, parse_constant=seen.append)
    return seen[0] if seen else ""


def _check_truth_file(file: Path, root: Path, documents: Mapping[Path, Document], options: Options) -> LintReport:
    report = LintReport(_shown(file, root))
    content = _content(report, file)
    beside = [file.with_name(_stem(file).removesuffix(_TRUTH) + suffix) for suffix in _SUFFIXES]
    document = next((documents[other] for other in beside if other in documents), None)
    if document is not None and not document.starts:
        document = _of_shards(file, documents)
    if isinstance(content, dict):
        options.entries["truth"] += len(content)
        check_truths(report, content, document)
    elif content is not None:
        report.add("", "unknown-shape", "ground truth is {id: {locations, …}}")
    return report


def _of_shards(truth: Path, documents: Mapping[Path, Document]) -> Document | None:
    """Return the episodes of all shards that belong to the ground-truth file ``truth``, as one document; None if there
    are none.
    """
    together = Document("vlnce")
    for file, document in documents.items():
        if file.parent == truth.parent / _SHARDS:
            together.merge(document)
    return together if together.starts else None


def _check_leaks(splits: Mapping[str, tuple[str, Document]]) -> Iterator[Finding]:
    """Yield a finding for everything that two splits of one folder share but must not, and for vocabularies that differ
    between them.
    """
    names = sorted(splits)
    for number, split in enumerate(names):
        file, document = splits[split]
        for other in names[:number]:
            _, earlier = splits[other]
            shared = sorted(document.scenes & earlier.scenes)
            if shared and _GROUPS.get(split, split) != _GROUPS.get(other, other):
                yield Finding(file, "", "scene-leak", f"{len(shared)} scenes are in {other} too, such as {shared[0]}")
            for key in sorted(document.told.keys() & earlier.told.keys()):
                place = f"episode {document.told[key]}"
                message = f"is episode {earlier.told[key]} of {other}"
                yield Finding(file, place, "episode-leak", message, document.told[key])
            if None not in (document.vocabulary, earlier.vocabulary) and document.vocabulary != earlier.vocabulary:
                yield Finding(file, "instruction_vocab", "vocabulary-differs", f"is not that of {other}")


class EpisodeNavmeshes:
    """Finds the navmeshes of episodes below some folders.

    Parameters
    ----------
    path : the checked file; if it belongs to an export, the export is searched first
    roots : folders of datasets, or the folder of scene datasets

    Attributes
    ----------
    checked : scenes whose navmesh was found
    lacking : why no navmesh was found, by scene_id
    """

    def __init__(self, path: Path, roots: Sequence[Path]) -> None:
        export = next((p for p in (path, *path.parents[: _LEVELS + 1]) if manifest_paths(p)), None)
        self._roots = tuple(roots)
        self._recorded = {} if export is None else _recorded(export)
        self._proven = NavmeshFolder((*([export] if export is not None else []), *roots))
        self._found: dict[tuple[str, str], Pathfinder | None] = {}
        self.checked: set[str] = set()
        self.lacking: dict[str, str] = {}

    def __call__(self, episode: Mapping[str, Any]) -> Pathfinder | None:
        """Return the pathfinder of an episode's scene; None if no navmesh of the scene exists."""
        info, scene = episode.get("info"), str(episode.get("scene_id"))
        digest = str(info.get("navmesh_sha256")) if isinstance(info, dict) else ""
        key = scene, digest
        if key not in self._found:
            self._found[key] = self._load(scene, digest)
        return self._found[key]

    def _load(self, scene: str, digest: str) -> Pathfinder | None:
        try:
            if digest in self._recorded:
                found = self._proven.load(self._recorded[digest], digest, scene)
            else:
                found = Pathfinder.load(self._beside(scene))
        except CondVLNError as error:
            self.lacking[scene] = error.what
            return None
        self.checked.add(scene)
        return found

    def _beside(self, scene: str) -> Path:
        parts = PurePosixPath(scene).parts
        if parts[:2] == _SCENES:
            parts = parts[2:]
        if not parts or ".." in parts or PurePosixPath(scene).is_absolute():
            raise MissingFileError(f"no navmesh of {scene!r}")
        name = PurePosixPath(*parts).with_suffix(".navmesh")
        for root in self._roots:
            # A root is either the folder of all scene datasets, or of one of them.
            for relative in (name, PurePosixPath(*name.parts[1:])):
                if relative.name and (root / relative).is_file():
                    return root / relative
        raise MissingFileError(f"no {name} below {', '.join(map(str, self._roots)) or 'any folder'}")


def _recorded(export: Path) -> dict[str, str]:
    """Return the path of each navmesh by its hash, from the manifests; damaged lines are skipped."""
    found: dict[str, str] = {}
    for path in manifest_paths(export):
        for line in manifest_lines(path):
            with suppress(InputError, KeyError):
                row = line.fields()
                found.setdefault(str(row["navmesh_sha256"]), str(row["navmesh"]))
    return found
