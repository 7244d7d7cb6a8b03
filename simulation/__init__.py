"""Scenes to datasets with truth: bodies, materials, motion, light, rendering."""

from simulation.sequence import simulate

__all__ = ["simulate"]
