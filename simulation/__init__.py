"""Scenes to datasets with truth: bodies, materials, motion, light, rendering."""

from polhode.simulation.dataset.sequence import simulate

__all__ = ["simulate"]
