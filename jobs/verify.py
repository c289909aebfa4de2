"""``condvln verify``: prove every published episode independently, and write a certificate for each."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import orjson
import pyarrow.compute as pc

from condvln.export.contents import CERTIFICATES, INDEX, SUMMARY, document_digest, read_index
from condvln.formats.streams import GZIP_LEVEL, ByteStream, atomic_stream
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.graph_pathfinder import read_connectivity
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.mp3d import Mp3dSource
from condvln.sources.source import hash_file
from condvln.verify import FACTS, Certificate, Surfaces, VerifierRules, prove_export, prove_runs
from condvln.verify.corpus import Corpus
from condvln.verify.files import Fault, find_faults, row_counts, split_names
from condvln.verify.proof import prove_texts
from condvln.verify.surfaces import Shapes
from condvln.verify.viewpoint_paths import VIEWPOINTS, ViewpointMap, prove_paths
from factory.machine import cores, memory_available
from factory.snapshot import Snapshot
from jobs.executor import every_node_sees, open_executor
from jobs.pipeline import SceneReader
from jobs.report import Report, Section, followed
from jobs.workspace import graph_folders, published
from schemas.config import Config
from schemas.errors import InputError, MissingFileError, ProofError, StoreError, shown_path

__all__ = ["verify_export"]

MANIFEST: Final = "manifest"
MOST_WORKERS: Final = 8
"""Most Ray workers that are started unasked: each of them reads the whole export."""
EPISODES_A_WORKER: Final = 5000
"""Number of episodes for which one more worker is worth the start of Ray, some ten seconds."""
WORKER_BYTES: Final = 700 << 20
"""Free memory that one worker is taken to need."""
SHOWN: Final = 20
"""Number of disagreements and faults shown on a terminal; the certificates and the summary have all of them."""


_WITHOUT_STORE: Final = (
    "NOT CHECKED, since the store is left out: texts without an episode, which are in the store alone, and whether the "
    "export, and its paths over viewpoints, are all that was published"
)


def verify_export(config: Config, export_dir: Path, *, without_store: bool = False, workers: int | None = 1) -> Report:
    """Prove every episode of an export from its text and the raw source files, and check that the export is complete.

    Paths over viewpoints are proven too, and the published texts of scenes without a navmesh, which have no episode:
    what can't be proven without one is on their certificates, with the reason, and in the report.

    Certificates are written to ``certificates/`` of the export; where they can't be, the report says so, and its exit
    code is StoreError's. The files are compared with the export's own record,
    and its episodes with the published snapshot. The report's exit code is ProofError's where any fact disagrees,
    where anything is missing, and where there is nothing to prove.

    without_store : leave the snapshot out, as where the store is elsewhere
    workers : number of Ray workers that prove the scenes, 1 = this process alone; None = one for each core if there is
        enough to prove

    Raises
    ------
    ClusterError : Ray can't be used, or a worker was killed several times
    MissingFileError, FormatError : `export_dir` is not an export, or its files are cut and its record does not show it
    """
    tally = _Tally()
    placed = _is_placed(config, export_dir, without_store)
    if placed:
        tally.faults += find_faults(export_dir)
        if not without_store:
            tally.faults += _faults_of_snapshot(config, export_dir)
    written, rows = _Certificates(export_dir), row_counts(export_dir)
    proofs = [_certificates(config, export_dir, workers, sum(rows.values()))] if placed else []
    tally.faults += _faults_of_viewpoints(None if without_store else config, export_dir)
    proofs.append(prove_paths(export_dir, VerifierRules.of(config), _Scenes(config).scan))
    if not without_store:
        proofs.append(_texts_or_fault(config, tally.faults))
    try:
        with written:
            for certificate in followed(itertools.chain.from_iterable(proofs), "proving", sum(rows.values())):
                tally.add(certificate)
                written.add(certificate)
    except InputError as error:
        if not tally.faults:
            raise
        tally.faults.append(Fault(_relative(error.where, export_dir), error.what))
    else:
        tally.faults += _without_certificate(tally.episodes, rows)
    if not any(rows.values()) and (placed or not tally.others):
        tally.faults.append(Fault(MANIFEST, "the export holds no episodes, so nothing is proven"))
    document = {**tally.document(), "files": _hashes(export_dir)}
    written.summary(document)
    report = tally.report(document | written.unwritten(), written)
    if without_store:
        report.lines.insert(0, _WITHOUT_STORE)
    return report


def _without_certificate(certificates: Mapping[str, int], rows: Mapping[str, int]) -> Iterator[Fault]:
    """Yield a fault for each split with fewer certificates than rows, so that no lost scene passes as proven."""
    for split, count in rows.items():
        if certificates.get(split, 0) < count:
            missing = count - certificates.get(split, 0)
            yield Fault(f"{MANIFEST}/{split}.jsonl", f"has {count} rows, of which {missing} got no certificate")


def _certificates(config: Config, export_dir: Path, workers: int | None, episodes: int) -> Iterator[Certificate]:
    """Yield the certificates of an export of so many episodes, proven by so many workers; see
    :func:`verify_export`.
    """
    if workers is None:
        worth = episodes // EPISODES_A_WORKER
        free = memory_available()  # 0 where unknown
        workers = min(cores(), MOST_WORKERS, worth, free // WORKER_BYTES if free else MOST_WORKERS)
    if workers <= 1:
        yield from prove_export(export_dir, VerifierRules.of(config), _Scenes(config))
        return
    shares = [_Share(config, export_dir, number, workers) for number in range(workers)]
    with open_executor(
        config.ray.model_copy(update={"workers": workers}),
        folders=[*every_node_sees(config), export_dir],
    ) as executor:
        executor.begin(float("inf"))
        yield from _in_order(executor.streams(_prove, shares, f"{config.name}:proof"))


class _Share(NamedTuple):
    """The scenes of an export that one worker proves: each one whose number leaves the remainder `number`."""

    config: Config
    export: Path
    number: int
    workers: int


def _prove(share: _Share) -> Iterator[tuple[int, list[Certificate]]]:
    rules = VerifierRules.of(share.config)
    scenes = _Scenes(share.config)
    yield from prove_runs(share.export, rules, scenes, lambda number: number % share.workers == share.number)


def _in_order(streams: Sequence[Iterator[tuple[int, list[Certificate]]]]) -> Iterator[Certificate]:
    """Yield the certificates in the order of their scenes. Each stream ends with the number of all scenes, and the
    certificates of entries that can't be read; these are taken once.
    """
    for number in itertools.count():
        found = next(streams[number % len(streams)], None)
        if found is None or found[0] < number:
            return
        yield from found[1]


def _is_placed(config: Config, export_dir: Path, without_store: bool) -> bool:
    """Return whether an export is to hold episodes on navmeshes: not if its snapshot has none, as where no scene has a
    navmesh.
    """
    if split_names(export_dir) or (export_dir / INDEX).exists():
        return True
    if without_store:
        return not split_names(export_dir / VIEWPOINTS)
    try:
        return published(config).manifest.tables["episodes"].rows > 0
    except (StoreError, FileNotFoundError):
        return True


_OF_TEXTS: Final = (
    *("scene_id", "instruction_id", "group_id", "category", "depth", "chain", "composition", "moves", "leads", "words"),
    *("gold_leaf", "conditions", "branches", "leaves", "text"),
)
"""Columns of the instructions table that the proof of a text reads."""


def _texts_or_fault(config: Config, faults: list[Fault]) -> Iterator[Certificate]:
    """Yield what `_texts` does. A store that can't be read becomes one of `faults`, unless one of them is about it."""
    try:
        yield from _texts(config)
    except StoreError as error:
        if all(fault.file != str(config.store) for fault in faults):
            faults.append(Fault(str(config.store), f"the published texts can't be read: {error}"))


