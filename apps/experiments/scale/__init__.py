"""Cost as curves: over pixels, objects, points, observations, samples, experts, texels and frames."""
