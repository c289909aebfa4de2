"""Compiled kernels of the metrics; each file calls only functions of this folder."""
