"""Checks of the data by the estimate: signs, without truth, that something in them is not as they say.

In: the context of a run, its features, tracks and estimate. Out: reasons to doubt, one sentence each.

- check_data: all checks, one after the other
- rig_check: whether the images are those of the rig that the calibration describes
- disparity_steps: steps of all disparities from one frame to the next
- self_calibration: the focal length that would fit best
- clock_check: whether the time stamps agree with the rotation
- inspector_check: whether the inspector's poses agree with the images
- swing_check: whether the inspector's attitude swings slowly, unreported
- mass_check: whether the mass properties are the same before and after a push
- centre_check: where the centre of mass was before and after an instant, by the poses alone
- mask_check: whether masks that were found before a background that is not dark can be trusted
- connection_check: whether landmarks connect all parts of the sequence
"""
