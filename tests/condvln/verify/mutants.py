"""All kinds of faults that the verifier is held against: a module of them registers its own when it is imported."""

from __future__ import annotations

import mutants_of_files
import mutants_of_leads
import mutants_of_names
import mutants_of_places
import mutants_of_predicates
import mutants_of_sight
import mutants_of_texts
import mutants_of_truths
from mutation import MUTATORS, Files, World

__all__ = ["MODULES", "MUTATORS", "Files", "World"]

MODULES = (
    mutants_of_truths,
    mutants_of_names,
    mutants_of_predicates,
    mutants_of_texts,
    mutants_of_places,
    mutants_of_leads,
    mutants_of_sight,
    mutants_of_files,
)
