"""What chains and features promise, the graph of them, and the two engines."""
