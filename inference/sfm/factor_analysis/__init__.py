"""Structure from motion as factor analysis with missing data."""
