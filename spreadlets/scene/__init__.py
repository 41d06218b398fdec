"""What is given: camera, frame, stochastic samples."""
