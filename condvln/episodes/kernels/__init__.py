"""Compiled loops; each file calls only files of this folder."""
