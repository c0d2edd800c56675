"""What a finished search says: causes with intervals, what else could be, what is left, and what to record next."""
