"""What is read and written: frames, tracks, points, ground truth, results."""
