"""``condvln verify``: independent proof of every published episode, with a certificate of each."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.export.streams import ByteStream, atomic_stream
from condvln.scene import Scene
from condvln.sources.source import Source, hash_file
from condvln.verify import FACTS, Certificate, Rules, Surfaces, prove_export
from jobs.pipeline import open_configured
from jobs.report import Report, Section
from schemas.config import Config
from schemas.errors import MissingFileError, ProofError

__all__ = ["CERTIFICATES", "SUMMARY", "verify_export"]

CERTIFICATES: Final = "certificates"
"""Folder of the export that holds ``<split>.jsonl``, one certificate an episode, and the summary."""
SUMMARY: Final = "summary.json"
SHOWN: Final = 20
"""Disagreements shown on a terminal; the certificates have all of them."""


def verify_export(config: Config, export_dir: Path) -> Report:
    """Prove every episode of an export from its text and the raw source files; certificates stand beside it.

    The report's exit code is ProofError's where any fact disagrees.

    Raises
    ------
    MissingFileError, FormatError : `export_dir` is no export, or its files are cut
    """
    tally = _Tally()
    folder = export_dir / CERTIFICATES
    with ExitStack() as stack:
        streams: dict[str, ByteStream] = {}
        for certificate in prove_export(export_dir, Rules.of(config), _Scenes(config)):
            tally.add(certificate)
            if certificate.split not in streams:
                streams[certificate.split] = stack.enter_context(atomic_stream(folder / f"{certificate.split}.jsonl"))
            streams[certificate.split].write(_line(certificate))
    document = {**tally.document(), "files": _hashes(export_dir)}
    with atomic_stream(folder / SUMMARY) as stream:
        stream.write(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS) + b"\n")
    return tally.report(document, folder)


class _Scenes:
    """Scenes of the configured sources, read as they are on disk now."""

    def __init__(self, config: Config) -> None:
        self._sources: dict[str, list[Source]] = {}
        for source in config.sources:
            opened = open_configured(config, source, hash_file)
            self._sources.setdefault(source.family, []).append(opened)

    def __call__(self, source: str, scene_id: str) -> tuple[Scene, Surfaces]:
        missing = MissingFileError(
            f"the configuration names no source of family {source!r}", remedy="Verify with the build's own."
        )
        for one in self._sources.get(source, ()):
            try:
                scene = one.read(scene_id)
                return scene, partial(one.geometry, scene)
            except MissingFileError as error:
                missing = error
        raise missing


class _Tally:
    """What all certificates say together."""

    def __init__(self) -> None:
        self.episodes: Counter[str] = Counter()
        self.proven: Counter[str] = Counter()
        self.checked: Counter[str] = Counter()
        self.disagreed: Counter[str] = Counter()
        self.examples: list[tuple[str, str]] = []

    def add(self, certificate: Certificate) -> None:
        """One more."""
        self.episodes[certificate.split] += 1
        self.proven[certificate.split] += certificate.proven
        self.checked.update(certificate.checked)
        for disagreement in certificate.disagreements:
            self.disagreed[disagreement.fact] += 1
            if len(self.examples) < SHOWN:
                self.examples.append((certificate.episode_id, str(disagreement)))

    def document(self) -> dict[str, Any]:
        """The summary as JSON."""
        return {
            "episodes": self.episodes.total(),
            "proven": self.proven.total(),
            "splits": {
                split: {"episodes": count, "proven": self.proven[split]} for split, count in self.episodes.items()
            },
            "facts": {
                fact: {"meaning": FACTS[fact], "checked": count, "disagreed": self.disagreed[fact]}
                for fact, count in self.checked.items()
            },
        }

    def report(self, document: dict[str, Any], folder: Path) -> Report:
        """The summary for people and scripts."""
        total, proven = self.episodes.total(), self.proven.total()
        lines = [f"{proven:,} of {total:,} episodes proven, {self.checked.total():,} facts checked"]
        lines += [f"episode {episode_id}: {text}" for episode_id, text in self.examples]
        if self.disagreed.total() > len(self.examples):
            lines.append(f"… and {self.disagreed.total() - len(self.examples):,} more")
        lines.append(f"certificates in {folder}")
        facts = [(fact, FACTS[fact], self.checked[fact], self.disagreed[fact]) for fact in FACTS if self.checked[fact]]
        exit_code = ProofError.exit_code if self.disagreed else 0
        return Report(
            document, lines, [Section("Facts", ("fact", "meaning", "checked", "disagreed"), [*facts])], exit_code
        )


def _line(certificate: Certificate) -> bytes:
    return orjson.dumps(certificate.document(), option=orjson.OPT_SERIALIZE_NUMPY, default=str) + b"\n"


def _hashes(export_dir: Path) -> dict[str, str]:
    """SHA-256 of the files that were verified: a certificate is worth nothing beside others."""
    paths = [*export_dir.glob("manifest/*.jsonl"), *export_dir.glob("vlnce/*/*.json.gz")]
    return {path.relative_to(export_dir).as_posix(): hash_file(path)[1] for path in sorted(paths)}
