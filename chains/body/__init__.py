"""Head, hands and pose of a person's upper body."""
