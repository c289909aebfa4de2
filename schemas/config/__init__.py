"""The one configuration file: its sections, each with its keys, units, defaults and bounds.

The science takes these sections as its parameters: there is no second set of defaults. A section is what one stage or
several read whole, so that a changed key makes stale what reads it and nothing else (``docs/configuration.md``).
"""

from schemas.base import Section
from schemas.config.episodes import (
    AgentConfig,
    EpisodeConfig,
    GoalsConfig,
    LookingDetour,
    PlacesConfig,
    SeenDegrees,
    StepBudget,
)
from schemas.config.instructions import (
    CompositionWeights,
    InstructionCell,
    InstructionsConfig,
    PredicateWeights,
    SamplingConfig,
    TextConfig,
    VoiceName,
    WordingConfig,
)
from schemas.config.relations import SECTOR_HALF_WIDTH, Thresholds
from schemas.config.run import (
    Config,
    Family,
    KeepConfig,
    LimitsConfig,
    RayConfig,
    SourceConfig,
    SplitsConfig,
)
from schemas.config.sensors import CameraConfig, LookerConfig, NoiseConfig
from schemas.config.trajectories import TrajectoryConfig, WalkKind

__all__ = [
    "SECTOR_HALF_WIDTH",
    "AgentConfig",
    "CameraConfig",
    "CompositionWeights",
    "Config",
    "EpisodeConfig",
    "Family",
    "GoalsConfig",
    "InstructionCell",
    "InstructionsConfig",
    "KeepConfig",
    "LimitsConfig",
    "LookerConfig",
    "LookingDetour",
    "NoiseConfig",
    "PlacesConfig",
    "PredicateWeights",
    "RayConfig",
    "SamplingConfig",
    "Section",
    "SeenDegrees",
    "SourceConfig",
    "SplitsConfig",
    "StepBudget",
    "TextConfig",
    "Thresholds",
    "TrajectoryConfig",
    "VoiceName",
    "WalkKind",
    "WordingConfig",
]
