"""Checks of the data by the estimate: signs, without truth, that something in them is not as they say.

In: the context of a run, its features, tracks and estimate. Out: checks, each with its value; limits and
reasons to doubt are in ``run_directory/check_table``.

- check_data: all checks, one after the other
- rig_check: whether the images are those of the rig that the calibration describes
- disparity_steps: steps of all disparities from one frame to the next
- self_calibration: the focal length that would fit best
- pose_checks: whether time stamps, the inspector's poses and the rotation agree; whether landmarks connect
  all parts of the sequence
- mass_check: whether centre of mass and mass properties are the same before and after a push
"""
