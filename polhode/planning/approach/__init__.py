"""Station keeping and approach at a tumbling target.

In: the predicted motion, the keep-out volume, the thrust. Out: the cost of an approach, and trajectories.

    tumbling_threshold   rates above which station keeping costs too much
    corridor             the cone of a docking point, and the acceleration that staying in it takes
    surface_speed        speed of the surface past an inspector, and the slowest points
    approach_path        a camera's path that comes nearer along a line and looks at one point
    trajectory           an inspector's trajectory around the keep-out volume
"""
