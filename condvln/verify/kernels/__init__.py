"""Inherent loops of the proof, compiled."""
