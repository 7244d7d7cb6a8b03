"""From images to results: the whole program on simulated scenes and photographs.

In: configurations of scenes. Out: errors, consistency of covariances, predictions, pictures of README.md.

    scenes             simulate, run and evaluate every scene: the tables of docs/scenes.md
    thesis             the replica of Test Session 38 beside the thesis's own results
    against_slam       beside COLMAP (colmap) and stereo odometry (orb_odometry), compared by found_poses
    photographs        a real object with known motion
    prediction_error   a prediction against what came after it
    cost               seconds of the processor over those of one SIFT
    footprint          disk and memory that the program needs
    report_picture     a part of a report as a picture
"""