def _texts(config: Config) -> Iterator[Certificate]:
    """Yield the certificates of the published texts of scenes without a navmesh.

    Raises
    ------
    StoreError : the published snapshot can't be read
    """
    try:
        snapshot = published(config)
    except FileNotFoundError as error:
        raise StoreError(str(error), where=config.store) from error
    rules, scenes, corpus = VerifierRules.of(config), _Scenes(config), Corpus()
    for source in snapshot.manifest.tables["scenes"].partitions:
        table = snapshot.table("scenes", ["scene_id", "navmesh_path"], source)
        bare = table.filter(pc.is_null(table["navmesh_path"])).column("scene_id")
        if not len(bare) or source not in snapshot.manifest.tables["instructions"].partitions:
            continue
        rows = snapshot.table("instructions", [*_OF_TEXTS], source)
        rows = rows.filter(pc.is_in(rows["scene_id"], bare))
        for scene_id in sorted(set(rows.column("scene_id").to_pylist())):
            its = rows.filter(pc.equal(rows["scene_id"], scene_id)).to_pylist()
            yield from (_unreadable(row, source, "the row has no text") for row in its if row["text"] is None)
            its = [row for row in its if row["text"] is not None]
            try:
                scene, _ = scenes(source, scene_id)
                yield from prove_texts(its, scene, rules, Shapes(scene.root), corpus)
            except InputError as error:
                yield from (_unreadable(row, source, str(error)) for row in its)


