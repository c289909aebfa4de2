"""Register the environment with gymnasium."""

from __future__ import annotations

from typing import Final

from schemas.errors import UsageError

__all__ = ["ENVIRONMENT_ID", "register_environments"]

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
