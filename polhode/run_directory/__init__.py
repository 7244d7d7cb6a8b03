"""The run on disk: how it is written, stage by stage, and read back as typed records.

In: the records of the stages. Out: the files of a run (docs/run_directory.md), and the records again.

- run_folder: the folder as a whole, which appears complete or not at all
- outputs: what each stage writes
- finished_stages: results in RUN/stages, from which an interrupted run goes on
- stored_run: all of a stored run, as the report takes it
- summary: summary.json; summary_schema has its models and generates its JSON Schema
- check_table: the checks of data and answer: names, limits, reasons; verdict: how they decide the status
- summary_in_words: the summary and its intervals as descriptions
- own_results: digests of the run's files, and whether those in the folder are its own
- data_frames: a run as tables
- film: the film of camera beside model, and where its panels lie
- recording: which recording the run was made from
- archives: covariance.npz, measurements.npz, online.npz
- trajectory_file, live_states, point_cloud_file: trajectory.csv, live_states.csv and landmarks.ply
"""
