"""Station keeping and approach at a tumbling target.

In: the predicted motion, the keep-out volume, the thrust. Out: the cost of an approach, and trajectories.

    tumbling_threshold   rates above which station keeping costs too much
    corridor             the axis of a docking point, what staying on it takes; a camera's path
    surface_speed        speed of the surface past an inspector, and the slowest points
    trajectory           an inspector's trajectory around the keep-out volume
"""
