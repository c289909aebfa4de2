"""Facts about each family of datasets, independent of its reader: names, terms, official splits, scene paths.

A new family is an entry here, a reader in ``registry``, its downloads in ``downloads.csv``, its raw labels in
``condvln.labels``, and its name in ``schemas.config.Family``; ``CONTRIBUTING.md`` has the steps.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from typing import Final, Literal

import orjson

__all__ = ["FAMILIES", "Family", "SplitGroup", "composed_datasets"]

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
    lists = orjson.loads((resources.files("condvln.sources") / "official" / f"{family}.json").read_bytes())
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


FAMILIES: Final[dict[str, Family]] = {
    "gibson": Family(
        "Gibson and 3D Scene Graph",
        "Gibson database licence (non-commercial research) and 3DSceneGraph's terms",
        "Xia et al., Gibson Env, CVPR 2018; Armeni et al., 3D Scene Graph, ICCV 2019",
        official_split=partial(_listed, "gibson"),
        # The verified and the automated annotation of a building refer to the same mesh.
        scene_file="{family}/{name}/{name}.glb",
        licensed=True,
    ),
    "hm3d": Family(
        "Habitat-Matterport 3D with semantics (HM3DSem)",
        "Matterport's terms for academic use of model data (non-commercial; each user agrees to them with Matterport)",
        "Ramakrishnan et al., Habitat-Matterport 3D Dataset (HM3D), NeurIPS Datasets and Benchmarks 2021; Yadav et "
        "al., Habitat-Matterport 3D Semantics Dataset, CVPR 2023",
        official_split=_hm3d_split,
        scene_file="{family}/{scene}/{scan}.basis.glb",
        scene_form="<split>/<number>-<scan>",
        costs_like="gibson",
        licensed=True,
    ),
    "hssd": Family(
        "Habitat Synthetic Scenes Dataset (HSSD)",
        "Creative Commons Attribution-NonCommercial 4.0",
        "Khanna et al., Habitat Synthetic Scenes Dataset (HSSD-200), CVPR 2024",
        composed=True,
        costs_like="replicacad",
    ),
    "ithor": Family(
        "AI2-THOR (iTHOR)",
        "Apache-2.0",
        "Kolve et al., AI2-THOR: An Interactive 3D Environment for Visual AI, 2017",
        composed=True,
        official_split=_ithor_split,
        always_placed=True,
    ),
    "mp3d": Family(
        "Matterport3D",
        "Matterport3D terms of use (non-commercial academic use; each user agrees to them with Matterport)",
        "Chang et al., Matterport3D: Learning from RGB-D Data in Indoor Environments, 3DV 2017",
        official_split=partial(_listed, "mp3d"),
        costs_like="gibson",
        licensed=True,
    ),
    "procthor": Family(
        "ProcTHOR-10K",
        "Apache-2.0 (asset database); the houses state none",
        "Deitke et al., ProcTHOR: Large-Scale Embodied AI Using Procedural Generation, NeurIPS 2022",
        composed=True,
        always_placed=True,
    ),
    "replicacad": Family(
        "ReplicaCAD",
        "Creative Commons Attribution 4.0 (some object models non-commercial)",
        "Szot et al., Habitat 2.0: Training Home Assistants to Rearrange their Habitat, NeurIPS 2021",
        composed=True,
        official_split=_replicacad_split,
    ),
    "robothor": Family(
        "RoboTHOR",
        "Apache-2.0",
        "Deitke et al., RoboTHOR: An Open Simulation-to-Real Embodied AI Platform, CVPR 2020",
        composed=True,
        official_split=_robothor_split,
        always_placed=True,
        costs_like="ithor",
    ),
}
"""All families by the name used in configurations and tables."""


def composed_datasets(scenes: Iterable[str]) -> list[str]:
    """Return the names of the datasets to which the given scenes (``<family>/<scene>``) belong, sorted by family.
    Datasets that the command ``compose`` does not combine are left out.
    """
    families = sorted({scene.partition("/")[0] for scene in scenes})
    return [FAMILIES[family].name for family in families if family in FAMILIES and FAMILIES[family].composed]
