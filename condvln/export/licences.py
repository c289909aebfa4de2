"""What each source allows. An export holds text and coordinates derived from it, never its meshes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

__all__ = ["SOURCES", "SourceLicence", "composed_sources"]


class SourceLicence(NamedTuple):
    """Terms of one source dataset.

    composed : its scenes come in parts, which the terms let a user put together on a disk of his own; a scan is one
        file already, and its users agree to terms with its owner
    """

    name: str
    terms: str
    credit: str
    composed: bool = False


SOURCES: Final[dict[str, SourceLicence]] = {
    "replicacad": SourceLicence(
        "ReplicaCAD",
        "Creative Commons Attribution 4.0 (some object models non-commercial)",
        "Szot et al., Habitat 2.0: Training Home Assistants to Rearrange their Habitat, NeurIPS 2021",
        composed=True,
    ),
    "mp3d": SourceLicence(
        "Matterport3D",
        "Matterport3D terms of use (non-commercial academic use; each user agrees to them with Matterport)",
        "Chang et al., Matterport3D: Learning from RGB-D Data in Indoor Environments, 3DV 2017",
    ),
    "gibson": SourceLicence(
        "Gibson and 3D Scene Graph",
        "Gibson database licence (non-commercial research) and 3DSceneGraph's terms",
        "Xia et al., Gibson Env, CVPR 2018; Armeni et al., 3D Scene Graph, ICCV 2019",
    ),
    "procthor": SourceLicence(
        "ProcTHOR-10K",
        "Apache-2.0 (asset database); the houses state none",
        "Deitke et al., ProcTHOR: Large-Scale Embodied AI Using Procedural Generation, NeurIPS 2022",
        composed=True,
    ),
    "ithor": SourceLicence(
        "AI2-THOR (iTHOR)",
        "Apache-2.0",
        "Kolve et al., AI2-THOR: An Interactive 3D Environment for Visual AI, 2017",
        composed=True,
    ),
    "robothor": SourceLicence(
        "RoboTHOR",
        "Apache-2.0",
        "Deitke et al., RoboTHOR: An Open Simulation-to-Real Embodied AI Platform, CVPR 2020",
        composed=True,
    ),
}
"""By family."""


def composed_sources(scenes: Iterable[str]) -> list[str]:
    """Names of the datasets that some scenes (``<family>/<scene>``) are of and that ``condvln compose`` puts together,
    sorted by family."""
    families = sorted({scene.partition("/")[0] for scene in scenes})
    return [SOURCES[family].name for family in families if family in SOURCES and SOURCES[family].composed]
