"""Where a camera looks: maps from a scene's picture to the frames that show it."""
