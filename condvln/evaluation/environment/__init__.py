"""Episodes as a gymnasium environment with rendered cameras, without a simulator; needs the extra ``gym``.

``gymnasium.make("condvln/VLN-v0", export=…, split=…)`` works once this package is imported or condvln is installed.
"""

from condvln.evaluation.environment.navigation_env import NavigationEnv
from condvln.evaluation.environment.registration import ENVIRONMENT_ID, register_environments
from condvln.evaluation.scene_views import SceneViews

__all__ = ["ENVIRONMENT_ID", "NavigationEnv", "SceneViews", "register_environments"]

register_environments()
