"""An agent that looks: the grammar's reader, eyes, a map of its own, and no oracle."""

from condvln.evaluation.looker.looker import Looker, read_text
from condvln.evaluation.looker.walking import LookerWalk, LookingAgent

__all__ = ["Looker", "LookerWalk", "LookingAgent", "read_text"]
