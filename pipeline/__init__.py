"""The flow: from a stereo sequence on disk to a run directory, and what follows from one.

In: the folder of a sequence and a configuration. Out: the run directory (docs/run_directory.md).

- run: the whole flow on a page
- streamed: what a stream has found already, for the run that follows
- context: images, configuration, progress and clock, which every step takes
- correspondences: features of all frames, and the frames that match
- depth_maps: depth of all pairs, made now or stored before
- find_motion: solve, match again, keep what fits better; consistency_check decides what fits better
- long_sequence: thousands of frames by a stream, key frames, and all states in their map
- review_motion: the causal estimate and the checks of a motion, which need no surface
- build_surface: fusion of the depth by the motion, and the finished mesh
- finish_surface: holes, colours, coverage and levels of the fused surface
- coverage: the share of the body that was seen, seen but never lit, never seen
- evaluation: a run against the truth of its dataset, which nothing else reads
- uniform_density: mass properties from the mesh at uniform density, assumed and compared with the motion's

live/ takes pairs one at a time, with a state for each; checkout/ checks a sequence before a run; data_checks/
finds signs that the data are not as they say, answer_checks/ that the answer is not; intervals/ bounds what
the motion does not determine; run_directory/ reads and writes a run; report/ and pictures/ show it;
after_run/ derives plans, predictions, exports and the observability of edges from it.
"""
