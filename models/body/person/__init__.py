"""What is learned of a person before the track starts: whose face it is, whether forearms are bare."""
