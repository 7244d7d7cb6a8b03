"""The calibration of a rig in the formats of other programs.

In: a file, two files, or a folder. Out: a ``Rig``, two cameras on one body B, with the numbers of the file.

- read_rig: which format it is, and a rig from it; sensor.yaml of a dataset
- content: a file of any kind (YAML, XML, JSON, INI, arrays) as a mapping
- opencv: camera matrices, distortion, R and T by the names of OpenCV's samples
- kalibr: camchains
- camera_info: ROS camera_info, as two YAML files, printed, or as messages
- slam_programs: ORB-SLAM, VINS-Fusion, Basalt
- camera_makers: ZED, OAK
- datasets: KITTI, COLMAP
- rig: the records; checks that concern every format
"""
