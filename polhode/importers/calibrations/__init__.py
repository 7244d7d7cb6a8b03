"""The calibration of a rig in the formats of other programs.

In: a file, two files, or a folder. Out: a ``Rig``, two cameras on one body B, with the numbers of the file.

- read_rig: which format it is, and a rig from it
- opencv: YAML, JSON of OpenCV's FileStorage: camera matrices, distortion, R and T
- kalibr: the camchain of Kalibr
- camera_info: ROS camera_info, as two YAML files or as messages
- euroc: sensor.yaml of a dataset, as ``polhode calibrate`` writes it
- rig: the records; checks that concern every format
"""
