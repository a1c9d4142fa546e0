"""The body application: poses of an upper body."""
