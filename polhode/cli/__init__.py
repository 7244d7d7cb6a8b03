"""The command line: arguments in, one call of a room's function, one line of result or of error out.

``main.py`` parses the arguments and runs the command; every command is a model of its options in a file of
its own, whose ``execute`` checks them and calls the room that does the work. Heavy imports wait for that
call, so that ``--help`` is quick.

- main: finds the command, loads its configuration, shows the answer, turns errors into exit codes
- parsing, help: words to a command and keys of the configuration; help
- answer: what a command returns, as text or as JSON
- options: the options of a command as data
- streams: standard output and error that are closed, full, or read by nobody
- failures: errors that no room has explained, as exit code and one line
- doctor, completion: the installation itself
- simulate, import_sequence, train: make datasets, of others' recordings too; train the networks
- calibrate, checkout, expect: a rig, a sequence and what to expect, before a run
- run, evaluate, report, compare: estimate; compare with the truth; show; compare optimizers
- predict, plan, export, observability, threshold, view: what follows from a run
- sweep: many points of settings
"""
