"""Verify a whole export: a certificate for every episode, scene by scene."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from pydantic import ValidationError

from condvln.formats.regular_file import read_regular
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.corpus import Corpus
from condvln.verify.files import UNPROVEN, ExportFiles, Row, SceneRun, UnplacedText
from condvln.verify.footprints import Obstacles
from condvln.verify.looking import check_looking
from condvln.verify.observability import (
    Onlookers,
    Surfaces,
    check_absence,
    check_observability,
    check_seen,
    sight_of,
)
from condvln.verify.placement import check_placement
from condvln.verify.program_check import check_program
from condvln.verify.records import check_looking_truths, check_record, check_truths
from condvln.verify.referents import SceneReferents
from condvln.verify.surfaces import Shapes
from condvln.verify.text_check import check_meaning
from schemas.errors import InputError, MissingFileError, PathEscapeError

__all__ = ["Navmesh", "SceneReader", "find_navmesh", "prove_export", "prove_runs", "prove_scene", "prove_texts"]


class SceneReader(Protocol):
    """Reads scenes from their source files."""

    def __call__(self, source: str, scene_id: str) -> tuple[Scene, Surfaces]:
        """Return a scene, and a function that reads the scene's surfaces. Both calls raise InputError if files can't be
        read.
        """
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Navmesh:
    """A navmesh with its recorded name and hash."""

    path: str
    sha256: str
    pathfinder: Pathfinder


def prove_export(folder: Path, rules: VerifierRules, read_scene: SceneReader) -> Iterator[Certificate]:
    """Yield the certificates of all episodes of an export, scene by scene.

    Raises
    ------
    InputError : the export itself can't be read
    """
    for _, certificates in prove_runs(folder, rules, read_scene, lambda number: True):
        yield from certificates


def prove_runs(
    folder: Path, rules: VerifierRules, read_scene: SceneReader, mine: Callable[[int], bool]
) -> Iterator[tuple[int, list[Certificate]]]:
    """Yield (number, certificates) of each scene of an export that is `mine`, in the order of the export; at the end,
    the number of all scenes with the certificates of entries that can't be read.

    All scenes are read, and asked for in turn, since an episode's ids and texts are compared with all earlier ones.

    Raises
    ------
    InputError : the export itself can't be read
    """
    files = ExportFiles(folder)
    corpus = Corpus()
    shapes: dict[Path, Shapes] = {}

    def certificates_of(run: SceneRun, proven: bool) -> list[Certificate]:
        """Return the certificates of a scene; none if it is not to be proven."""
        certificates = [_certificate(row) for row in run.rows]
        try:
            if proven:
                scene, surfaces = read_scene(run.source, run.scene_id)
                own = shapes.setdefault(scene.root, Shapes(scene.root))
                prove_scene(run.rows, certificates, scene, surfaces, folder, rules, own)
        except InputError as error:
            for certificate in certificates:
                certificate.holds("readable", False, f"{run.source}/{run.scene_id}", str(error))
        for row, certificate in zip(run.rows, certificates, strict=True):
            corpus.check(row.manifest, row.split, certificate)
        return certificates if proven else []

    scenes = 0
    for scenes, run in enumerate(files.runs(), start=1):
        if certificates := certificates_of(run, mine(scenes - 1)):
            yield scenes - 1, certificates
    unread = []
    for entry in files.unread:
        unread.append(Certificate(entry.episode_id, "", "", entry.split))
        unread[-1].holds(entry.fact, False, entry.claimed, entry.found)
    yield scenes, unread


def prove_scene(
    rows: Sequence[Row],
    certificates: Sequence[Certificate],
    scene: Scene,
    surfaces: Surfaces,
    folder: Path,
    rules: VerifierRules,
    shapes: Shapes,
) -> None:
    """Check all episodes of one scene and record the results on their certificates.

    Raises
    ------
    InputError : a mesh of the scene, or its surfaces, can't be read
    """
    try:
        navmesh = find_navmesh(scene, folder, rows[0].manifest.navmesh)
    except InputError as error:
        _check_words(rows, certificates, SceneReferents(scene, rules.thresholds, rules.anchor_size, shapes), rules)
        for certificate in certificates:
            certificate.holds("navmesh", False, rows[0].manifest.navmesh, str(error))
        return
    obstacles = Obstacles(scene, navmesh.pathfinder, rules.agent.max_climb)
    # Structure (walls, floors) is recognised by labels only, before visibility is known.
    labels = SceneReferents(scene, rules.thresholds, rules.anchor_size, shapes)
    sight = sight_of(scene, surfaces, labels.is_structure, labels.is_frame, navmesh.pathfinder, obstacles, rules)
    onlookers = Onlookers(scene, sight, navmesh.pathfinder, rules.places, labels.hidden)
    referents = SceneReferents(scene, rules.thresholds, rules.anchor_size, shapes, onlookers.see, labels)
    _check_words(rows, certificates, referents, rules)
    for row, certificate in zip(rows, certificates, strict=True):
        check_seen(row.manifest.program, onlookers, certificate)
        claimed = (row.manifest.navmesh, row.manifest.navmesh_sha256)
        certificate.same("navmesh", claimed, (navmesh.path, navmesh.sha256))
    manifests = [row.manifest for row in rows]
    check_placement(manifests, certificates, scene, navmesh.pathfinder, obstacles, rules, walls=sight.walls)
    check_truths(manifests, [row.truth for row in rows], navmesh.pathfinder, certificates)
    check_looking_truths(manifests, [row.looking_truth for row in rows], navmesh.pathfinder, certificates)
    check_observability(manifests, certificates, sight, referents, onlookers, rules.places.eye_height)
    check_looking(manifests, certificates, navmesh.pathfinder, sight, referents, rules)


def _check_words(
    rows: Sequence[Row], certificates: Sequence[Certificate], referents: SceneReferents, rules: VerifierRules
) -> None:
    """Check the meanings of the texts, and everything that can be checked from programs and records alone."""
    for row, certificate in zip(rows, certificates, strict=True):
        check_meaning(row.manifest, referents, rules, certificate)
        check_program(row.manifest, certificate)
        check_absence(row.manifest.program, referents, rules.places, certificate)
        check_record(row.manifest, row.record, row.looking_record, certificate)


def prove_texts(
    rows: Iterable[Mapping[str, Any]],
    scene: Scene,
    rules: VerifierRules,
    shapes: Shapes,
    corpus: Corpus,
) -> list[Certificate]:
    """Return the certificate of each text of one scene without a navmesh: facts, uniqueness and wording need none.

    What does need one is on the certificate as unproven, with the reason: that objects can be seen from where an agent
    can stand, and that an agent can walk to them. Such a text has no start either, and so states no heading.

    rows : of the instructions table, with a text each
    corpus : what other scenes' texts said
    """
    referents = SceneReferents(scene, rules.thresholds, rules.anchor_size, shapes)
    certificates = []
    for row in rows:
        certificate = Certificate(row["instruction_id"], scene.family, scene.scene_id, "", kind="text")
        certificates.append(certificate)
        try:
            text = UnplacedText.of(scene.family, row)
        except ValidationError as error:
            certificate.holds("readable", False, "a row of the instructions table", error.errors()[0]["msg"])
            continue
        check_meaning(text, referents, rules, certificate)
        check_program(text, certificate)
        check_absence(text.program, referents, rules.places, certificate)
        corpus.check_text(text, certificate)
        certificate.unproven.update(UNPROVEN)
    return certificates


def find_navmesh(scene: Scene, folder: Path, claimed: str) -> Navmesh:
    """Return the navmesh of a scene: the file `claimed` below the export folder `folder` if it exists, else the navmesh
    that the source ships.

    Raises
    ------
    InputError : the file does not exist, or is not a navmesh
    """
    relative = PurePosixPath(claimed)
    if relative.is_absolute() or ".." in relative.parts:
        raise PathEscapeError(f"the navmesh {claimed!r} is outside the export", remedy="Export again")
    if (folder / relative).is_file():
        path, name = folder / relative, claimed
    elif scene.navmesh is not None:
        path, name = scene.root / scene.navmesh.path, scene.navmesh.path
    else:
        raise MissingFileError(f"neither the scene nor the export has a navmesh {claimed!r}", where=folder)
    return Navmesh(name, hashlib.sha256(read_regular(path)).hexdigest(), Pathfinder.load(path))


def _certificate(row: Row) -> Certificate:
    manifest = row.manifest
    return Certificate(manifest.episode_id, manifest.source, manifest.scene_id, row.split)
