"""Calibration of stereo rigs from rendered images: random_rigs."""
