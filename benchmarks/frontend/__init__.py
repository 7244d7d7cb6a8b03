"""Methods of the front end on scenes that no training has seen.

In: configs/frontend_test/ and configs/depth_test/. Out: correct matches, motions, errors of disparity, times.

    matching    features and matches of every method: tables and figure
    reliability which candidates are found again, and how well it is known beforehand
    disparity   dense disparity
    masks       masks before Earth and wall
    scenes      the scenes, and what the simulator knows of their features
"""
