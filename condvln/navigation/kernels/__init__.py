"""Compiled kernels of the pathfinder: Detour's queries, in strict float32 and with Detour's order of operations.

The algorithms are those of Recast & Detour (Mikko Mononen, zlib licence) as habitat-sim (MIT) configures them,
reimplemented. Files are validated by :mod:`condvln.navigation.navmesh_file`, arguments by the calling classes; kernels
check no indices. Every literal is an explicit float32, since numba would widen a bare one to float64.
"""
