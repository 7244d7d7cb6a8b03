"""Robustness: what faults in the data and in the machine do to a run, and hostile files to their readers.

In: simulated sequences. Out: tables of what was lost, found and said.

data_faults         the campaign of faults in the data: one fault at a time on twelve bodies
measurement_faults  faults in measurements without images: hundreds of runs in an hour
verdict             how well checks and verdict tell wrong runs from right ones, by the records of both
bodies              the campaign's bodies
faults_of_files     its faults of images, times, calibration and poses
faults_of_scenes    its faults that are rendered: a lost part, forces, late cameras
recording           a sequence in memory, with its truth
judge               errors of what a run claims, in sigmas; what is wrong, and whether the run says so
kills               random kills and full disks: what they leave of the output of every command
disturbed_commands  its commands, their inputs, and what each makes undisturbed
results             what a command left, without times and logs
leaks               memory and open files over thousands of runs in one process
small_data          the small sequence of the benchmarks of kills and leaks
fuzzing             inputs found by mutation, for every reader of files
fuzz_targets        the readers, each with a small valid corpus
fuzz_check          what an input may do: success, or one line of InputError
fuzz_mutation       changes of bytes, numbers, lines, members and chunks
"""
