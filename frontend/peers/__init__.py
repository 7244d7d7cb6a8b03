"""Published methods, for comparison. In and out: as for feature and match methods.

detectors.py    DISK, ALIKED and XFeat
lightglue.py    LightGlue
loftr.py        LoFTR
weights.py      files of weights
"""
