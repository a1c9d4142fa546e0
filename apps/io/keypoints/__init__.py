"""Points of persons that a detector has found: in files, in arrays of other libraries, by a callable."""
