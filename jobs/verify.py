"""``condvln verify``: prove every published episode independently, and write a certificate for each."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.export.contents import CERTIFICATES, INDEX, SUMMARY, read_index
from condvln.formats.streams import GZIP_LEVEL, ByteStream, atomic_stream
from condvln.manifest import ManifestLine, manifest_lines, manifest_paths
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.source import Source, hash_file
from condvln.verify import FACTS, Certificate, Surfaces, VerifierRules, prove_export, prove_runs
from condvln.verify.completeness import Fault, find_faults, row_counts
from factory.machine import cores, memory_available
from jobs.pipeline import open_configured
from jobs.proof_processes import prove_side_by_side
from jobs.report import Report, Section
from jobs.warm_up import PROVEN_WITH, load_kernels
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import InputError, MissingFileError, ProofError, StoreError
from schemas.file_name import shown_path

__all__ = ["verify_export"]

MANIFEST: Final = "manifest"
MOST_WORKERS: Final = 8
"""Most processes that are started unasked: each of them reads the whole export."""
EPISODES_A_WORKER: Final = 1500
"""Number of episodes for which one more process is worth its start, some three seconds."""
WORKER_BYTES: Final = 700 << 20
"""Free memory that one process is taken to need."""
SHOWN: Final = 20
"""Number of disagreements and faults shown on a terminal; the certificates and the summary have all of them."""


def verify_export(config: Config, export_dir: Path, *, without_store: bool = False, workers: int | None = 1) -> Report:
    """Prove every episode of an export from its text and the raw source files, and check that the export is complete.

    Certificates are written to ``certificates/`` of the export; where they can't be, the report says so, and its exit
    code is StoreError's. The files are compared with the export's own record,
    and its episodes with the published snapshot. The report's exit code is ProofError's where any fact disagrees,
    where anything is missing, and where there is nothing to prove.

    without_store : leave the snapshot out, as where the store is elsewhere
    workers : number of processes that prove the scenes, 1 = this one alone; None = one for each core if there is enough
        to prove. They run the caller's main module again, as those of ``multiprocessing`` do

    Raises
    ------
    ClusterError : one of the processes was killed
    MissingFileError, FormatError : `export_dir` is not an export, or its files are cut and its record does not show it
    """
    tally = _Tally()
    tally.faults += find_faults(export_dir)
    if not without_store:
        tally.faults += _faults_of_snapshot(config, export_dir)
    written, rows = _Certificates(export_dir), row_counts(export_dir)
    try:
        with written:
            for certificate in _certificates(config, export_dir, workers, sum(rows.values())):
                tally.add(certificate)
                written.add(certificate)
    except InputError as error:
        if not tally.faults:
            raise
        tally.faults.append(Fault(_relative(error.where, export_dir), error.what))
    else:
        tally.faults += _without_certificate(tally.episodes, rows)
    if not any(rows.values()):
        tally.faults.append(Fault(MANIFEST, "the export holds no episodes, so nothing is proven"))
    document = {**tally.document(), "files": _hashes(export_dir)}
    written.summary(document)
    return tally.report(document | written.unwritten(), written)


def _without_certificate(certificates: Mapping[str, int], rows: Mapping[str, int]) -> Iterator[Fault]:
    """Yield a fault for each split with fewer certificates than rows, so that no lost scene passes as proven."""
    for split, count in rows.items():
        if certificates.get(split, 0) < count:
            missing = count - certificates.get(split, 0)
            yield Fault(f"{MANIFEST}/{split}.jsonl", f"has {count} rows, of which {missing} got no certificate")


def _certificates(config: Config, export_dir: Path, workers: int | None, episodes: int) -> Iterator[Certificate]:
    """Yield the certificates of an export of so many episodes, proven by so many processes; see
    :func:`verify_export`.
    """
    if workers is None:
        worth = episodes // EPISODES_A_WORKER
        free = memory_available()  # 0 where unknown
        workers = min(cores(), MOST_WORKERS, worth, free // WORKER_BYTES if free else MOST_WORKERS)
    if workers <= 1:
        return prove_export(export_dir, VerifierRules.of(config), _Scenes(config))
    load_kernels(partial(print, file=sys.stderr), PROVEN_WITH)
    return prove_side_by_side(partial(_runs, config, export_dir), workers)


def _runs(config: Config, export_dir: Path, mine: Callable[[int], bool]) -> Iterator[tuple[int, list[Certificate]]]:
    return prove_runs(export_dir, VerifierRules.of(config), _Scenes(config), mine)


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
                name = _episode_id(line)
                if name is not None and name not in known:
                    yield Fault(f"{MANIFEST}/{path.name}", f"episode {name} is not in the snapshot")
    counts = [count for part in ("episodes", "left_out") for count in (index.get(part) or {}).values()]
    if sum(counts) != len(known):
        yield Fault(INDEX, f"accounts for {sum(counts)} of the {len(known)} episodes of the snapshot")


def _episode_id(line: ManifestLine) -> int | str | None:
    """Return the id on a line of a manifest; None if it has none, which proving the export meets too."""
    try:
        fields = orjson.loads(line.text)
    except orjson.JSONDecodeError:
        return None
    name = fields.get("episode_id") if isinstance(fields, dict) else None
    return name if isinstance(name, (int, str)) else None


def _relative(where: str, export_dir: Path) -> str:
    path = Path(where)
    return path.relative_to(export_dir).as_posix() if path.is_relative_to(export_dir) else where


class _Scenes:
    """Scenes of the configured sources, read from the files that are on disk now."""

    def __init__(self, config: Config) -> None:
        self._agent = config.agent
        self._sources: dict[str, list[Source]] = {}
        for source in config.sources:
            opened = open_configured(config, source, hash_file)
            self._sources.setdefault(source.family, []).append(opened)

    def __call__(self, source: str, scene_id: str) -> tuple[Scene, Surfaces]:
        missing = MissingFileError(
            f"the configuration names no source of family {source!r}",
            remedy="Use the configuration that the export was built with.",
        )
        for one in self._sources.get(source, ()):
            try:
                scene = with_shipped_navmesh(one.read(scene_id), self._agent)
                return scene, partial(one.geometry, scene)
            except MissingFileError as error:
                missing = error
        raise missing


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
        name = f"{certificate.split}.jsonl"
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
        self.checked: Counter[str] = Counter()
        self.disagreed: Counter[str] = Counter()
        self.examples: list[tuple[int | str, str]] = []
        self.faults: list[Fault] = []
        """Faults of the export as a whole."""

    def add(self, certificate: Certificate) -> None:
        """Count one certificate."""
        self.episodes[certificate.split] += 1
        self.proven[certificate.split] += certificate.proven
        self.checked.update(certificate.checked)
        for disagreement in certificate.disagreements:
            self.disagreed[disagreement.fact] += 1
            if len(self.examples) < SHOWN:
                self.examples.append((certificate.episode_id, str(disagreement)))

    def document(self) -> dict[str, Any]:
        """Return the summary as JSON."""
        return {
            "episodes": self.episodes.total(),
            "proven": self.proven.total(),
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
        lines += [f"INCOMPLETE: {fault}" for fault in self.faults[:SHOWN]]
        if len(self.faults) > SHOWN:
            place = f", see {written.folder / SUMMARY}" if written.refusal is None else ""
            lines.append(f"… and {len(self.faults) - SHOWN:,} more{place}")
        lines += [f"episode {episode_id}: {text}" for episode_id, text in self.examples]
        if self.disagreed.total() > len(self.examples):
            lines.append(f"… and {self.disagreed.total() - len(self.examples):,} more")
        lines.append(written.line())
        facts = [(fact, FACTS[fact], self.checked[fact], self.disagreed[fact]) for fact in FACTS if self.checked[fact]]
        exit_code = 0 if written.refusal is None else written.refusal.exit_code
        if self.disagreed or self.faults:
            exit_code = ProofError.exit_code
        return Report(
            document, lines, [Section("Facts", ("fact", "meaning", "checked", "disagreed"), [*facts])], exit_code
        )


def _line(certificate: Certificate) -> bytes:
    return orjson.dumps(certificate.document(), option=orjson.OPT_SERIALIZE_NUMPY, default=str) + b"\n"


def _hashes(export_dir: Path) -> dict[str, str]:
    """Return the SHA-256 of each verified file, by path. Certificates hold for these files only."""
    hashes = {}
    for path in sorted([*manifest_paths(export_dir), *export_dir.glob("vlnce/*/*.json.gz")]):
        with suppress(OSError):  # it is one of the faults
            hashes[shown_path(path.relative_to(export_dir))] = hash_file(path)[1]
    return hashes
