"""Compiled loops of the cameras."""
