"""Compiled kernels of the verifier."""
