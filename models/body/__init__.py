"""The upper body of a person: poses, joints, and how well they explain an image."""
