"""What passes between the rooms, and the dataset on disk that it begins with."""
