"""What all runs over films have in common: resuming, interruption, progress, memory."""
