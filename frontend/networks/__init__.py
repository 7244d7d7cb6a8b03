"""The networks trained here. In: tensors. Out: landmarks, descriptors, distributions of disparities.

descriptor.py    the descriptor of surface patches
surface.py       landmarks, their uncertainty and their descriptors, from one pyramid
disparity.py     the refinement of disparities
grouping.py      groups of different sizes as one tensor
weights.py       loading of weights; the precision in which networks multiply
tensor_file.py   checked reading of safetensors files
"""