def _unreadable(row: Mapping[str, Any], source: str, why: str) -> Certificate:
    certificate = Certificate(row["instruction_id"], source, row["scene_id"], "", kind="text")
    certificate.holds("readable", False, f"{source}/{row['scene_id']}", why)
    return certificate


def _faults_of_snapshot(config: Config, export_dir: Path) -> Iterator[Fault]:
    """Yield each difference between an export and the published snapshot: episodes that only the export holds, and a
    total that does not account for all episodes of the snapshot.
    """
    index = read_index(export_dir)
    if index is None:
        return
    try:
        snapshot = published(config)
        if index.get("snapshot") != snapshot.snapshot_id:
            yield Fault(
                INDEX,
                f"the export is of snapshot {index.get('snapshot')}, and {snapshot.snapshot_id} is published as "
                f"{config.name!r}; run condvln export",
            )
            return
        known: set[int | str] = set()
        for source in snapshot.manifest.tables["episodes"].partitions:
            known.update(snapshot.table("episodes", ["episode_id"], source).column("episode_id").to_pylist())
    except (StoreError, FileNotFoundError) as error:
        yield Fault(str(config.store), f"the published snapshot can't be read: {error} --without-store leaves it out.")
        return
    for path in manifest_paths(export_dir):
        with suppress(InputError):  # proving the export meets the same fault
            for line in manifest_lines(path):
                name, _ = line.ids()
                if name not in known:
                    yield Fault(f"{MANIFEST}/{path.name}", f"episode {name} is not in the snapshot")
    counts = [count for part in ("episodes", "left_out") for count in (index.get(part) or {}).values()]
    if sum(counts) != len(known):
        yield Fault(INDEX, f"accounts for {sum(counts)} of the {len(known)} episodes of the snapshot")


def _faults_of_viewpoints(config: Config | None, export_dir: Path) -> Iterator[Fault]:
    """Yield each difference between ``viewpoints/`` of an export, the folder's own index, and the published snapshot:
    rows or files that are lost, and a total that does not account for all instructions of scans without a navmesh.

    config : names the snapshot; None leaves it out
    """
    folder, index = export_dir / VIEWPOINTS, read_index(export_dir / VIEWPOINTS)
    snapshot, expected = None, 0
    if config is not None:
        try:
            snapshot = published(config)
            expected = _placeable(config, snapshot)
        except (StoreError, FileNotFoundError):
            snapshot = None  # the proof of the texts says so
    if index is None:
        if expected:
            yield Fault(
                f"{VIEWPOINTS}/{INDEX}",
                f"is missing or truncated, so it is unknown how many of {expected:,} instructions of scans without a "
                "navmesh are to have a path; run condvln export",
            )
        elif split_names(folder):
            yield Fault(f"{VIEWPOINTS}/{INDEX}", "is missing or truncated, so the expected content is unknown")
        return
    if index.get("digest") != document_digest(index):
        yield Fault(f"{VIEWPOINTS}/{INDEX}", "was changed or truncated after the export: its digest differs")
        return
    if not all(isinstance(index.get(name), dict) for name in ("episodes", "left_out")):
        yield Fault(f"{VIEWPOINTS}/{INDEX}", "does not say how many paths were placed and left out; run condvln export")
        return
    rows = row_counts(folder)
    for split in sorted({*rows, *index["episodes"]}):
        found, listed = rows.get(split, 0), index["episodes"].get(split, 0)
        if found != listed:
            yield Fault(f"{VIEWPOINTS}/{MANIFEST}/{split}.jsonl", f"holds {found} paths, {INDEX} says {listed}")
    if snapshot is None:
        return
    if index.get("snapshot") != snapshot.snapshot_id:
        yield Fault(f"{VIEWPOINTS}/{INDEX}", f"is of snapshot {index.get('snapshot')}, not of {snapshot.snapshot_id}")
        return
    counted = sum(index["episodes"].values()) + sum(index["left_out"].values())
    if counted != expected:
        yield Fault(
            f"{VIEWPOINTS}/{INDEX}",
            f"accounts for {counted:,} of {expected:,} instructions of scans without a navmesh",
        )


