"""Measurements to motion, mass properties and covariance."""

from backend.estimate import estimate_motion
from backend.initialize import initialize_motion

__all__ = ["estimate_motion", "initialize_motion"]
