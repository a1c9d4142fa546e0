"""The papers' experiments, speed, and competitors: nothing here is needed to track."""
