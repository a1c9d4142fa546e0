"""What is known of a person: whose face it is, whether forearms are bare, what a detector finds of the pose."""
