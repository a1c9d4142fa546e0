"""Films and tracks in which there is no depth to be found, each for a reason of its own."""




