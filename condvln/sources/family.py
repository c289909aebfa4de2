"""Facts about each family of datasets, independent of its reader: names, terms, official splits, scene paths, and the
kinds of files on its download pages.

A new family is an entry in ``families.yaml``, a reader in ``registry``, its downloads in ``downloads.csv``, its raw
labels in ``condvln.labels``, and its name in ``schemas.config.Family``; ``CONTRIBUTING.md`` has the steps.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Final, Literal

import orjson
import yaml

from condvln.own_tables import own_rows, own_text

__all__ = [
    "FAMILIES",
    "Download",
    "Family",
    "Found",
    "SplitGroup",
    "composed_datasets",
    "downloads",
    "look_for",
]

SplitGroup = Literal["train", "val_unseen", "test"]
"""A group of scenes; the group train holds the splits train and val_seen."""

_GROUPS: Final[tuple[SplitGroup, ...]] = ("train", "val_unseen", "test")


def _unlisted(scene_id: str) -> SplitGroup | None:
    return None


@dataclass(frozen=True, slots=True)
class Family:
    """A family of datasets.

    name : the dataset's name as its authors write it
    terms, credit : licence terms, and the citation
    composed : its scenes consist of several files, which the terms allow a user to combine on their own disk; a scan is
        a single file, and its users accept terms with its owner
    official_split : returns a scene's group from the authors' lists; None if there are none
    scene_file : ``scene_id`` of a VLN-CE episode below the folder of scene datasets; ``{scene}`` is the scene's id,
        ``{name}`` the id without its folder, ``{scan}`` the part of the name after its first hyphen
    scene_form : form of a scene's id, for messages that tell where a file of this family is
    always_placed : every scene gets a navmesh, built from its walls or its reachable positions
    costs_like : the family whose measured costs are used for first estimates
    licensed : the terms forbid to pass on images of its scenes; each user gets a copy from the owner
    """

    name: str
    terms: str
    credit: str
    composed: bool = False
    official_split: Callable[[str], SplitGroup | None] = _unlisted
    scene_file: str = "{family}/{scene}/{name}.glb"
    scene_form: str = "<scene>"
    always_placed: bool = False
    costs_like: str | None = None
    licensed: bool = False


@cache
def _list_of(family: str) -> dict[str, SplitGroup]:
    lists = orjson.loads(own_text("condvln.sources", f"official/{family}.json"))
    return {scene: group for group in _GROUPS for scene in lists[group].split()}


def _listed(family: str, scene_id: str) -> SplitGroup | None:
    # Gibson's buildings are in folders by kind of annotation; the official list names buildings only.
    return _list_of(family).get(posixpath.basename(scene_id))


_ITHOR: Final = re.compile(r"FloorPlan(\d{1,3})(?:_physics)?$")


def _ithor_split(scene_id: str) -> SplitGroup | None:
    # Floor plans 1-30 are kitchens; 201-230, 301-330 and 401-430 the other room types. In each range, 1-20 are train,
    # 21-25 val, 26-30 test.
    found = _ITHOR.match(scene_id)
    if found is None:
        return None
    within = int(found[1]) % 100
    return "train" if within <= 20 else "val_unseen" if within <= 25 else "test"


_ROBOTHOR: Final = re.compile(r"FloorPlan_(Train|Val|Test)", re.IGNORECASE)


def _robothor_split(scene_id: str) -> SplitGroup | None:
    found = _ROBOTHOR.match(scene_id)
    groups: dict[str, SplitGroup] = {"train": "train", "val": "val_unseen", "test": "test"}
    return None if found is None else groups[found[1].lower()]


_REPLICACAD: Final = re.compile(r"v3_sc(\d+)_staging_(\d+)$|apt_\d+$")
_FIRST_TEST_STAGING: Final = 11


def _replicacad_split(scene_id: str) -> SplitGroup | None:
    # A base layout sc0, sc1 … has 21 stagings. Many copies of the dataset contain only sc0, sc1 and the apartments,
    # which would leave three scenes for test; so the later stagings of sc1 are for test too. No train layout is in
    # another split.
    found = _REPLICACAD.match(scene_id)
    if found is None:
        return None
    layout, staging = found[1], int(found[2] or 0)
    if layout in ("0", "2"):
        return "train"
    return "val_unseen" if layout == "1" and staging < _FIRST_TEST_STAGING else "test"


_HM3D: Final = re.compile(r"(\d{5})-\w+$")


def _hm3d_split(scene_id: str) -> SplitGroup | None:
    # Scans 0 to 799 are train, 800 to 899 val, 900 to 999 test; the folders minival and example hold scans of val.
    found = _HM3D.match(posixpath.basename(scene_id))
    if found is None:
        return None
    number = int(found[1])
    return "train" if number < 800 else "val_unseen" if number < 900 else "test"


_SPLITS: Final[dict[str, Callable[[str], SplitGroup | None]]] = {
    "gibson": partial(_listed, "gibson"),
    "hm3d": _hm3d_split,
    "ithor": _ithor_split,
    "mp3d": partial(_listed, "mp3d"),
    "replicacad": _replicacad_split,
    "robothor": _robothor_split,
}


def _families() -> dict[str, Family]:
    known = yaml.safe_load(own_text("condvln.sources", "families.yaml"))
    return {family: Family(**facts, official_split=_SPLITS.get(family, _unlisted)) for family, facts in known.items()}


FAMILIES: Final = _families()
"""All families by the name used in configurations and tables."""


def composed_datasets(scenes: Iterable[str]) -> list[str]:
    """Return the names of the datasets to which the given scenes (``<family>/<scene>``) belong, sorted by family.
    Datasets that the command ``compose`` does not combine are left out.
    """
    families = sorted({scene.partition("/")[0] for scene in scenes})
    return [FAMILIES[family].name for family in families if family in FAMILIES and FAMILIES[family].composed]


HABITAT_PROCTHOR: Final = "ai2thor-hab"
"""The name of Habitat's form of ProcTHOR in the table; it is not a family of its own."""

