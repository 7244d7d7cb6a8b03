"""Calibration of stereo rigs from rendered and from real images of boards."""
