"""CondVLN in Python: from a scene's files to conditional instructions, episodes and an agent's score.

``import condvln as cv`` is fast: each name is loaded when it is first used. ``docs/tutorial.md`` shows
all of them.

========================  ==============================================================================================
Scenes                    ``make_samples`` ``open_source`` ``open_world`` ``World`` ``Scene``
Relations                 ``World.relation_graph`` ``relate_scene`` ``Thresholds``
Instructions              ``Program`` ``parse`` ``render`` ``program_tree`` ``label_priors`` ``InstructionsConfig``
Navigation                ``Pathfinder`` ``NavMeshSettings`` ``Follower`` ``AgentConfig``
Cameras                   ``World.look`` ``open_renderer`` ``Renderer`` ``CameraConfig`` ``cameras_of`` ``TextSensor``
Episodes                  ``World.episodes`` ``ManifestEpisode`` ``open_export`` ``Export`` ``read_manifest``
Agents and scores         ``task_of`` ``walk`` ``Observation`` ``Policy`` ``Prediction`` ``score`` ``evaluate``
Checks                    ``judge_export`` (bias gate) ``prove_export`` (independent proof)
========================  ==============================================================================================
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from condvln.bias import judge_export
    from condvln.evaluation.agents import AGENTS, agent_named
    from condvln.evaluation.evaluate import Evaluation, evaluate
    from condvln.evaluation.predictions import Prediction, read_predictions, write_predictions
    from condvln.evaluation.score import Score, ScoreRules, score
    from condvln.evaluation.split import Export, open_export
    from condvln.evaluation.task import Task, task_of
    from condvln.evaluation.walker import Observation, Policy, walk
    from condvln.instructions import LabelPriors, parse, render
    from condvln.instructions.programs import program_tree
    from condvln.labels import vocabulary
    from condvln.manifest import read_manifest
    from condvln.navigation.follower import Follower
    from condvln.navigation.navmesh_file import read_navmesh
    from condvln.navigation.pathfinder import Pathfinder
    from condvln.navigation.recast import build_navmesh
    from condvln.navigation.settings import NavMeshSettings
    from condvln.relations import relate_scene
    from condvln.samples import make_samples
    from condvln.scene import Room, Scene, SceneObject
    from condvln.sensors import Renderer, TextSensor, cameras_of, open_renderer
    from condvln.sources.registry import open_source
    from condvln.verify import prove_export
    from condvln.world import World, label_priors, open_world
    from schemas.config import AgentConfig, CameraConfig, Config, InstructionsConfig, SamplingConfig, Thresholds
    from schemas.errors import CondVLNError
    from schemas.evaluation import ManifestEpisode
    from schemas.program import Program

__all__ = [
    "AGENTS",
    "AgentConfig",
    "CameraConfig",
    "CondVLNError",
    "Config",
    "Evaluation",
    "Export",
    "Follower",
    "InstructionsConfig",
    "LabelPriors",
    "ManifestEpisode",
    "NavMeshSettings",
    "Observation",
    "Pathfinder",
    "Policy",
    "Prediction",
    "Program",
    "Renderer",
    "Room",
    "SamplingConfig",
    "Scene",
    "SceneObject",
    "Score",
    "ScoreRules",
    "Task",
    "TextSensor",
    "Thresholds",
    "World",
    "agent_named",
    "build_navmesh",
    "cameras_of",
    "evaluate",
    "judge_export",
    "label_priors",
    "make_samples",
    "open_export",
    "open_renderer",
    "open_source",
    "open_world",
    "parse",
    "program_tree",
    "prove_export",
    "read_manifest",
    "read_navmesh",
    "read_predictions",
    "relate_scene",
    "render",
    "score",
    "task_of",
    "vocabulary",
    "walk",
    "write_predictions",
]

_MODULES = {
    "condvln.bias": ("judge_export",),
    "condvln.evaluation.agents": ("AGENTS", "agent_named"),
    "condvln.evaluation.evaluate": ("Evaluation", "evaluate"),
    "condvln.evaluation.split": ("Export", "open_export"),
    "condvln.evaluation.predictions": ("Prediction", "read_predictions", "write_predictions"),
    "condvln.evaluation.score": ("Score", "ScoreRules", "score"),
    "condvln.evaluation.task": ("Task", "task_of"),
    "condvln.evaluation.walker": ("Observation", "Policy", "walk"),
    "condvln.instructions": ("LabelPriors", "parse", "render"),
    "condvln.instructions.programs": ("program_tree",),
    "condvln.labels": ("vocabulary",),
    "condvln.manifest": ("read_manifest",),
    "condvln.navigation.follower": ("Follower",),
    "condvln.navigation.navmesh_file": ("read_navmesh",),
    "condvln.navigation.pathfinder": ("Pathfinder",),
    "condvln.navigation.recast": ("build_navmesh",),
    "condvln.navigation.settings": ("NavMeshSettings",),
    "condvln.relations": ("relate_scene",),
    "condvln.samples": ("make_samples",),
    "condvln.scene": ("Room", "Scene", "SceneObject"),
    "condvln.sensors": ("Renderer", "TextSensor", "cameras_of", "open_renderer"),
    "condvln.sources.registry": ("open_source",),
    "condvln.verify": ("prove_export",),
    "condvln.world": ("World", "label_priors", "open_world"),
    "schemas.config": ("AgentConfig", "CameraConfig", "Config", "InstructionsConfig", "SamplingConfig", "Thresholds"),
    "schemas.errors": ("CondVLNError",),
    "schemas.evaluation": ("ManifestEpisode",),
    "schemas.program": ("Program",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


# gymnasium 1.0 and later load no plugins. One that is loaded already learns of our environment here; it is never loaded
# for this, so that importing condvln stays cheap.
if "gymnasium" in sys.modules:
    import_module("condvln.evaluation.environment")
