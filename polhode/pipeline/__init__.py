"""The flow: from a stereo sequence on disk to a run directory, and what follows from one.

In: the folder of a sequence and a configuration. Out: the run directory (docs/run_directory.md).

- run: the whole flow on a page, a stage a line
- open_run, run_result: what is opened before the stages, and reported after them
- runner: runs the stages: what is computed again, and by which process
- context: images, configuration and progress, which every stage takes
- stream_results: what a stream has found already, for the run that follows
- correspondences: features of all frames, and the frames that match
- depth_maps: depth of all pairs, made now or stored before
- find_motion: solve, match again, keep what fits better
- long_sequence: thousands of frames by a stream, key frames, and all states in their map
- judge_motion: the causal estimate, the checks of data and answer, what the motion leaves open
- build_surface: fusion of the depth by the motion
- finish_surface: holes, colours, coverage and levels of the fused surface
- write_results: the files of a run, each as soon as there is what it contains, and its pictures
- coverage: the share of the body that was seen, seen but never lit, never seen
- uniform_density: mass properties from the mesh at uniform density, assumed and compared with the motion's

stream/ has the stages of one pair after the other, live/ takes pairs as they come; checkout/ checks a
sequence before a run; checks/ finds signs that the data are not as they say (data_checks/) and that the
answer is not (answer_checks/); intervals/ bounds what the motion does not determine.
"""
