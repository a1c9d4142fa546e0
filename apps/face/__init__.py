"""The face application: pose, deformation and texture."""
