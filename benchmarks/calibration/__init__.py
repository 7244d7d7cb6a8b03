"""Calibration of stereo rigs: random_rigs from rendered images, real_pairs from real ones beside OpenCV."""
