"""What is recorded, one kind of recording a file.

In: the paths of the user. Out: a ``Recording``: timestamps of both cameras, images one after the other, and
what else a recording holds.

- open_recording: which kind the paths are, and the recording
- recording: the records that all kinds have in common
- image_folders: two folders of images
- kitti: where the images of a folder of KITTI are
- euroc: a folder in the layout of EuRoC, or a dataset
- tum_rgbd: a folder of TUM's RGB-D benchmark, one camera with depth
- ros_bag: bags of ROS 1 and ROS 2, over ros_messages (images, poses, tf) and mcap_file
- video: one side-by-side video, or two videos
"""
