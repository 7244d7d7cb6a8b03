"""Methods of the front end on scenes that no training has seen.

In: configs/frontend_test/ and configs/depth_test/. Out: correct matches, motions, errors of disparity, times.

    matching    features and matches of every method
    scenes      what the simulator knows of features
    disparity   dense disparity
    masks       masks before Earth and wall
    networks    scores of the trained networks, and their landmarks
    feature_noise      constants of the noise model of surface features
"""
