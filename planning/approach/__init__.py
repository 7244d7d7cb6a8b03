"""Flying beside a tumbling target.

In: the predicted motion, the keep-out volume, the thrust. Out: what an approach costs and where it may go.

    tumbling_threshold   rates above which station keeping costs too much
    corridor             the cone of a docking point, and the acceleration that staying in it takes
    surface_speed        speed of the surface past an inspector, and the slowest places
    trajectory           an inspector's trajectory around the keep-out volume
"""
