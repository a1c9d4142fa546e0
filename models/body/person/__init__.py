"""What is known of a person: whose face it is, whether forearms are bare, which points were found."""
