"""Independent verification of an export: reads texts, measures scenes and queries navmeshes again.

It shares no code with the modules that generate relations, instructions and episodes.
"""

from condvln.verify.certificate import FACTS, Certificate, Disagreement, VerifierRules
from condvln.verify.observability import Surfaces
from condvln.verify.proof import prove_export, prove_runs
from condvln.verify.text_reader import TextReading, Unreadable, read

__all__ = [
    "FACTS",
    "Certificate",
    "Disagreement",
    "Surfaces",
    "TextReading",
    "Unreadable",
    "VerifierRules",
    "prove_export",
    "prove_runs",
    "read",
]
