"""Equipment of spacecraft. In: sizes and part builder. Out: parts, each on z = 0 of its own frame.

layout.py      places on a wall, and a wall fitted out
equipment.py   boxes, star trackers, lenses, handrails, cables
antennas.py    patch, helix, whip, horn, dish
propulsion.py  thrusters, engine, bottles
wing.py        solar wings
"""
