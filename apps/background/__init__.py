"""The background application: masks and tracks of moving objects."""
