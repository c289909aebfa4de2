"""The agent `looker`: reads the text with the grammar, sees with cameras, builds its own map; it uses no ground
truth.
"""

from condvln.evaluation.looker.looker import Looker, read_text
from condvln.evaluation.looker.walking import LookerWalk, LookingAgent

__all__ = ["Looker", "LookerWalk", "LookingAgent", "read_text"]
