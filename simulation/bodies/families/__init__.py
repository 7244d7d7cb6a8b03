"""Families of bodies, one a file. In: size and part builder. Out: parts in G.

registry.py names them all.
asteroid.py, bus.py, cubesat.py, dish.py, free_flyer.py, truss.py, upper_stage.py
"""