def _placeable(config: Config, snapshot: Snapshot) -> int:
    """Return the number of a snapshot's instructions whose scans have viewpoints and no navmesh."""
    if not all("mp3d" in snapshot.manifest.tables[name].partitions for name in ("scenes", "instructions")):
        return 0
    table = snapshot.table("scenes", ["scene_id", "navmesh_path"], "mp3d")
    bare = table.filter(pc.is_null(table["navmesh_path"])).column("scene_id").to_pylist()
    folders = graph_folders(config)
    scans = {name for name in bare if any((folder / f"{name}_connectivity.json").is_file() for folder in folders)}
    return sum(name in scans for name in snapshot.table("instructions", ["scene_id"], "mp3d")["scene_id"].to_pylist())


def _relative(where: str, export_dir: Path) -> str:
    path = Path(where)
    return path.relative_to(export_dir).as_posix() if path.is_relative_to(export_dir) else where


class _Scenes:
    """Scenes of the configured sources, read from the files that are on disk now."""

    def __init__(self, config: Config) -> None:
        self._agent = config.agent
        self._graphs = graph_folders(config)
        self._reader = SceneReader(config)

    def __call__(self, source: str, scene_id: str) -> tuple[Scene, Surfaces]:
        found, scene = self._reader.read(source, scene_id)
        scene = with_shipped_navmesh(scene, self._agent)
        return scene, partial(found.geometry, scene)

    def scan(self, scan: str) -> tuple[Scene, ViewpointMap]:
        """Return a Matterport3D scan with its viewpoints.

        Raises
        ------
        MissingFileError, FormatError : the scan or its connectivity file is missing, or can't be read
        """
        scene, _ = self("mp3d", scan)
        name = f"{scan}_connectivity.json"
        file = next((folder / name for folder in self._graphs if (folder / name).is_file()), None)
        if file is None:
            raise MissingFileError(
                f"the scan {scan} has no connectivity file, which its paths are proven with",
                where=self._graphs[0] / name if self._graphs else name,
                remedy="Set 'connectivity' of the mp3d source to the folder that the export was made with",
            )
        panoramas = {
            panorama.name: (float(panorama.position[0]), -float(panorama.position[1]))
            for source in self._reader.sources["mp3d"]
            if isinstance(source, Mp3dSource) and scan in source.scene_ids()
            for panorama in source.house(scan).panoramas
        }
        return scene, ViewpointMap(read_connectivity(file), f"connectivity/{name}", panoramas or None)


_OTHERS: Final = {"path": "paths over viewpoints", "text": "texts without an episode"}
"""What is proven beside episodes."""


class _Certificates:
    """The certificates of an export, written as they are proven. A folder that can't be written stops no proof: nothing
    more is written then, files of an earlier run stay, and `refusal` says why.
    """

    def __init__(self, export_dir: Path) -> None:
        self.folder = export_dir / CERTIFICATES
        self.refusal: StoreError | None = None
        self._streams: dict[str, ByteStream] = {}

    def __enter__(self) -> _Certificates:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None and self.refusal is None:
            with self._refusals():
                for stream in self._streams.values():
                    stream.commit()
                for path in self.folder.glob("*.jsonl"):
                    if path.name not in self._streams:
                        path.unlink()
        else:
            self._abandon()

    def add(self, certificate: Certificate) -> None:
        """Write one certificate."""
        name = f"{certificate.split}.jsonl" if certificate.kind == "episode" else f"{certificate.kind}s.jsonl"
        if self.refusal is None:
            with self._refusals():
                if name not in self._streams:
                    self._streams[name] = ByteStream(self.folder / name, GZIP_LEVEL)
                self._streams[name].write(_line(certificate))

    def summary(self, document: Mapping[str, Any]) -> None:
        """Write the summary."""
        if self.refusal is None:
            with self._refusals(), atomic_stream(self.folder / SUMMARY) as stream:
                stream.write(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS) + b"\n")

    def unwritten(self) -> dict[str, Any]:
        """Return, for scripts, the file that could not be written and why; empty if all were."""
        if self.refusal is None:
            return {}
        return {"unwritten": Fault(_relative(self.refusal.where, self.folder.parent), self.refusal.what).document()}

    def line(self) -> str:
        """Return where the certificates are, or that they could not be written."""
        if self.refusal is None:
            return f"certificates in {self.folder}"
        earlier = "; files of an earlier run lie there" if any(self.folder.glob("*.json*")) else ""
        return f"NOT WRITTEN: {self.refusal.where}: {self.refusal.what}{earlier}"

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            self.refusal = error
            self._abandon()
        except OSError as error:
            self.refusal = StoreError(
                f"can't be written: {error.strerror or error}", where=error.filename or self.folder
            )
            self._abandon()

    def _abandon(self) -> None:
        for stream in self._streams.values():
            stream.abandon()


