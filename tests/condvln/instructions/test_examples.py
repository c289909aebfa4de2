"""The examples of README and docs are what the renderer says today.

Their programs come from made scenes and are kept here. ``CONDVLN_UPDATE_EXAMPLES=1`` (this file alone) writes the texts
again; read them aloud before you commit.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from condvln.instructions import names_compass, parse, reading_of, render, with_preamble
from condvln.instructions.rendering import heading_name
from schemas.program import CATEGORIES, Program

PROGRAMS = Path(__file__).parent / "example_programs.json"
SEED = 14
BLOCK = re.compile(r"(<!-- examples: (\w+) -->\n)(.*?)(<!-- /examples -->)", re.DOTALL)


def examples() -> list[dict[str, Any]]:
    return json.loads(PROGRAMS.read_text())


def said(example: dict[str, Any], code: str) -> str:
    program, name = Program.model_validate(example["program"]), example["instruction_id"]
    text = render(program, SEED, name, code)
    return with_preamble(text, example["heading"], SEED, name, code) if names_compass(program) else text


def block(code: str) -> str:
    """The lines of all examples in one language."""
    return "".join(f"* {example['program']['category']}: *{said(example, code)}*\n" for example in examples())


@pytest.mark.parametrize(("page", "codes"), [("README.md", ["en"]), ("docs/language.md", ["en", "es"])])
def test_the_examples_are_what_the_renderer_says(repository: Path, page: str, codes: list[str]) -> None:
    path = repository / page
    if os.environ.get("CONDVLN_UPDATE_EXAMPLES"):
        path.write_text(BLOCK.sub(lambda m: f"{m[1]}{block(m[2])}{m[4]}", path.read_text()))
    found = BLOCK.findall(path.read_text())
    assert [code for _, code, _, _ in found] == codes
    for _, code, lines, _ in found:
        assert lines == block(code)


@pytest.mark.parametrize("code", ["en", "es"])
def test_there_is_a_sound_one_of_each_category(code: str) -> None:
    assert [example["program"]["category"] for example in examples()] == list(CATEGORIES)
    for example in examples():
        program = Program.model_validate(example["program"])
        heading = heading_name(example["heading"]) if names_compass(program) else None
        assert parse(said(example, code), code) == reading_of(program, heading)
