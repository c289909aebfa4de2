"""Keys of stages: the hash of everything that a stage's output depends on.

A key is made of four parts, so that a plan can say which one changed:

code : the stage's name and version, the major schema version, the schemas of the tables it publishes
inputs : the unit's files (path, size, SHA-256) for the first stage and those with ``reads_inputs``; for the others the
    logical hashes of the upstream tables they read, so that an upstream stage that ran again and gave the same rows
    makes nothing stale (early cut-off)
parameters : what ``Stage.parameters`` returns
dependencies : what ``Stage.dependencies`` returns, for stages that need shared tables

The unit's id is in the key too: rows carry it, and two units of the same bytes must not fall together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from factory.pipeline import Pipeline
from factory.rows import schema_hash
from factory.unit import Unit
from schemas.canonical import JSON, canonical_json

__all__ = ["Keyer", "StageKey"]


def _hash(value: JSON) -> bytes:
    return hashlib.sha256(canonical_json(value)).digest()[:16]


@dataclass(frozen=True, slots=True)
class StageKey:
    """The key of one stage of one unit, and the parts that it is computed from; key and parts have 16 bytes each."""

    key: bytes
    code: bytes
    inputs: bytes
    parameters: bytes
    dependencies: bytes

    @property
    def hex(self) -> str:
        """Return the key in hexadecimal, as the store names it."""
        return self.key.hex()


class Keyer:
    """Computes the keys of all stages of one pipeline, and caches what is the same for all units."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._code = [self._code_of(at) for at in range(len(pipeline.stages))]
        self._remembered: list[tuple[JSON, bytes] | None] = [None] * len(pipeline.stages)
        self._inputs: tuple[Unit | None, bytes] = (None, b"")
        self._none = _hash(None)

    def _code_of(self, at: int) -> bytes:
        stage = self._pipeline.stages[at]
        schemas = {name: schema_hash(spec.schema) for name, spec in self._pipeline.stage_tables(stage) if spec}
        major = self._pipeline.schema_version.split(".")[0]
        return _hash({"stage": stage.name, "version": stage.version, "schema": major, "tables": schemas})

    def code(self, at: int) -> bytes:
        """Return the code part of the key of the stage at position ``at``."""
        return self._code[at]

    def reads_inputs(self, at: int) -> bool:
        """Whether the key of the stage at position ``at`` covers the unit's files."""
        return at == 0 or self._pipeline.stages[at].reads_inputs

    def inputs(self, unit: Unit) -> bytes:
        """Hash the unit's files. The hash is cached for the stages of the unit, which follow each other."""
        if self._inputs[0] is not unit:
            self._inputs = (unit, _hash(sorted((file.path, file.size, file.sha256) for file in unit.inputs)))
        return self._inputs[1]

    def content(self, unit: Unit) -> bytes:
        """Hash the bytes of the unit's files without their paths, so that the hash stays the same when a unit is
        renamed.
        """
        return _hash(sorted((file.size, file.sha256) for file in unit.inputs))

    def parameters(self, unit: Unit, at: int) -> bytes:
        """Hash the parameters of the stage at position ``at``. The hash is cached as long as the stage returns the same
        object.
        """
        value = self._pipeline.stages[at].parameters(unit)
        known = self._remembered[at]
        if known is not None and known[0] is value:
            return known[1]
        found = _hash(value)
        self._remembered[at] = (value, found)
        return found

    def fingerprint(self, unit: Unit, shared: Mapping[str, str], stages: int | None = None) -> bytes:
        """Hash everything that the unit's whole chain of stages can depend on. The content of shared tables enters by
        their hashes, given by name in ``shared``.

        Equal fingerprints mean equal keys of every stage, by purity; nothing needs to be read to know it. The converse
        does not hold: a changed shared table may leave every key as it was. A shared table that is not pinned yet makes
        a fingerprint that equals no earlier one.
        """
        count = len(self._pipeline.stages) if stages is None else stages
        state = hashlib.sha256()
        # Each part has a fixed length or is framed by its own, so that no two chains feed the same bytes.
        for text in (unit.unit_id, unit.partition):
            data = text.encode("utf-8", "surrogatepass")
            state.update(len(data).to_bytes(4, "little") + data)
        state.update(self.inputs(unit))
        for at, stage in enumerate(self._pipeline.stages[:count]):
            state.update(b"\1" + self._code[at] + self.parameters(unit, at) + bytes([self.reads_inputs(at)]))
            for need in stage.needs:
                state.update(b"\2" + bytes.fromhex(shared.get(need, "")))
        return state.digest()[:16]

    def key(self, unit: Unit, at: int, upstream: Mapping[str, str], dependencies: JSON) -> StageKey:
        """Compute the key of the stage at position ``at``.

        upstream : logical hashes of the tables it reads, by name
        dependencies : what the stage returned; ignored unless it needs shared tables
        """
        read: dict[str, JSON] = {}
        if at > 0:
            read["tables"] = dict(upstream)
        if self.reads_inputs(at):
            read["files"] = self.inputs(unit).hex()
        inputs, parameters = _hash(read), self.parameters(unit, at)
        depends = _hash(dependencies) if self._pipeline.stages[at].needs else self._none
        parts = [unit.unit_id, *(part.hex() for part in (self._code[at], inputs, parameters, depends))]
        return StageKey(_hash(parts), self._code[at], inputs, parameters, depends)
