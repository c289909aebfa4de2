"""Episodes to step through: as a gymnasium environment with rendered cameras (extra ``gym``), as tools for language
agents, as an OpenEnv server (extra ``openenv``) and as an inspect-ai task (extra ``inspect``); no simulator is needed.

``gymnasium.make("condvln/VLN-v0", export=…, split=…)`` works once this package is imported, or condvln after gymnasium.
``gymnasium.make("condvln.evaluation.environment:condvln/VLN-v0", …)`` imports it and works always.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

from schemas.errors import UsageError

if TYPE_CHECKING:
    from condvln.evaluation.environment.navigation_env import NavigationEnv
    from condvln.evaluation.scene_views import SceneViews

__all__ = ["ENVIRONMENT_ID", "NavigationEnv", "SceneViews", "register_environments"]

ENVIRONMENT_ID: Final = "condvln/VLN-v0"


def register_environments() -> None:
    """Register `ENVIRONMENT_ID` for ``gymnasium.make``; a second call has no effect.

    Raises
    ------
    UsageError : gymnasium is not installed
    """
    try:
        import gymnasium
    except ImportError as error:
        raise UsageError("gymnasium is not installed", remedy="Install condvln[gym]") from error
    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(ENVIRONMENT_ID, "condvln.evaluation.environment.navigation_env:NavigationEnv")


def __getattr__(name: str) -> object:
    # Loaded when first used: importing condvln after gymnasium registers the environment and must stay cheap.
    if name == "NavigationEnv":
        from condvln.evaluation.environment.navigation_env import NavigationEnv

        return NavigationEnv
    if name == "SceneViews":
        from condvln.evaluation.scene_views import SceneViews

        return SceneViews
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


with suppress(UsageError):  # the tools need no gymnasium
    register_environments()
