"""What each stage of a grounding step is fed and how it is fitted."""
