"""Pairs that come one at a time, a state for each before the next, and the batch answer at the end.

- run_live: a source to a run directory, as ``polhode run --live`` does it
- session: pairs that the caller pushes
- feed: pairs from a source at their pace, in a bounded queue
- folder_source: a folder that fills, or a recorded one
- recording: what has come as a sequence on disk, which the batch reads at the end
- live_volumes: the keep-out volume of a session
- warm_up: what is compiled before the first pair comes
- arrivals: what becomes of late, missing and repeated pairs
"""
