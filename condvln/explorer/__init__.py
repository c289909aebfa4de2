"""The page that shows scenes, trees, evidence, paths, statistics and agents; it opens from a disk without a server."""

from condvln.explorer.episode import episode_document
from condvln.explorer.plan import plan_document
from condvln.explorer.site import Site

__all__ = ["Site", "episode_document", "plan_document"]
