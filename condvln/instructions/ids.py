"""Names of programs: hashes of their content, the same on every machine."""

from __future__ import annotations

import hashlib

import orjson

from schemas.program import Program

__all__ = ["instruction_id", "program_key"]

ID_LENGTH = 20
"""Hexadecimal digits kept of a SHA-256: 80 bits, so that a million instructions collide with probability 4e-13."""


def program_key(program: Program) -> str:
    """SHA-256 of the program's canonical JSON, truths and witnesses included: what makes two programs distinct.

    Whether a condition is definite follows from the scene, and is left out.
    """
    document = program.model_dump(mode="json", exclude={"conditions": {"__all__": {"definite"}}})
    text = orjson.dumps(document, option=orjson.OPT_SORT_KEYS)
    return hashlib.sha256(text).hexdigest()


def instruction_id(family: str, scene_id: str, program: Program) -> str:
    """Id of one program in one scene."""
    key = f"{family}\x1f{scene_id}\x1f{program_key(program)}"
    return hashlib.sha256(key.encode()).hexdigest()[:ID_LENGTH]
