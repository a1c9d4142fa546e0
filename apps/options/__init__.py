"""What a command takes: options, the files that hold them, and what is said when they are wrong."""
