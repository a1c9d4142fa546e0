"""Moving objects: blobs in the pixels, detections, the ground that they stand on."""
