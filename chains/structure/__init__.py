"""Shape and motion of rigid and deforming objects, from tracks of their points."""
