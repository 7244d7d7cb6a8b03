"""Live and long sequences: latency, time, memory."""
