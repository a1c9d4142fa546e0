"""What is done once on a machine: loops are compiled."""
