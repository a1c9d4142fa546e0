"""What is learned of a person at first: whose face it is, its colour, whether forearms are bare."""
