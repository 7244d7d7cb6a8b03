"""The networks trained here. In: tensors. Out: descriptors of patches, distributions of disparities.

descriptor.py    the descriptor of surface patches
disparity.py     the refinement of disparities
precision.py     the precision in which networks multiply
weights.py       loading of weights
tensor_file.py   checked reading of safetensors files
"""