class _Tally:
    """Counts over all certificates."""

    def __init__(self) -> None:
        self.episodes: Counter[str] = Counter()
        self.proven: Counter[str] = Counter()
        self.others: Counter[str] = Counter()
        """Numbers of paths and texts."""
        self.others_proven: Counter[str] = Counter()
        self.unproven: Counter[tuple[str, str, str]] = Counter()
        """Numbers of certificates by kind, fact that can't be proven, and reason."""
        self.checked: Counter[str] = Counter()
        self.disagreed: Counter[str] = Counter()
        self.examples: list[tuple[str, int | str, str]] = []
        self.faults: list[Fault] = []
        """Faults of the export as a whole."""

    def add(self, certificate: Certificate) -> None:
        """Count one certificate."""
        if certificate.kind == "episode":
            self.episodes[certificate.split] += 1
            self.proven[certificate.split] += certificate.proven
        else:
            self.others[certificate.kind] += 1
            self.others_proven[certificate.kind] += certificate.proven
        self.unproven.update([(certificate.kind, *one) for one in certificate.unproven.items()])
        self.checked.update(certificate.checked)
        for disagreement in certificate.disagreements:
            self.disagreed[disagreement.fact] += 1
            if len(self.examples) < SHOWN:
                self.examples.append((certificate.kind, certificate.episode_id, str(disagreement)))

    def document(self) -> dict[str, Any]:
        """Return the summary as JSON."""
        return {
            "episodes": self.episodes.total(),
            "proven": self.proven.total(),
            **{
                f"{kind}s": {f"{kind}s": count, "proven": self.others_proven[kind]}
                for kind, count in self.others.items()
            },
            "unproven": [
                {"kind": kind, "fact": fact, "reason": reason, "count": count}
                for (kind, fact, reason), count in self.unproven.items()
            ],
            "faults": [fault.document() for fault in self.faults],
            "splits": {
                split: {"episodes": count, "proven": self.proven[split]} for split, count in self.episodes.items()
            },
            "facts": {
                fact: {"meaning": FACTS[fact], "checked": count, "disagreed": self.disagreed[fact]}
                for fact, count in self.checked.items()
            },
        }

    def report(self, document: dict[str, Any], written: _Certificates) -> Report:
        """Return the summary for people and scripts."""
        total, proven = self.episodes.total(), self.proven.total()
        lines = [f"{proven:,} of {total:,} episodes proven, {self.checked.total():,} facts checked"]
        lines += [
            f"{self.others_proven[kind]:,} of {count:,} {what} proven"
            for kind, what in _OTHERS.items()
            if (count := self.others[kind])
        ]
        lines += [
            f"not provable of {count:,} {_OTHERS.get(kind, 'episodes')}: {FACTS[fact]} ({reason})"
            for (kind, fact, reason), count in self.unproven.items()
        ]
        lines += [f"INCOMPLETE: {fault}" for fault in self.faults[:SHOWN]]
        if len(self.faults) > SHOWN:
            place = f", see {written.folder / SUMMARY}" if written.refusal is None else ""
            lines.append(f"… and {len(self.faults) - SHOWN:,} more{place}")
        lines += [f"{kind} {name}: {text}" for kind, name, text in self.examples]
        if self.disagreed.total() > len(self.examples):
            lines.append(f"… and {self.disagreed.total() - len(self.examples):,} more")
        lines.append(written.line())
        facts = [
            (fact, FACTS[fact], self.checked[fact], self.disagreed[fact]) for fact in FACTS if self.disagreed[fact]
        ]
        exit_code = 0 if written.refusal is None else written.refusal.exit_code
        if self.disagreed or self.faults:
            exit_code = ProofError.exit_code
        columns = ("fact", "meaning", "checked", "disagreed")
        return Report(document, lines, [Section("Facts that disagree", columns, [*facts])], exit_code)


def _line(certificate: Certificate) -> bytes:
    return orjson.dumps(certificate.document(), option=orjson.OPT_SERIALIZE_NUMPY, default=str) + b"\n"


def _hashes(export_dir: Path) -> dict[str, str]:
    """Return the SHA-256 of each verified file, by path. Certificates hold for these files only."""
    hashes = {}
    patterns = ("vlnce/*/*.json.gz", "r2r/R2R_*.json", f"{VIEWPOINTS}/R2R_*.json", f"{VIEWPOINTS}/manifest/*.jsonl")
    for path in sorted([*manifest_paths(export_dir), *(p for pattern in patterns for p in export_dir.glob(pattern))]):
        with suppress(OSError):  # it is one of the faults
            hashes[shown_path(path.relative_to(export_dir))] = hash_file(path)[1]
    return hashes
