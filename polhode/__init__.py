"""The shared language of polhode: frames, records, cameras, datasets, configuration."""
