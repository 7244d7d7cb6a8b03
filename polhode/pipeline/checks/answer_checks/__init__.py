"""Checks of the answer: signs, without truth, that the motion found is not the target's (docs/checks.md).

In: the solution, depth maps and images. Out: checks, each with its value; limits and reasons to doubt are in
``run_directory/check_table``.

- check_answer: links of frame pairs, mirrored relief, displacement by disturbances
- symmetry_turn: whether images show the rotation of a body of revolution about its axis
"""
