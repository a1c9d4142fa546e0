"""What is known of a person: whose face it is, colours of skin and clothes, which points were found."""
