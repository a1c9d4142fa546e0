"""Search for parameters of the chains that are better on films with ground truth, judged on other films."""
