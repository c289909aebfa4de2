"""What a build was configured to keep to: the numbers that its episodes are held against."""

from __future__ import annotations

from dataclasses import dataclass, field

from schemas.config import AgentConfig, Config, EpisodeConfig, Thresholds

__all__ = ["Rules"]


@dataclass(frozen=True, slots=True)
class Rules:
    """The parts of a configuration that decide whether an episode is sound."""

    thresholds: Thresholds = field(default_factory=Thresholds)
    episodes: EpisodeConfig = field(default_factory=EpisodeConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    preamble: bool = True

    @property
    def path_spacing(self) -> float:
        """Metres between two ground-truth locations at most."""
        return self.episodes.path_spacing

    @classmethod
    def of(cls, config: Config) -> Rules:
        """The rules of a run."""
        return cls(config.thresholds, config.episodes, config.agent, config.instructions.preamble)
