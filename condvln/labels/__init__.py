"""The canonical vocabulary over all sources: labels, synonyms, hypernyms, nouns, room types."""

from typing import Final

from condvln.labels.lexicon import LabelEntry, RoomEntry, Vocabulary, normalise

__all__ = ["LabelEntry", "RoomEntry", "Vocabulary", "normalise", "vocabulary"]

vocabulary: Final = Vocabulary.load()
"""The vocabulary from the tables of this package, read once."""
