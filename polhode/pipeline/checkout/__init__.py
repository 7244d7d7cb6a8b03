"""What a user should know of a sequence before a run (thesis 5.10): each check with value, limit and advice.

In: the folder of a sequence, and another calibration if its images are to be checked against one. Out:
checkout.json and the page checkout.html. Nothing of the back end is needed.

- checkout: all checks, and the few that a run makes before its work
- sample: the pairs that are examined, spread over the sequence
- check_table: name, limits and advice of every check
- image_quality: one image: exposure, sharpness, noise, surroundings; one range image
- rig_tilt: rows of left and right image: pitch, roll and focal length of the right camera
- target_range: distance, size and disparity of the target, resolution of its depth, range images
- target_motion: rotation between frames, matches, delay between the cameras
- exposure: exposure, focus and noise over the sample, and between the cameras; what surrounds the target
- timing: stamps, gaps, lost frames, poses of the inspector
- result: the content of checkout.json
- page: checkout.html
"""
