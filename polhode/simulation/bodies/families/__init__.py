"""Families of bodies, one a file. In: size and part builder. Out: parts in G.

asteroid.py, bus.py, cubesat.py, dish.py, free_flyer.py, truss.py, upper_stage.py; build.py lists them.
"""
