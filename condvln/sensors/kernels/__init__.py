"""Compiled kernels of the renderer."""
