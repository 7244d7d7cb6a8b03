"""What the commands write: where it goes, what may be replaced there, and how it takes its place.

In: the path that a user gave with -o. Out: files and folders that appear whole or not at all. Only what
polhode itself made is ever replaced or removed; everything else stays (docs/security.md).

- place: where a path leads, links followed; places that are never written to
- run_files: the names that belong to a run
- locks: one process at a time in a folder
- single_file: a file of a command, which replaces only what the same command wrote
- marked_folder: a folder with a mark that lists what the commands wrote there
- staged_folder: a folder written under a hidden name, which takes its place when it is complete
- resumable_dataset: a dataset on its way to the disk, resumed by the same command
- exchange: two folders change places; what is not ours goes along; the old one is removed name by name
"""
