"""What is made of an object that is doubted or lost: is it still there, and where is it found again."""
