"""The colour of skin, and where it is all the time."""
