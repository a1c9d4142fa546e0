"""Boxes that a detector has found: in files, in arrays and objects of other libraries, by a callable."""
