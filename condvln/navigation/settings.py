"""The build parameters of a navmesh, with Habitat's names and defaults."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.config import AgentConfig

__all__ = ["NavMeshSettings"]

# Tolerance of comparing settings, as in Habitat: float32 in the file against a decimal in a configuration.
SETTINGS_TOLERANCE = 1e-5


@dataclass(frozen=True)
class NavMeshSettings:
    """Build parameters of a navmesh (habitat-sim's ``NavMeshSettings``, snake case as in its Python API).

    Lengths are in metres unless another unit is given.
    """

    cell_size: float = 0.05
    """Edge of a voxel in the ground plane."""
    cell_height: float = 0.2
    """Height of a voxel."""
    agent_height: float = 1.5
    """Free height that the agent needs; rounded up to cells by the builder."""
    agent_radius: float = 0.1
    """Distance kept from walls; rounded up to cells by the builder."""
    agent_max_climb: float = 0.2
    """Highest step the agent can climb; rounded down to cells by the builder."""
    agent_max_slope: float = 45.0
    """Steepest walkable slope, degrees."""
    region_min_size: float = 20.0
    """Regions of fewer than the square of this many cells are dropped."""
    region_merge_size: float = 20.0
    """Regions of fewer than the square of this many cells are merged into neighbours."""
    edge_max_len: float = 12.0
    """Longest border edge."""
    edge_max_error: float = 1.3
    """Greatest deviation of a simplified border from the raw one, cells."""
    verts_per_poly: float = 6.0
    """Largest number of vertices of a polygon (3 to 6)."""
    detail_sample_dist: float = 6.0
    """Spacing of height samples, cells; below 0.9 no samples are taken."""
    detail_sample_max_error: float = 1.0
    """Greatest height error of the detail mesh, cells."""
    filter_low_hanging_obstacles: bool = True
    filter_ledge_spans: bool = True
    filter_walkable_low_height_spans: bool = True
    include_static_objects: bool = False
    """Static objects are obstacles."""

    @classmethod
    def furnished(cls, agent: AgentConfig) -> NavMeshSettings:
        """Return the settings for this agent, with the scene's objects as obstacles."""
        return cls(
            agent_height=agent.height,
            agent_radius=agent.radius,
            agent_max_climb=agent.max_climb,
            agent_max_slope=agent.max_slope,
            include_static_objects=True,
        )

    def fits(self, agent_radius: float, agent_height: float, climb: float, slope: float) -> bool:
        """Return whether this navmesh was built for an agent of these sizes (metres; slope in degrees)."""
        asked = (agent_radius, agent_height, climb, slope)
        own = (self.agent_radius, self.agent_height, self.agent_max_climb, self.agent_max_slope)
        return all(abs(a - b) < SETTINGS_TOLERANCE for a, b in zip(asked, own, strict=True))
