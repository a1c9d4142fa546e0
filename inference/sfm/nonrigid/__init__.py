"""Non-rigid structure from motion: shapes that deform, and their poses, from point tracks."""
