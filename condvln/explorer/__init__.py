"""The explorer: a web page of scenes, trees, evidence, paths, statistics and agents, which opens from disk without a
server.
"""

from condvln.explorer.episode import episode_document
from condvln.explorer.plan import plan_document
from condvln.explorer.site import Site

__all__ = ["Site", "episode_document", "plan_document"]
