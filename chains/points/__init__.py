"""Points followed from frame to frame, and matched between distant frames."""
