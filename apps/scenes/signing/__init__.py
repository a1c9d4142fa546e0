"""A generated signer in a room."""
