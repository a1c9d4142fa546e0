"""Points followed from frame to frame, and over a whole film."""
