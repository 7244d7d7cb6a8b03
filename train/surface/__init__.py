"""Training of the surface network: bodies under several Suns, their landmarks, batches, losses, scores."""
