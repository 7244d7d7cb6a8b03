"""Live and long sequences, and the stages of a run: latency, time, memory."""
