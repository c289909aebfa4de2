"""The stages of a scene: each wraps functions of `condvln` for the factory.

scene → counts → relations → visibility → episodes → text. What a stage computes is decided in ``condvln``;
here is only what it reads, what it is keyed on, and where its rows go. A change of what a stage makes
for equal inputs must raise its ``version``; a golden test holds that.
"""

from jobs.stages.episodes import EpisodeStage, TextStage
from jobs.stages.scene import CountStage, PriorsAggregate, RelationStage, SceneStage, VisibilityStage

__all__ = [
    "CountStage",
    "EpisodeStage",
    "PriorsAggregate",
    "RelationStage",
    "SceneStage",
    "TextStage",
    "VisibilityStage",
]
