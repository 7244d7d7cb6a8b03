"""Surfaces. In: material and point. Out: reflectance, roughness and the bent normal.

materials.py   materials and their evaluation
noise.py       solid noise of the drawn textures
spot_noise.py  solid noise of the collage textures
"""
