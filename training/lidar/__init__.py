"""LiDAR for training and evaluation: simulated, recorded, and split into input and target."""
