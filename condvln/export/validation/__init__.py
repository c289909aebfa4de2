"""A linter for VLN-CE, ANSR-v1, RxR and R2R files from any source: finds what crashes a strict loader or skews a
score.
"""

from condvln.export.validation.findings import CODES, Finding, Severity
from condvln.export.validation.folder import Options, validate

__all__ = ["CODES", "Finding", "Options", "Severity", "validate"]
