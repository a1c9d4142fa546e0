"""What is known of a person: whose face it is, colours of the clothes, whether arms are bare."""
