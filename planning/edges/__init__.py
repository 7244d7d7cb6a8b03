"""Pose observability from edges: what a model seen along a trajectory can tell, before an image exists."""
