"""The calibration of a rig in the formats of other programs.

In: a file, two files, or a folder. Out: a ``Rig``, two cameras on one body B, with the numbers of the file.

- read_rig: which format it is, and a rig from it; Kalibr's camchain, sensor.yaml of a dataset
- opencv: YAML, JSON of OpenCV's FileStorage: camera matrices, distortion, R and T
- camera_info: ROS camera_info, as two YAML files or as messages
- rig: the records; checks that concern every format
"""
