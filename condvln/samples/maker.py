"""``make_samples``: write whole datasets of generated apartments, so that everything runs without a download."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from condvln.formats.streams import atomic_path
from condvln.samples.ai2thor_hab import HOUSES, SCENES, ai2thor_hab_files
from condvln.samples.apartment import make_layout
from condvln.samples.floor_mesh import NavmeshEngine
from condvln.samples.floor_plan import MAX_ROOMS, MIN_ROOMS
from condvln.samples.gibson import gibson_files
from condvln.samples.hm3d import hm3d_files
from condvln.samples.hssd import hssd_files
from condvln.samples.layout import Layout
from condvln.samples.mp3d import mp3d_files
from condvln.samples.procthor import procthor_files
from condvln.samples.replicacad import replicacad_files
from condvln.samples.thor_metadata import ithor_files, robothor_files
from condvln.seeding import stable_hash
from schemas.errors import UsageError

__all__ = [
    "FAMILIES",
    "FORMS",
    "SampleReport",
    "make_layouts",
    "make_samples",
    "write_ai2thor_hab",
    "write_replicacad",
]

Writer = Callable[[Mapping[str, Layout]], Iterator[tuple[str, bytes]]]

FAMILIES: Final[dict[str, Writer]] = {
    "gibson": gibson_files,
    "hm3d": hm3d_files,
    "hssd": hssd_files,
    "ithor": ithor_files,
    "mp3d": mp3d_files,
    "procthor": procthor_files,
    "replicacad": replicacad_files,
    "robothor": robothor_files,
}
"""Writers by source family: from layouts by scene name to files by path."""

HABITAT_PROCTHOR: Final = "ai2thor-hab"
FORMS: Final[dict[str, Writer]] = {**FAMILIES, HABITAT_PROCTHOR: ai2thor_hab_files}
"""Writers of everything that can be generated: the families, and Habitat's form of ProcTHOR, which is of family
procthor.
"""

SEED_BITS: Final = 63


@dataclass(frozen=True, slots=True)
class SampleReport:
    """What was written: the scenes' names, and the total numbers of rooms, objects, files and bytes.

    family : the source family that reads the files
    parts : folders to enter under ``sources`` in a configuration, by key, such as ``root``
    """

    folder: Path
    family: str
    parts: Mapping[str, Path]
    scenes: tuple[str, ...]
    rooms: int
    objects: int
    files: int
    bytes: int


def make_layouts(scenes: int, seed: int) -> dict[str, Layout]:
    """Return layouts by scene name, ``made_000`` and so on. Scene k of a seed is the same for any number of scenes and
    any family.
    """
    return {
        f"made_{k:03d}": make_layout(stable_hash("sample", seed, k) >> (256 - SEED_BITS), _n_rooms(seed, k))
        for k in range(scenes)
    }


def make_samples(
    folder: str | os.PathLike[str], family: str = "replicacad", scenes: int = 12, seed: int = 0
) -> SampleReport:
    """Write `scenes` generated apartments to `folder` in the native format of `family`, which is any key of `FORMS`: a
    source family or ``ai2thor-hab``.

    The bytes depend only on (family, scenes, seed). A folder that already holds the same files is unchanged.

    Raises
    ------
    UsageError : the family is unknown, `scenes` is below 1, or the folder holds other files
    """
    if family not in FORMS:
        known = ", ".join(sorted(FORMS))
        raise UsageError(
            f"no samples can be made for the family {family!r}", place="family", remedy=f"Choose one of: {known}."
        )
    if scenes < 1:
        raise UsageError(
            f"the number of scenes must be positive, got {scenes}", place="scenes", remedy="Ask for at least one."
        )
    layouts = make_layouts(scenes, seed)
    return _write(Path(folder), family, layouts, FORMS[family](layouts))


def write_replicacad(folder: Path, layouts: Mapping[str, Layout], navmesh: NavmeshEngine = "polygons") -> SampleReport:
    """Write `layouts`, which are keyed by scene name, as a ReplicaCAD dataset. Raises the errors of `make_samples`."""
    return _write(folder, "replicacad", layouts, replicacad_files(layouts, navmesh))


def write_ai2thor_hab(folder: Path, layouts: Mapping[str, Layout]) -> SampleReport:
    """Write `layouts` in Habitat's form of ProcTHOR: the scene dataset to ``hab/``, the houses to ``houses/``. Raises
    the errors of `make_samples`.
    """
    return _write(folder, HABITAT_PROCTHOR, layouts, ai2thor_hab_files(layouts))


def _n_rooms(seed: int, k: int) -> int:
    """Return the number of rooms of scene k. In each block of seven scenes (0–6, 7–13, …), every number from two to
    eight occurs once, in random order.
    """
    sizes = list(range(MIN_ROOMS, MAX_ROOMS + 1))
    random.Random(f"sizes/{seed}/{k // len(sizes)}").shuffle(sizes)
    return sizes[k % len(sizes)]


def _write(
    folder: Path, form: str, layouts: Mapping[str, Layout], content_of: Iterator[tuple[str, bytes]]
) -> SampleReport:
    files = {folder / path: content for path, content in content_of}
    # Nothing is written before all existing files were checked.
    there = {file for file in files if file.exists()}
    for file in sorted(there):
        if not file.is_file() or file.read_bytes() != files[file]:
            raise UsageError("the folder holds another dataset", where=file, remedy="Give an empty or a new folder.")
    for file, content in files.items():
        if file not in there:
            with atomic_path(file, durable=False) as part:
                part.write_bytes(content)
    joined = form == HABITAT_PROCTHOR
    return SampleReport(
        folder=folder,
        family="procthor" if joined else form,
        parts={"root": folder / SCENES, "houses": folder / HOUSES} if joined else {"root": folder},
        scenes=tuple(layouts),
        rooms=sum(len(layout.rooms) for layout in layouts.values()),
        objects=sum(len(layout.furniture) for layout in layouts.values()),
        files=len(files),
        bytes=sum(map(len, files.values())),
    )
