"""Every noun that a text may hold, as a list that people have read: a new or changed one shows in the difference.

``CONDVLN_UPDATE_NOUNS=1`` (this test alone) writes the list anew.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from condvln.instructions.language import language
from condvln.labels import vocabulary

NOUNS = Path(__file__).parent / "nouns.txt"

"""Phrases that were taken out because readers stumbled over them, or read them as something else."""


def produced() -> str:
    """All nouns of objects and rooms with their articles, as texts use them."""
    words = language("en")
    lines = ["# objects"]
    lines += sorted(words.filled("{a}", noun) for noun in words.nouns.values())
    lines += ["", "# rooms"]
    lines += sorted(words.definite(noun) for noun in words.rooms.values())
    return "\n".join(lines) + "\n"


def test_the_list_of_nouns_is_the_one_that_was_read() -> None:
    if os.environ.get("CONDVLN_UPDATE_NOUNS"):
        NOUNS.write_text(produced())
    assert produced() == NOUNS.read_text(), "read the new nouns aloud, then write the list anew"


def test_every_noun_is_that_of_a_label_fit_for_text() -> None:
    words = language("en")
    assert set(words.nouns) == {label for label in vocabulary.labels if vocabulary.fit_for_text(label)}
    assert set(words.rooms) == {label for label in vocabulary.room_labels if vocabulary.room(label).fit_for_text}


def test_no_noun_is_a_raw_label() -> None:
    """No plurals, no words run together, no annotators' abbreviations."""
    for line in produced().splitlines():
        if not line or line.startswith("#"):
            continue
        _, _, noun = line.partition(" ")
        assert noun.replace("TV", "tv") == noun.lower(), noun
        last = noun.split()[-1]
        assert last == "canvas" or not re.search(r"(?<![su])s$", last), f"{noun} looks like a plural"
        assert len(max(noun.split(), key=len)) <= 12, f"{noun} looks like words run together"
        assert not re.search(r"tvm|livingr|bedr(?!oom\b)|_|\d", noun), noun
