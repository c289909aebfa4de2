"""The proof of an export: texts read, scenes measured and navmeshes asked again, by code that shares nothing with the
code that made it."""

from condvln.verify.certificate import FACTS, Certificate, Disagreement
from condvln.verify.observability import Surfaces
from condvln.verify.proof import prove_export
from condvln.verify.rules import VerifierRules
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
    "read",
]
