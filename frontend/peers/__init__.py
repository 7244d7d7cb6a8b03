"""Published methods, for comparison. In and out: as for feature and match methods.

detectors.py    DISK, ALIKED and XFeat
matchers.py     LightGlue and LoFTR
weights.py      files of weights
"""
