"""Structure from motion before a perspective camera of one focal length."""
