"""Checks of the answer by the images: signs, without truth, that the motion found is not the target's.

In: the estimate, depth maps and images. Out: reasons to doubt, one sentence each.

- image_motion: whether the images move as the motion says
- symmetry_turn: whether they show the turn of a body of revolution about its axis
"""
