"""The contract of chains and features, their graph, and the two engines."""
