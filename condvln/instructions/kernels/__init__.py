"""Compiled kernels of the sampler; each file calls only files of this folder."""
