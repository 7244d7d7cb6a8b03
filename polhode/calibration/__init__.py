"""Images of a board become the calibration of a stereo rig (docs/calibrate.md).

In: images of a chessboard, a ChArUco board or a grid of AprilTags, as files or as a recording. Out: lenses of
both cameras and the pose between them, each number with its standard deviation, in the formats of this and
other programs; and the reason for each image that was left out.

- calibrate: the flow, from the images to the rig
- page: the files of the command, report.html among them, and their folder
- result: the content of calibration.json
- formats: sensor.yaml, and the files of Kalibr, OpenCV and ROS
- pair_consensus: which pairs agree on the pose of the right camera, and what is wrong with others
- image_pairs: the images, from files or a recording
- start_values: one camera from nothing
- adjustment: the bundle adjustment, with covariance; distances of corners from their epipolar lines
- detection: the corners of a board in an image, or why there are none
- board_map: where a smooth map has the corners, by where most of them are seen
- corner_fit: corners of four squares, to a hundredth of a pixel
- lenses: the lens models with their derivatives
- boards: what is on a board
"""
