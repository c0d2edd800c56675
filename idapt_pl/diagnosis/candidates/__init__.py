"""What a search tries: all candidates with their scales, how they are fitted, and what became of each."""
