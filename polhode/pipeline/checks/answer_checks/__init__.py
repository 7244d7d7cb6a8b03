"""Checks of the answer: signs, without truth, that the motion found is not the target's (docs/checks.md).

In: the solution, depth maps and images. Out: checks, each with its value; limits and reasons to doubt are in
``run_directory/check_table``.

- check_answer: all but that of the images, one after the other; among them links of frame pairs, mirrored
  relief, disturbances, centre of mass, causal estimate
- image_motion: whether the images move as the motion says, and the surface, moved by it, looks like them
- symmetry_turn: whether they show the rotation of a body of revolution about its axis
- part_solutions: forward prediction, halves of the landmarks, outline and interior, solved apart
- residual_checks: whether residuals are noise in time, over the image, at every depth, and in the Sun
"""
