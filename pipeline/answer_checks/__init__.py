"""Checks of the answer: signs, without truth, that the motion found is not the target's (docs/checks.md).

In: the solution, depth maps and images. Out: checks, each with its value, limit and reason to doubt.

- check_answer: all but that of the images, one after the other
- image_motion: whether the images move as the motion says
- model_check: whether the surface, moved by the motion, looks like the images
- symmetry_turn: whether they show the turn of a body of revolution about its axis
- parts_check: forward prediction, halves of the landmarks, outline and interior, solved apart
- agreement: how far two estimates differ, in sigmas
- residual_check: whether residuals are noise in time, over the image, and at every depth
- sun_check: whether landmarks slide with the Sun
- links_check: links of frame pairs that contradict the motion
- twins_check: distance of the mirror twin and of the runner-up
- push_check: whether the disturbances found move the target as a push does
- mesh_check: whether a body with this surface can have this centre of mass
- window_check: whether the causal estimate ends where the smoothed one does
"""