MAX_COUNTED: Final = 1_000_000
"""Largest number of files counted of one kind, so that a search in a wrong folder ends."""


@dataclass(frozen=True, slots=True)
class Download:
    """One kind of file in a dataset.

    patterns : globs relative to the dataset's folder; one match is enough
    need : without ``required`` files nothing can be read; ``optional`` files add information
    holds : content of the files, and the effect if they are missing
    source : its name on the download page
    licence : the terms to accept before downloading
    """

    family: str
    patterns: tuple[str, ...]
    need: Literal["required", "optional"]
    holds: str
    source: str
    licence: str


@dataclass(frozen=True, slots=True)
class Found:
    """How many files of one kind a folder holds."""

    download: Download
    files: int


@cache
def downloads(family: str) -> tuple[Download, ...]:
    """Return the kinds of files of a family, the required ones first."""
    found = [
        Download(
            family=row["family"],
            patterns=tuple(row["patterns"].split(";")),
            need="required" if row["need"] == "required" else "optional",
            holds=row["holds"],
            source=row["from"],
            licence=row["licence"],
        )
        for row in own_rows("condvln.sources", "downloads.csv")
        if row["family"] == family
    ]
    return tuple(sorted(found, key=lambda d: d.need != "required"))


def look_for(family: str, root: Path, houses: Path | None = None) -> list[Found]:
    """Return, for each kind of file of a family's dataset, how many of the files are in a folder; no file is opened.

    houses : the folder of the house JSON, if `root` holds Habitat's ProcTHOR scenes
    """
    if houses is not None:
        return [*look_for(HABITAT_PROCTHOR, root), *_look(downloads("procthor")[:1], houses)]
    return _look(downloads(family), root)


def _look(kinds: tuple[Download, ...], root: Path) -> list[Found]:
    found = []
    for download in kinds:
        paths = {path for pattern in download.patterns for path in islice(root.glob(pattern), MAX_COUNTED)}
        found.append(Found(download, len(paths)))
    return found
